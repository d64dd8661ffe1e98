"""Common wavelengths of two sides.

Wavelengths of both are used as they are. Where the sides share too few, the ratio of the candidate to the baseline's
mean spectrum is interpolated: a pixel's spectrum is not smooth, the ratio of pictures is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..scene_pictures import NotNumbers, of_any
from .sides import Side, filled_side, in_common_quantity

__all__ = ["Common", "Sums", "band_contrasts", "common_pictures", "common_wavelengths"]

#: Largest distance of wavelengths that count as equal, nm: rounding of files.
_EQUAL_NM = 1e-3
#: Part of the shorter grid that has to be common for a comparison without interpolation.
_MIN_COMMON_PART = 0.5
#: Relative standard deviation of interpolation that is always allowed.
_MIN_INTERPOLATION = 1e-3
#: Fewest pixels that are numbers on both sides: some tests fail with less.
_FEWEST_COMPARED = 48
#: Groups of bands in which independent cubes are compared.
_COLOURS = 3
#: Range of a pixel's radiance over all cubes below which it has no noise, over its largest: rounding.
_NO_NOISE = 1e-6
#: Smallest mean radiance of a band over that of the brightest one, by which ratios are formed.
_MIN_LIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class Sums:
    """Pictures (y, x) summed over all wavelengths, or of one band."""

    #: Radiance of the baseline.
    level: NDArray[np.float64]
    #: Difference.
    difference: NDArray[np.float64]
    #: Variance of the difference.
    variance: NDArray[np.float64]
    #: Standard deviation that pixels have in common; None for 0.
    shared: NDArray[np.float64] | None
    #: Relative standard deviation from differing wavelength grids.
    interpolation: float
    #: Part of all bands.
    part: float
    #: Second differences of ``difference``.
    fine: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Common:
    """Both sides on one grid of wavelengths."""

    #: The candidate.
    candidate: Side
    #: The baseline.
    baseline: Side
    #: (w,) relative standard deviation from interpolation; 0 where there was none.
    interpolation: NDArray[np.float64]
    #: Remarks for the reader.
    notes: tuple[str, ...]
    #: (y, x) pixels that are not numbers on either side, in whose place the nearest ones of both stand; None without.
    missing: NDArray[np.bool_] | None = None
    #: Whether enough pixels are numbers on both sides.
    comparable: bool = True

    @property
    def not_numbers(self) -> dict[str, NotNumbers]:
        """Pixels of one side alone that are not numbers, by the side's name."""
        sides = {"baseline": self.baseline.not_numbers, "candidate": self.candidate.not_numbers}
        result = {}
        for (name, absent), other in zip(sides.items(), reversed(sides.values()), strict=True):
            alone = absent if absent is None or other is None else absent.without(other.pixels)
            if alone is not None and not alone.masked:
                result[name] = alone
        return result

    @property
    def excluded(self) -> NDArray[np.bool_] | None:
        """(y, x) pixels missing or without noise, which belong to no part; None without any.

        A pixel has no noise if it has one value in all cubes of both sides, such as a constant sky. It shows no change,
        and would count as noise of no scatter, whose pixels are all alike.
        """
        if self.baseline.batches is None or self.candidate.batches is None:
            return self.missing
        before, after = self.baseline.batches, self.candidate.batches
        least = np.minimum(before.min(axis=0), after.min(axis=0))
        most = np.maximum(before.max(axis=0), after.max(axis=0))
        still = np.asarray((most - least <= _NO_NOISE * np.maximum(most, -least)).all(axis=-1))
        if still.all() or not still.any():
            return self.missing
        return still if self.missing is None else still | self.missing

    @property
    def cubes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(b, y, x) cubes of both sides over all wavelengths; their means where one has more.

        Pixels that are not numbers are the mean of all, which no value is cut off at.
        """
        before, after = self.baseline.batches, self.candidate.batches
        if before is None or after is None or len(before) != len(after):
            before, after = self.baseline.radiance[None], self.candidate.radiance[None]
        first, second = before.sum(axis=-1), after.sum(axis=-1)
        if self.missing is not None:
            for side in (first, second):
                side[:, self.missing] = side.mean()
        return first, second

    @property
    def apart(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Candidate less baseline of independent cubes (n, g, y, x), and the mean of both (g, y, x).

        The bands are in up to three groups. The number n of cubes is that of the side that has fewer.
        """
        sides = [s.radiance[None] if s.batches is None else s.batches for s in (self.baseline, self.candidate)]
        groups = np.array_split(np.arange(sides[0].shape[-1]), min(_COLOURS, sides[0].shape[-1]))
        before, after = (np.stack([side[..., g].sum(axis=-1) for g in groups], axis=1) for side in sides)
        count = min(len(before), len(after))
        apart = after[:count] - before[:count]
        if self.missing is not None:
            apart[..., self.missing] = 0.0
        return apart, (before.mean(axis=0) + after.mean(axis=0)) / 2


