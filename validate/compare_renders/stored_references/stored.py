"""Mean light and patterns of a picture as a JSON file next to a renderer's tests.

A reference is known to 0.05 %, and states seed, samples and versions of its rendering.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.distributions import student_quantile
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import read_json
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from ..regress import BLOCKS, FALSE_ALARMS, SYSTEMATIC, Side, strata_of

__all__ = ["Reference", "measured_reference", "read_reference", "require_same_light", "write_reference"]

#: Format of files.
FORMAT = "light-reference/2"
#: Earlier formats, whose references hold no blocks, patterns or moments.
_EARLIER = ("light-reference/1",)
#: Prefix of pools of the grid, which need not be known to 0.05 % and whose few pixels are not normal.
_BLOCK = "block: "
#: Degrees of freedom of the grid's pools at most.
_BLOCK_DEGREES = 12.0
#: Widths of the cells of checkerboards, columns and rows, px.
_CELLS_PX = (1, 2, 4, 8)
#: Largest relative standard deviation of a mean of a reference: half of the 0.1 % that a change should be seen at.
LARGEST_SIGMA = 5e-4
#: Most pools that a message lists.
_MOST_LINES = 12
#: Fewest pixels of a mean.
_MIN_PIXELS = 12


@dataclass(frozen=True)
class Reference(FrozenMappings):
    """Mean light of a picture."""

    #: Mean radiance by pool: "surface: floor", "band: 550", "whole picture". It is summed over bands, except of a band.
    means: Mapping[str, float]
    #: Relative standard deviation by pool.
    sigma: Mapping[str, float]
    #: Degrees of freedom of ``sigma``, at least.
    degrees: float
    #: Seed of the renderer, as its user states it.
    seed: int
    #: Samples per pixel, as the user states them.
    samples: int
    #: Version by name of a program.
    versions: Mapping[str, str]
    #: Contents of checkerboards, columns and rows over the light, and moments of the light over the picture.
    shapes: Mapping[str, float] = field(default_factory=dict)
    #: Standard deviation of each of ``shapes``.
    shape_sigma: Mapping[str, float] = field(default_factory=dict)
    #: Pixels that are not numbers, in words; empty without any. Files hold no such reference.
    not_numbers: str = ""

    @property
    def least_certain(self) -> str:
        """Surface, band or entire picture whose mean has the largest standard deviation."""
        return max((name for name in self.sigma if not name.startswith(_BLOCK)), key=lambda name: self.sigma[name])

    @property
    def precise(self) -> bool:
        """Whether all means have the precision that a reference needs, 0.05 %."""
        return self.sigma[self.least_certain] <= LARGEST_SIGMA


def measured_reference(side: Side, seed: int, samples: int, versions: Mapping[str, str]) -> Reference:
    """Mean light of a picture, of its surfaces, bands and blocks; its patterns.

    The pixels of a mean are selected by the map of surfaces alone, never by the radiance, which is noisy.

    Parameters
    ----------
    side
        The picture, with standard errors.
    seed
        Seed of the renderer.
    samples
        Samples per pixel.
    versions
        Version by name of a program; those of this program and of Python are added.

    Returns
    -------
    Reference
        Means of all pools with enough pixels and light.

    Raises
    ------
    InputError
        If the picture has no standard errors.
    """
    if side.variance is None:
        raise InputError(
            side.source,
            "no standard error",
            "a cube with standard_error, or several cubes of other seeds",
            "Without them nothing says how well its means are known.",
        )
    body, surfaces = _regions(side)
    all_bands = np.ones(len(side.bands))
    pools = {"whole picture": (body, all_bands)}
    pools |= {f"surface: {name}": (mask, all_bands) for name, mask in surfaces.items()}
    rows, columns = (np.arange(size) * BLOCKS // size for size in side.shape)
    number = rows[:, None] * BLOCKS + columns
    pools |= {
        f"{_BLOCK}row {i // BLOCKS + 1}, column {i % BLOCKS + 1}": (number == i, all_bands) for i in range(BLOCKS**2)
    }
    pools |= {f"band: {name}": (body, row) for name, row in zip(side.bands, np.eye(all_bands.size), strict=True)}
    means, sigma = {}, {}
    for name, (mask, weights) in pools.items():
        mean = float((side.radiance[mask] @ weights).mean()) if mask.sum() >= _MIN_PIXELS else 0.0
        if mean > 0:
            means[name], sigma[name] = mean, _deviation(side.variance[mask], weights) / mean
    programs = {"cboxlab": version("cboxlab"), "python": platform.python_version()}
    # each pixel of a pool has independent degrees of freedom
    shapes, shape_sigma = _shapes(side.radiance.sum(axis=-1), np.sqrt(side.variance).sum(axis=-1) ** 2)
    degrees = side.degrees * _MIN_PIXELS
    programs = {**programs, **versions}
    absent = "" if side.not_numbers is None else side.not_numbers.sentence("picture")
    return Reference(means, sigma, degrees, seed, samples, programs, shapes, shape_sigma, absent)


def _shapes(total: NDArray[np.float64], variance: NDArray[np.float64]) -> tuple[dict[str, float], dict[str, float]]:
    """Patterns and moments of a picture (y, x), and their standard deviations.

    A mirrored, moved or checkered picture changes them, a lamp that moves by a tenth of a pixel, too.
    """
    rows, columns = np.indices(total.shape)
    shapes: dict[str, NDArray] = {}
    for cell in _CELLS_PX:
        down, across = (2.0 * (axis // cell % 2) - 1 for axis in (rows, columns))
        shapes |= {
            f"checkerboard: {cell} px": np.asarray(-down * across),
            f"columns: {cell} px": np.asarray(across),
            f"rows: {cell} px": np.asarray(down),
        }
    y, x = (2 * axis / max(total.shape) for axis in (rows, columns))
    shapes |= {"moment: x": x, "moment: y": y, "moment: x x": x * x, "moment: x y": x * y, "moment: y y": y * y}
    light = max(float(total.sum()), 1e-300)
    values = {name: float((shape * total).sum()) / light for name, shape in shapes.items()}
    sigma = {
        name: float(np.sqrt(((shape - values[name]) ** 2 * variance).sum())) / light for name, shape in shapes.items()
    }
    return values, sigma


def _regions(side: Side) -> tuple[NDArray[np.bool_], dict[str, NDArray[np.bool_]]]:
    """(y, x) pixels without the lamp, and of each surface away from its edges.

    Without a map of surfaces the lamp is found by its brightness, and there are no surfaces.
    """
    surface_map = side.surfaces
    if surface_map is None or not surface_map.of_objects:
        return strata_of(side.radiance.sum(axis=-1), None).body, {}
    index = surface_map.index
    inside = maximum_filter(index, 3) == minimum_filter(index, 3)
    inside[[0, -1], :] = inside[:, [0, -1]] = False
    surfaces = {name: (index == i) & inside for i, name in enumerate(surface_map.names)}
    if surface_map.lamp is None:
        return strata_of(side.radiance.sum(axis=-1), surface_map).body, surfaces
    return ~surface_map.lamp, surfaces


def _deviation(variance: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Standard deviation of the mean of weighted sums over bands.

    Errors of bands are taken as fully correlated, those of pixels as independent.
    """
    return float(np.sqrt(((np.sqrt(variance) @ weights) ** 2).sum())) / len(variance)


