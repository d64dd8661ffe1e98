"""Means over surfaces and bands of a picture, as a small JSON file beside a renderer's tests.

A reference is known to 0.05 %, and says with which seed, samples and versions it was made.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import OwnMappings
from cboxlab.utils.input_files import read_json
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.stats import t

from ..regress import FALSE_ALARMS, SYSTEMATIC, Side, strata_of

__all__ = ["Reference", "measured_reference", "read_reference", "require_same_light", "write_reference"]

FORMAT = "light-reference/1"
#: Largest relative standard deviation of a mean of a reference.
LARGEST_SIGMA = 5e-4
#: Fewer pixels make no mean.
_FEWEST = 12


@dataclass(frozen=True)
class Reference(OwnMappings):
    """means : radiance by pool ("surface: floor", "band: 550", "whole picture"), summed over the bands but of a band.
    sigma : relative standard deviations, with ``degrees`` of freedom or more.
    seed, samples, versions : of the renderer, as its user states them.
    """

    means: Mapping[str, float]
    sigma: Mapping[str, float]
    degrees: float
    seed: int
    samples: int
    versions: Mapping[str, str]


def measured_reference(side: Side, seed: int, samples: int, versions: Mapping[str, str]) -> Reference:
    """The means of a picture, the lamp left out, and of surfaces without the pixels at their edges.

    The pixels of a mean are told by the map of surfaces alone, never by the radiance, which is noisy.
    Raises InputError for a picture without standard errors, whose means cannot be judged.
    """
    if side.variance is None:
        raise InputError(
            side.source,
            "no standard error",
            "a cube with standard_error, or several cubes of other seeds",
            "Without them nothing says how well its means are known.",
        )
    body, surfaces = _places(side)
    ones = np.ones(len(side.bands))
    pools = {"whole picture": (body, ones)}
    pools |= {f"surface: {name}": (mask, ones) for name, mask in surfaces.items()}
    pools |= {f"band: {name}": (body, row) for name, row in zip(side.bands, np.eye(ones.size), strict=True)}
    means, sigma = {}, {}
    for name, (mask, weights) in pools.items():
        mean = float((side.radiance[mask] @ weights).mean()) if mask.sum() >= _FEWEST else 0.0
        if mean > 0:
            means[name], sigma[name] = mean, _deviation(side.variance[mask], weights) / mean
    own = {"cboxlab": version("cboxlab"), "python": platform.python_version()}
    # every pixel of a pool brings its own
    return Reference(means, sigma, side.degrees * _FEWEST, seed, samples, {**own, **versions})


def _places(side: Side) -> tuple[NDArray[np.bool_], dict[str, NDArray[np.bool_]]]:
    """(y, x) all but the lamp, and each surface away from its edges; of a cube without a map, what is not a lamp."""
    known = side.surfaces
    if known is None:
        return strata_of(side.radiance.sum(axis=-1), None).body, {}
    inside = maximum_filter(known.index, 3) == minimum_filter(known.index, 3)
    inside[[0, -1], :] = inside[:, [0, -1]] = False
    surfaces = {name: (known.index == i) & inside for i, name in enumerate(known.names)}
    return ~known.lamp, surfaces


def _deviation(variance: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Of the mean of weighted sums over bands, whose errors are taken as fully correlated; pixels are independent."""
    return float(np.sqrt(((np.sqrt(variance) @ weights) ** 2).sum())) / len(variance)


def write_reference(path: Path, reference: Reference) -> None:
    """Raises InputError unless every mean is known to 0.05 %."""
    worst = max(reference.sigma, key=lambda name: reference.sigma[name])
    if reference.sigma[worst] > LARGEST_SIGMA:
        raise InputError(
            path,
            f"{worst} known to {reference.sigma[worst]:.3%}",
            f"{LARGEST_SIGMA:.2%} or better",
            f"Take about {np.ceil((reference.sigma[worst] / LARGEST_SIGMA) ** 2):.0f} times the samples.",
        )
    with replacing(path) as temporary:
        temporary.write_text(json.dumps({"format": FORMAT, **asdict(reference)}, indent=1) + "\n", encoding="utf-8")


def read_reference(path: Path) -> Reference:
    """Raises InputError for a missing file, and for one that is no reference."""
    record = read_json(path, "a stored reference")
    try:
        return _checked(record)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(path, f"no reference ({type(error).__name__}: {error})", f"format {FORMAT}") from None


def _checked(record: dict[str, Any]) -> Reference:
    if record["format"] != FORMAT:
        raise ValueError(record["format"])
    means, sigma = ({str(k): float(v) for k, v in record[key].items()} for key in ("means", "sigma"))
    values = np.array([*means.values(), *sigma.values()])
    if not means or set(means) != set(sigma) or not np.isfinite(values).all() or (values < 0).any():
        raise ValueError("means and sigma of the same pools, 0 or more")
    versions = {str(k): str(v) for k, v in record["versions"].items()}
    return Reference(means, sigma, float(record["degrees"]), int(record["seed"]), int(record["samples"]), versions)


def require_same_light(reference: Reference, measured: Reference, false_alarms: float = FALSE_ALARMS) -> None:
    """Raise AssertionError that names the pools whose means differ by more than both uncertainties explain.

    Student's t of each; the rate of false alarms is shared among the pools (Bonferroni). Pools that only one
    side has differ, too.
    """
    lines = [f"{name}: in one side only" for name in sorted(set(reference.means) ^ set(measured.means))]
    names = sorted(set(reference.means) & set(measured.means))
    degrees = max(2.0, min(reference.degrees, measured.degrees))
    threshold = float(t.isf(false_alarms / (2 * max(len(names), 1)), degrees))
    for name in names:
        difference = measured.means[name] / reference.means[name] - 1
        sigma = float(np.hypot(np.hypot(reference.sigma[name], measured.sigma[name]), SYSTEMATIC))
        if abs(difference) > threshold * sigma:
            lines.append(f"{name}: {difference:+.3%} ± {sigma:.3%}")
    if lines:
        made = ", ".join(f"{key} {value}" for key, value in reference.versions.items())
        head = f"the light differs from the reference (seed {reference.seed}, {reference.samples} samples, {made}):"
        raise AssertionError("\n  ".join([head, *lines]))
