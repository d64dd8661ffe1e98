"""Two sides brought to wavelengths in common.

Where both have a wavelength it is used as it is. Where they share too few, the candidate's spectrum over a smooth
reference (each pixel's own spectrum on the other grid is not smooth, the ratio of pictures is) is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .sides import Side, in_common_quantity

__all__ = ["Common", "common_wavelengths"]

#: Wavelengths nearer than this are the same, nm.
_SAME_NM = 1e-3
#: So many equal wavelengths, or this part of the shorter grid, are enough to compare by them alone.
_ENOUGH = 0.5


@dataclass(frozen=True, eq=False)
class Common:
    """Both sides on one grid. interpolation : relative standard deviation allowed for it, by wavelength (w,)."""

    candidate: Side
    baseline: Side
    interpolation: NDArray[np.float64]
    notes: tuple[str, ...]


def common_wavelengths(candidate: Side, baseline: Side) -> Common:
    """In X, Y, Z where one side is in colour.

    Raises InputError where the pictures differ in size or their wavelengths do not overlap.
    """
    if candidate.shape != baseline.shape:
        sizes = [f"{side.shape[1]} x {side.shape[0]} px" for side in (candidate, baseline)]
        raise InputError(candidate.source, sizes[0], f"{sizes[1]}, as in {baseline.source}")
    candidate, baseline = in_common_quantity(candidate, baseline)
    if baseline.in_colour:
        return Common(candidate, baseline, np.zeros(3), ())
    a, b = candidate.wavelength_nm, baseline.wavelength_nm
    equal = np.abs(a[:, None] - b) < _SAME_NM
    here, there = np.nonzero(equal)
    if here.size >= _ENOUGH * min(a.size, b.size):
        left = a.size + b.size - 2 * here.size
        notes = () if left == 0 else (f"{here.size} wavelengths in common are compared, {left} are in one only",)
        return Common(candidate.at(here), baseline.at(there), np.zeros(here.size), notes)
    inside = (b >= a.min()) & (b <= a.max())
    if inside.sum() < 2 or a.size < 2:
        found = f"{a.min():g} to {a.max():g} nm"
        raise InputError(candidate.source, found, f"wavelengths that overlap {b.min():g} to {b.max():g} nm")
    index = np.flatnonzero(inside)
    return _interpolated(candidate, baseline.at(index))


def _interpolated(candidate: Side, baseline: Side) -> Common:
    """The candidate at the baseline's wavelengths: the ratio of both to the baseline's mean spectrum is smooth."""
    a, b = candidate.wavelength_nm, baseline.wavelength_nm
    mean = baseline.radiance.mean(axis=(0, 1))
    reference = CubicSpline(b, mean, extrapolate=True) if b.size > 2 else lambda x: np.interp(x, b, mean)
    at_a = np.maximum(reference(a), 1e-3 * mean.max())
    at_b = np.maximum(mean, 1e-3 * mean.max())
    weights = np.array([np.interp(b, a, row) for row in np.eye(a.size)])
    ratio = candidate.radiance / at_a
    radiance = (ratio @ weights) * at_b
    variance = None if candidate.variance is None else ((candidate.variance / at_a**2) @ weights**2) * at_b**2
    level = ratio.reshape(-1, a.size).mean(axis=0)
    smooth = CubicSpline(a, level)(b) if a.size > 2 else level @ weights
    error = np.abs(smooth - level @ weights) / np.maximum(np.abs(smooth), 1e-12) + 1e-3
    note = (
        f"the wavelengths differ: ratios of {candidate.source} are interpolated to those of {baseline.source}, "
        f"which may be off by {error.max():.1%}"
    )
    moved = replace(candidate, wavelength_nm=b, radiance=radiance, variance=variance)
    return Common(moved, baseline, error, (note,))