def write_reference(path: Path, reference: Reference) -> None:
    """Write a reference.

    Parameters
    ----------
    path
        The file; an existing one is replaced.
    reference
        The reference.

    Raises
    ------
    InputError
        If pixels are not numbers, or if a mean is not known to 0.05 %; the message states the samples that are needed.
    """
    if reference.not_numbers:
        raise InputError(path, reference.not_numbers, "a reference of numbers alone")
    if not reference.precise:
        worst = reference.least_certain
        raise InputError(
            path,
            f"{worst} known to {reference.sigma[worst]:.3%}",
            f"{LARGEST_SIGMA:.2%} or better",
            f"Take about {np.ceil((reference.sigma[worst] / LARGEST_SIGMA) ** 2):.0f} times the samples.",
        )
    with replacing(path) as temporary:
        content = {key: value for key, value in asdict(reference).items() if key != "not_numbers"}
        temporary.write_text(json.dumps({"format": FORMAT, **content}, indent=1) + "\n", encoding="utf-8")


def read_reference(path: Path) -> Reference:
    """Read a reference.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Reference
        The reference.

    Raises
    ------
    InputError
        If the file is missing or is no reference.
    """
    record = read_json(path, "a stored reference")
    try:
        return _checked(record)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(path, f"no reference ({type(error).__name__}: {error})", f"format {FORMAT}") from None


