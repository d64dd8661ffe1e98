"""Light or charge that pixels exchange: with neighbours, in Gaussians, in copies.

An exchange moves light between pixels and adds none, except at the border, where the outermost pixels are repeated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

__all__ = ["IN_PLACE", "PictureCopy", "exchanges", "number_of_exchanges", "with_moments", "with_streak"]

#: Standard deviations of a halo's Gaussians, px: each twice the one before, so that sums fit any smooth halo.
_HALO_WIDTHS_PX = (1.5, 3.0, 6.0, 12.0, 24.0)

#: Standard deviations of a streak's Gaussians along its line, px.
_STREAK_WIDTHS_PX = (4.0, 10.0, 25.0)

#: Steps (down, right) of charge that leaks to one neighbour: to the right, down, to the left, up.
_LEAK_STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))

#: Distances in which trails fall to 1 / e, px.
_TRAIL_LENGTHS_PX = (0.7, 2.5, 8.0)

#: Width of the repeated border, in standard deviations of a streak: 0.3 % of a Gaussian lies beyond.
_STREAK_ENDS = 3.0


@dataclass(frozen=True)
class PictureCopy:
    """Place of a copy of the picture: mirrored or turned about the middle, then shifted."""

    #: Quarter turns clockwise, 0 to 3.
    turns: int = 0
    #: Whether left and right are exchanged before the turn.
    mirrored: bool = False
    #: Shift down and to the right, px.
    shift_px: tuple[int, int] = (0, 0)
    #: Standard deviation of a blur by a Gaussian, px.
    blur_px: float = 0.0

    @property
    def turned_or_mirrored(self) -> bool:
        """Whether it has another orientation than the picture."""
        return bool(self.turns) or self.mirrored

    def turned(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """The picture mirrored, turned and blurred, not shifted.

        Parameters
        ----------
        signal
            (y, x) the picture; it is square for odd numbers of turns.

        Returns
        -------
        NDArray
            (y, x) the turned picture.
        """
        turned = np.rot90(signal[:, ::-1] if self.mirrored else signal, -self.turns)
        return gaussian_filter(turned, self.blur_px, mode="nearest") if self.blur_px else turned

    def of(self, signal: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The copy, shifted to the place and to its eight neighbours.

        Sums of the nine are copies at parts of a pixel, and copies that are somewhat out of focus. Neighbours of a
        blurred copy are as far away as the blur is wide.

        Parameters
        ----------
        signal
            (y, x) the picture, DN.

        Returns
        -------
        list[NDArray]
            (y, x) each, DN; 0 where the copy does not reach.
        """
        turned = self.turned(signal)
        away = max(round(self.blur_px), 1)
        steps = [(self.shift_px[0] + i, self.shift_px[1] + j) for i in (-away, 0, away) for j in (-away, 0, away)]
        return [_shifted(turned, step) for step in steps]


#: The picture in its place.
IN_PLACE = PictureCopy()


def _shifted(picture: NDArray[np.float64], step: tuple[int, int]) -> NDArray[np.float64]:
    """A picture shifted down and to the right by whole pixels, 0 where it does not reach."""
    return np.asarray(shift(picture, step, order=0, mode="constant"))


def exchanges(
    acts: str,
    signal: NDArray[np.float64],
    radius: int = 1,
    angle_deg: float = 0.0,
    picture_copy: PictureCopy = IN_PLACE,
) -> list[NDArray[np.float64]]:
    """Changes of a picture by a unit of each exchange of a field.

    Parameters
    ----------
    acts
        "neighbours", "moments", "halo", "streak", "trail", "copy", "leak" or "register", see ``Acts``.
    signal
        (y, x) the picture, or a raw frame above dark, DN.
    radius
        Largest distance of neighbours along rows and columns, px.
    angle_deg
        Angle of a streak, of a trail or of a register from the rows downwards, degrees; 0, 90, 180 or 270 but for a
        streak.
    picture_copy
        The copy, with its place.

    Returns
    -------
    list[NDArray]
        (y, x) each, DN, in the order of the field's coefficients.
    """
    if acts == "neighbours":
        return [_with_neighbours(signal, step) for step in _neighbour_steps(radius)]
    if acts == "moments":
        return list(with_moments(signal))
    if acts == "halo":
        return [_with_halo(signal, width) for width in _HALO_WIDTHS_PX]
    if acts == "leak":
        return [_leaked(signal, step) for step in _LEAK_STEPS]
    if acts in ("trail", "register"):
        return [_with_trail(signal, angle_deg, length) for length in _TRAIL_LENGTHS_PX]
    if acts == "copy":
        return picture_copy.of(signal)
    return [with_streak(signal, angle_deg, width) for width in _STREAK_WIDTHS_PX]