def common_pictures(candidate: Side, baseline: Side) -> Common:
    """Two sides on their common wavelengths, pixels replaced that are not numbers on either.

    Parameters
    ----------
    candidate, baseline
        The sides.

    Returns
    -------
    Common
        As of ``common_wavelengths``.

    Raises
    ------
    InputError
        As of ``common_wavelengths``.
    """
    common = common_wavelengths(candidate, baseline)
    either = of_any([side.not_numbers for side in (common.baseline, common.candidate)])
    if either is None:
        return common
    if (~either.pixels).sum() < _FEWEST_COMPARED:  # the baseline stands on both sides, and no test of it counts
        side, same = common.baseline, replace(common.baseline, not_numbers=common.candidate.not_numbers)
        return replace(common, candidate=same, baseline=side, missing=either.pixels, comparable=False)
    first, second = (filled_side(side, either.pixels) for side in (common.candidate, common.baseline))
    return replace(common, candidate=first, baseline=second, missing=either.pixels)


def common_wavelengths(candidate: Side, baseline: Side) -> Common:
    """Two sides on their common wavelengths; in X, Y, Z where one side is in colour.

    Parameters
    ----------
    candidate, baseline
        The sides.

    Returns
    -------
    Common
        Both at the baseline's wavelengths, or at those that both have.

    Raises
    ------
    InputError
        If the pictures differ in size or their wavelengths do not overlap.
    """
    if candidate.shape != baseline.shape:
        sizes = [f"{side.shape[1]} x {side.shape[0]} px" for side in (candidate, baseline)]
        raise InputError(candidate.source, sizes[0], f"{sizes[1]}, as in {baseline.source}")
    candidate, baseline = in_common_quantity(candidate, baseline)
    if baseline.in_colour:
        return Common(candidate, baseline, np.zeros(3), ())
    a, b = candidate.wavelength_nm, baseline.wavelength_nm
    equal = np.abs(a[:, None] - b) < _EQUAL_NM
    index_a, index_b = np.nonzero(equal)
    if index_a.size >= _MIN_COMMON_PART * min(a.size, b.size):
        count, single = index_a.size, a.size + b.size - 2 * index_a.size
        notes = () if single == 0 else (f"{count} wavelengths in common are compared, {single} are in one only",)
        return Common(candidate.at(index_a), baseline.at(index_b), np.zeros(count), notes)
    inside = (b >= a.min()) & (b <= a.max())
    if inside.sum() < 2 or a.size < 2:
        span = f"{a.min():g} to {a.max():g} nm"
        raise InputError(candidate.source, span, f"wavelengths that overlap {b.min():g} to {b.max():g} nm")
    index = np.flatnonzero(inside)
    return _interpolated(candidate, baseline.at(index))


def _interpolated(candidate: Side, baseline: Side) -> Common:
    """Candidate at the baseline's wavelengths, by its ratio to the baseline's mean spectrum.

    The error is the difference between linear and cubic interpolation of the mean ratio.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    a, b = candidate.wavelength_nm, baseline.wavelength_nm
    mean = baseline.radiance.mean(axis=(0, 1))
    reference = CubicSpline(b, mean, extrapolate=True) if b.size > 2 else lambda x: np.interp(x, b, mean)
    at_a = np.maximum(reference(a), _MIN_LIGHT * mean.max())
    at_b = np.maximum(mean, _MIN_LIGHT * mean.max())
    weights = np.array([np.interp(b, a, row) for row in np.eye(a.size)])
    ratio = candidate.radiance / at_a
    radiance = (ratio @ weights) * at_b
    variance = None if candidate.variance is None else ((candidate.variance / at_a**2) @ weights**2) * at_b**2
    level = ratio.reshape(-1, a.size).mean(axis=0)
    smooth = CubicSpline(a, level)(b) if a.size > 2 else level @ weights
    error = np.abs(smooth - level @ weights) / np.maximum(np.abs(smooth), 1e-12) + _MIN_INTERPOLATION
    note = (
        f"the wavelengths differ: ratios of {candidate.source} are interpolated to those of {baseline.source}, "
        f"which may be off by {error.max():.1%}"
    )
    moved = replace(candidate, wavelength_nm=b, radiance=radiance, variance=variance, batches=None)
    return Common(moved, baseline, error, (note,))


def band_contrasts(band_names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Weights of differences of bands: colours may change while their sum does not.

    Parameters
    ----------
    band_names
        Names of all bands.

    Returns
    -------
    dict
        (w,) weights by name; none for a single band.
    """
    if len(band_names) < 2:
        return {}
    thirds = np.array_split(np.arange(len(band_names)), 3)
    low, middle, high = (np.isin(np.arange(len(band_names)), part) / max(part.size, 1) for part in thirds)
    outer = f"{band_names[0]} against {band_names[-1]}"
    if len(band_names) == 2:
        return {outer: np.array([1.0, -1.0])}
    scale = len(band_names) / 3
    return {outer: scale * (low - high), "middle bands against the others": scale * (middle - (low + high) / 2)}
