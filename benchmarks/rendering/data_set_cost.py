"""Cost of a data set's picture against a stock spectral Mitsuba render of the same box at equal error.

    python benchmarks/rendering/data_set_cost.py RECIPE [--blocks 2] [--samples 16]

For the first blocks of a recipe, by their first camera. Ours: all pictures of a block with their truths, solution and
draws included, kernels warm. Stock: the path integrator of the variant llvm_ad_spectral with a film of the recipe's
wavelengths, of each block's first box, radiance alone, under a lamp of equal energy. Costs are CPU seconds of all
threads. Both errors are the relative standard error of the median pixel and wavelength, from eight batches. Stock's
cost is scaled to our error by the square of the errors' ratio. Printed for each block: pictures, CPU seconds a picture
and error of each, and the ratio of costs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.dataset import draw_box, load_recipe, sharing_rays
from cboxlab.scenes import Spectrum
from cboxlab.validation.dataset.picture import render_pictures
from cboxlab.validation.dataset.tasks import block_of
from contenders import specfilm
from numpy.typing import NDArray

#: Batches from which both errors are estimated.
BATCHES = 8


def ours(path: Path, first: int) -> tuple[int, float, float]:
    """Number of pictures that share rays with a box, CPU seconds of each, and their median error."""
    from cboxlab.rendering.integrators import passes
    from cboxlab.rendering.radiosity import final_gather, patched_scene

    recipe = load_recipe(path)
    for _ in range(2):  # the first turn compiles the kernels
        for cached in (passes._light, final_gather._direct_cells, final_gather._view, patched_scene._exchange):
            cached.cache_clear()
        begun = time.process_time()
        group = sharing_rays([draw_box(recipe, number, path.parent) for number in block_of(recipe, first)])[0]
        camera = next(iter(group[0].cameras))
        errors = [p.attrs["relative_standard_error"] for p in render_pictures(group, camera, recipe, path.parent)]
        seconds = time.process_time() - begun
    return len(group), seconds / len(group), float(np.median(errors))


def stock(path: Path, first: int, samples: int) -> tuple[float, float]:
    """CPU seconds and error of a stock picture of a box by its first camera."""
    recipe = load_recipe(path)
    box = draw_box(recipe, first, path.parent)
    white = box.model.scene.with_lamp(Spectrum(np.array([300.0, 900.0]), np.ones(2), "zero"))
    camera = replace(next(iter(box.cameras.values())), k1=0.0)
    render = specfilm(white, camera, samples, recipe.picture.wavelength_nm)
    render(0)  # compiles the kernels
    begun = time.process_time()
    values = np.stack([render(1 + batch) for batch in range(BATCHES)])
    return time.process_time() - begun, _error(values)


def _error(values: NDArray[np.float32]) -> float:
    """Relative standard error of the median pixel and wavelength; values (batch, y, x, w) relative to the lamp's."""
    mean = values.mean(axis=0)
    surfaces = (mean.max(axis=-1) > 0) & (mean.max(axis=-1) < 0.9)
    error = values.std(axis=0, ddof=1)[surfaces] / np.sqrt(BATCHES)
    lit_pixels = mean[surfaces] > 0
    return float(np.median(error[lit_pixels] / mean[surfaces][lit_pixels]))


def main() -> None:
    """Print the costs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe", type=Path)
    parser.add_argument("--blocks", type=int, default=2)
    parser.add_argument("--samples", type=int, default=16)
    options = parser.parse_args()
    recipe, first = load_recipe(options.recipe), 0
    for _ in range(options.blocks):
        with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:  # a variant a process
            count, seconds, error = pool.apply(ours, (options.recipe, first))
            stock_seconds, stock_error = pool.apply(stock, (options.recipe, first, options.samples))
        equal = stock_seconds * (stock_error / error) ** 2
        print(
            f"box {first}: {count} pictures of {seconds:.2f} s to {error:.2%}; stock {stock_seconds:.2f} s to "
            f"{stock_error:.2%}, {equal:.0f} s to {error:.2%}; ratio {equal / seconds:.0f}",
            flush=True,
        )
        first = block_of(recipe, first).stop


if __name__ == "__main__":
    main()
