"""Light that a pixel exchanges with others: neighbours on opposite sides, wide Gaussians, and those along a line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

__all__ = ["exchanges", "number_of_exchanges", "with_moments", "with_streak"]

#: Standard deviations of the Gaussians of a halo, px.
_HALO_WIDTHS_PX = (1.5, 3.0, 6.0, 12.0, 24.0)

#: The same of a streak, along its line.
_STREAK_WIDTHS_PX = (4.0, 10.0, 25.0)

#: A streak's Gaussian ends at so many standard deviations.
_STREAK_ENDS = 3.0


def exchanges(
    acts: str, signal: NDArray[np.float64], radius: int = 1, angle_deg: float = 0.0
) -> list[NDArray[np.float64]]:
    """(y, x) each, what a picture changes by a unit of each exchange of a field that acts so, in the order of its
    coefficients. radius, angle_deg : see ``FittedField``."""
    if acts == "neighbours":
        return [_with_neighbours(signal, step) for step in _neighbour_steps(radius)]
    if acts == "moments":
        return list(with_moments(signal))
    if acts == "halo":
        return [_with_halo(signal, width) for width in _HALO_WIDTHS_PX]
    return [with_streak(signal, angle_deg, width) for width in _STREAK_WIDTHS_PX]


def number_of_exchanges(acts: str, radius: int) -> int:
    """How many of them there are; 1 for a field that exchanges nothing."""
    several = {
        "neighbours": len(_neighbour_steps(radius)),
        "moments": 3,
        "halo": len(_HALO_WIDTHS_PX),
        "streak": len(_STREAK_WIDTHS_PX),
    }
    return several.get(acts, 1)


def _neighbour_steps(radius: int) -> list[tuple[int, int]]:
    """(down, right) to half of the neighbours within a square; the others are opposite to them."""
    return [(i, j) for i in range(radius + 1) for j in range(-radius, radius + 1) if i > 0 or j > 0]


def _with_neighbours(signal: NDArray[np.float64], step: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) mean of the two neighbours at a step less the pixel: such an exchange moves nothing."""
    ends = [shift(signal, np.multiply(sign, step), order=0, mode="nearest") for sign in (1, -1)]
    return np.asarray(sum(ends) / 2 - signal)


def with_moments(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, y, x) exchange all around, along rows less along columns, along the falling less along the rising diagonal.

    Three numbers make any small blur of the whole picture, to second order in its width.
    """
    across, down = (_with_neighbours(signal, step) for step in ((0, 1), (1, 0)))
    falling, rising = (_with_neighbours(signal, step) for step in ((1, 1), (1, -1)))
    return np.array([across + down, across - down, falling - rising])


def _with_halo(signal: NDArray[np.float64], width_px: float) -> NDArray[np.float64]:
    """(y, x) the picture blurred by a Gaussian less itself."""
    return np.asarray(gaussian_filter(signal, width_px, mode="nearest") - signal)


def with_streak(signal: NDArray[np.float64], angle_deg: float, width_px: float) -> NDArray[np.float64]:
    """(y, x) the picture blurred by a Gaussian along a line, at an angle from the rows, downwards, less itself."""
    rows, columns = signal.shape
    border = int(np.ceil(_STREAK_ENDS * width_px))
    wide = np.pad(signal, border, mode="edge")
    down, right = np.fft.fftfreq(wide.shape[0])[:, None], np.fft.rfftfreq(wide.shape[1])
    angle = np.deg2rad(angle_deg)
    along = right * np.cos(angle) + down * np.sin(angle)
    passed = np.exp(-2 * (np.pi * width_px * along) ** 2)
    blurred = np.fft.irfft2(np.fft.rfft2(wide) * passed, wide.shape)
    return np.asarray(blurred[border : border + rows, border : border + columns] - signal)
