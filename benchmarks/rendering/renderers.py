"""Other renderers on the published box against our picture: each surface's difference, as they really ran.

    python benchmarks/rendering/renderers.py [--with mitsuba,radiance,raysect] [--out FOLDER] [--effort 1]

Every surface counts that lies within 0.2 % of ours, its standard deviation being at most 0.1 %; a surface whose error
is larger is not decided. Each renderer takes enough samples to decide six of the seven surfaces: about 1
minute for Mitsuba, 4 for Radiance, 40 for Raysect, of one core. With --out an interrupted run goes on with the batch it
was at. --effort multiplies the samples.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cboxlab.rendering.export import ExportSettings, exported_scene
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare_renders.renderers import compare_renderers

WAVELENGTHS = np.array([450.0, 500.0, 550.0, 600.0, 650.0, 700.0])
WITHIN, SIGMA = 0.002, 0.001
SIZE, REFERENCE_SAMPLES = 64, 2048
#: Samples per pixel and batch, batches.
SAMPLES = {
    "mitsuba": (1600, 8),
    "radiance": (1024, 8),
    "raysect": (720, 80),
    "luxcore": (1024, 8),
    "pbrt": (1024, 8),
    "cycles": (1024, 8),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--with", dest="names", default="mitsuba,radiance,raysect")
    parser.add_argument("--effort", type=float, default=1.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    for name in options.names.split(","):
        samples, batches = SAMPLES[name]
        judge_one(name, max(1, round(samples * options.effort)), batches, options.out)


def judge_one(name: str, samples: int, batches: int, out: Path | None) -> None:
    """Run one renderer and print what it is off by."""
    settings = ExportSettings(WAVELENGTHS, samples, batches, subpixels=2)
    exported = exported_scene(cornell_box(), cornell_camera(SIZE), settings)
    folder = None if out is None else out / name
    compared = compare_renderers(exported, [name], folder, samples=REFERENCE_SAMPLES)
    for line in compared.left_out:
        print(line)
    for judged in compared.judged:
        print(f"\n{name}, {samples} samples in each of {batches} batches: {judged.sentence}")
        if judged.remark:
            print(f"  {judged.remark}")
        print(f"  {judged.cpu_s:.0f} CPU s, variance x CPU s {judged.cost:.3g}")
        decided = {name: row for name, row in judged.surfaces.items() if row[1] <= SIGMA}
        near = [name for name, (difference, _) in decided.items() if abs(difference) <= WITHIN]
        for surface, (difference, sigma) in judged.surfaces.items():
            print(f"  {surface:12s} {difference:+.3%} +- {sigma:.3%}")
        print(
            f"  {len(near)} of {len(judged.surfaces)} surfaces within {WITHIN:.1%}; "
            f"{len(judged.surfaces) - len(decided)} with an error above {SIGMA:.1%}",
            flush=True,
        )


if __name__ == "__main__":
    main()