def _checked(record: dict[str, Any]) -> Reference:
    """Reference of a file's content; any error of look-up or conversion says that it is none."""
    if record["format"] not in (FORMAT, *_EARLIER):
        raise ValueError(record["format"])
    means, sigma = ({str(k): float(v) for k, v in record[key].items()} for key in ("means", "sigma"))
    values = np.array([*means.values(), *sigma.values()])
    if not means or set(means) != set(sigma) or not np.isfinite(values).all() or (values < 0).any():
        raise ValueError("means and sigma of the same pools, 0 or more")
    shapes, shape_sigma = (
        {str(k): float(v) for k, v in record.get(key, {}).items()} for key in ("shapes", "shape_sigma")
    )
    if set(shapes) != set(shape_sigma) or not np.isfinite([*shapes.values(), *shape_sigma.values()]).all():
        raise ValueError("shapes and shape_sigma of the same names, finite")
    versions = {str(k): str(v) for k, v in record["versions"].items()}
    degrees, seed, samples = float(record["degrees"]), int(record["seed"]), int(record["samples"])
    return Reference(means, sigma, degrees, seed, samples, versions, shapes, shape_sigma)


def _without_blocks(means: Mapping[str, float]) -> dict[str, float]:
    """Means without those of the grid."""
    return {name: mean for name, mean in means.items() if not name.startswith(_BLOCK)}


def require_same_light(reference: Reference, measured: Reference, false_alarms: float = FALSE_ALARMS) -> None:
    """Require that two references show the same light.

    The difference of each pool is tested as Student's t, with the rate of false alarms divided among the pools
    (Bonferroni). A pool that only one side has counts as different, and so do pixels that are not numbers.

    Parameters
    ----------
    reference
        The stored reference.
    measured
        The reference of the new picture.
    false_alarms
        Rate of false alarms of the verdict.

    Raises
    ------
    AssertionError
        If any pool differs; the message lists these pools.
    """
    earlier = not reference.shapes
    stored, new = (_without_blocks(r.means) if earlier else r.means for r in (reference, measured))
    lines = [measured.not_numbers] if measured.not_numbers else []
    lines += [f"{name}: in one side only" for name in sorted(set(stored) ^ set(new))]
    names = sorted(set(stored) & set(new))
    shapes = sorted(set(reference.shapes) & set(measured.shapes))
    share = false_alarms / (2 * max(len(names) + len(shapes), 1))
    degrees = max(2.0, min(reference.degrees, measured.degrees))
    for name in names:
        difference = new[name] / stored[name] - 1
        sigma = float(np.hypot(np.hypot(reference.sigma[name], measured.sigma[name]), SYSTEMATIC))
        limit = float(student_quantile(share, min(degrees, _BLOCK_DEGREES) if name.startswith(_BLOCK) else degrees))
        if abs(difference) > limit * sigma:
            lines.append(f"{name}: {difference:+.3%} ± {sigma:.3%}")
    for name in shapes:
        difference = measured.shapes[name] - reference.shapes[name]
        sigma = float(np.hypot(np.hypot(reference.shape_sigma[name], measured.shape_sigma[name]), SYSTEMATIC))
        if abs(difference) > float(student_quantile(share, degrees)) * sigma:
            lines.append(f"{name}: {difference:+.3%} ± {sigma:.3%} of the light")
    lines = lines[:_MOST_LINES] + ([f"and {len(lines) - _MOST_LINES} more"] if len(lines) > _MOST_LINES else [])
    if lines:
        versions = ", ".join(f"{key} {value}" for key, value in reference.versions.items())
        head = f"the light differs from the reference (seed {reference.seed}, {reference.samples} samples, {versions}):"
        raise AssertionError("\n  ".join([head, *lines]))