def number_of_exchanges(acts: str, radius: int) -> int:
    """Number of exchanges of a field.

    Parameters
    ----------
    acts
        Action of the field, see ``Acts``.
    radius
        Largest distance of neighbours along rows and columns, px.

    Returns
    -------
    int
        Length of the list of ``exchanges``; 1 for a field that exchanges no light.
    """
    several = {
        "neighbours": len(_neighbour_steps(radius)),
        "moments": 3,
        "halo": len(_HALO_WIDTHS_PX),
        "streak": len(_STREAK_WIDTHS_PX),
        "trail": len(_TRAIL_LENGTHS_PX),
        "register": len(_TRAIL_LENGTHS_PX),
        "leak": len(_LEAK_STEPS),
        "copy": 9,
    }
    return several.get(acts, 1)


def _neighbour_steps(radius: int) -> list[tuple[int, int]]:
    """Steps (down, right) to half of the neighbours within a square; the others are opposite."""
    return [(i, j) for i in range(radius + 1) for j in range(-radius, radius + 1) if i > 0 or j > 0]


def _with_neighbours(signal: NDArray[np.float64], step: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) mean of the two neighbours at plus and minus a step, minus the pixel.

    The two are opposite, so the exchange blurs the picture but does not shift it.
    """
    ends = [shift(signal, np.multiply(sign, step), order=0, mode="nearest") for sign in (1, -1)]
    return np.asarray(sum(ends) / 2 - signal)


def with_moments(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exchanges of the three second moments of a small blur.

    With three coefficients they give any small blur of the picture, to second order in its width.

    Parameters
    ----------
    signal
        (y, x) the picture, DN.

    Returns
    -------
    NDArray
        (3, y, x), DN: along rows plus along columns, along rows minus along columns, along the falling minus along the
        rising diagonal.
    """
    across, down = (_with_neighbours(signal, step) for step in ((0, 1), (1, 0)))
    falling, rising = (_with_neighbours(signal, step) for step in ((1, 1), (1, -1)))
    return np.array([across + down, across - down, falling - rising])


def _leaked(frame: NDArray[np.float64], step: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) charge from the neighbour a step before a pixel, minus its own to the next."""
    return np.asarray(shift(frame, step, order=0, mode="nearest") - frame)


def _with_halo(signal: NDArray[np.float64], width_px: float) -> NDArray[np.float64]:
    """(y, x) picture blurred by a round Gaussian, minus the picture."""
    return np.asarray(gaussian_filter(signal, width_px, mode="nearest") - signal)


def _with_trail(signal: NDArray[np.float64], angle_deg: float, length_px: float) -> NDArray[np.float64]:
    """(y, x) charge that comes out behind its pixel, minus what stays behind.

    What comes out falls exponentially with distance.

    ``angle_deg`` is the way along which trails lie: 0 to the right, 90 down, 180 to the left, 270 up.
    """
    from scipy.signal import lfilter  # slow to import

    turns = round(angle_deg / 90)
    along = np.rot90(signal, turns)
    retained = np.exp(-1 / length_px)
    delayed = lfilter([0.0, 1 - retained], [1.0, -retained], along, axis=1)
    return np.asarray(np.rot90(delayed - along, -turns))


def with_streak(signal: NDArray[np.float64], angle_deg: float, width_px: float) -> NDArray[np.float64]:
    """Change of a picture by blur along a line.

    Parameters
    ----------
    signal
        (y, x) the picture, DN. Beyond the border the outermost pixels are repeated.
    angle_deg
        Angle of the line from the rows downwards, degrees.
    width_px
        Standard deviation of the Gaussian along the line, px.

    Returns
    -------
    NDArray
        (y, x) blurred picture minus the picture, DN.
    """
    rows, columns = signal.shape
    border = int(np.ceil(_STREAK_ENDS * width_px))
    wide = np.pad(signal, border, mode="edge")
    down, right = np.fft.fftfreq(wide.shape[0])[:, None], np.fft.rfftfreq(wide.shape[1])
    angle = np.deg2rad(angle_deg)
    along = right * np.cos(angle) + down * np.sin(angle)
    passed = np.exp(-2 * (np.pi * width_px * along) ** 2)
    blurred = np.fft.irfft2(np.fft.rfft2(wide) * passed, wide.shape)
    return np.asarray(blurred[border : border + rows, border : border + columns] - signal)
