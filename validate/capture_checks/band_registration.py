"""Check for a band whose photograph is moved against the other bands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.quality import Suspicion
from cboxlab.calibration.radiometry import register
from numpy.typing import NDArray

from .scene_view import without_gaps

__all__ = ["check_registration"]

#: Largest shift of a band in a sound capture, px: simulated lenses with lateral colour shift bands by up to 0.16 px.
LARGEST_SHIFT_PX = 0.75

#: Smallest suspicious shift between the bands before and after a movement, px: twice the largest of sound captures.
SMALLEST_STEP_PX = 0.35

#: Largest rms distance of the bands before and after it from their means, over the step; of a half from the picture,
#: over the shift: walls of different colours draw the edges of a small picture by up to a sixth of it.
LARGEST_SCATTER_SHARE = 0.25

#: Fewest bands before and after a movement: one alone may be shifted by its filter.
FEWEST_BANDS_OF_STEP = 2

#: Smallest correlation of two bands' edges at which their shift counts.
SMALLEST_CORRELATION = 0.5

#: Fewest bands: the median of fewer does not say which of them moved.
FEWEST_BANDS = 3

#: Smallest picture, px: smaller ones have too few edges.
SMALLEST_PICTURE_PX = 32

#: Largest picture that is compared in every pixel, px: every second pixel of larger ones takes a fourth of the time.
LARGEST_COMPLETE_PX = 160


def check_registration(capture: Capture, bands: CorrectedBands) -> Iterator[Suspicion]:
    """Detect a band shifted relative to the others, and a camera that moved between two bands.

    The median shift of all bands is taken off. A lens changes the magnification between bands, which is no error.
    A smaller movement is detected if it divides the bands, in the order taken, into two groups that agree.

    Parameters
    ----------
    capture
        A capture. Behind a mosaic the gaps of every channel are filled from neighbours.
    bands
        The capture's corrected signals.

    Yields
    ------
    Suspicion
        For each band that is shifted by more than ``LARGEST_SHIFT_PX``; without one, for a movement.
    """
    if len({band.frames for band in capture.manifest.band}) < 2 or len(capture.band_ids) < FEWEST_BANDS:
        return
    if min(capture.shape) < SMALLEST_PICTURE_PX:
        return
    step = 1 + (max(capture.shape) > LARGEST_COMPLETE_PX)
    filled = bands.images["signal"].values if capture.cell is None else without_gaps(bands, capture.cell)
    signal = filled[:, ::step, ::step]
    order = np.argsort([np.nanpercentile(s, 90) for s in signal])
    middle = int(order[len(order) // 2])
    to_middle = [_shift(signal[middle], image) for image in np.delete(signal, middle, axis=0)]
    shifts = step * np.insert(np.array(to_middle), middle, 0.0, axis=0)  # the reference has none against itself
    moved = [*_check_single_bands(capture, signal, shifts, middle, int(order[0]), step)]
    yield from moved or _check_step(capture, shifts)


def _check_single_bands(
    capture: Capture, signal: NDArray[np.float64], shifts: NDArray[np.float64], middle: int, dimmest: int, step: int
) -> Iterator[Suspicion]:
    """Bands that are shifted by more than ``LARGEST_SHIFT_PX`` against the median of all.

    signal : (band, y, x) of every ``step``-th pixel. shifts : (band, 2) px, relative to band ``middle``. dimmest : the
    band with which the middle one is compared.
    """
    usual = np.median(shifts[np.all(np.isfinite(shifts), axis=1)], axis=0)
    for index, (u, v) in enumerate(shifts - usual):
        # If the reference band itself is shifted, compare with another band.
        base = middle if index != middle else dimmest
        if np.hypot(u, v) > LARGEST_SHIFT_PX and (
            _is_alike_in_halves(signal[base], signal[index], shifts[index] / step)
            if index != middle
            else _is_alike_in_halves(signal[index], signal[base], shifts[base] / step)
        ):
            band = capture.band_ids[index]
            yield Suspicion(
                f"the photograph of {band} is moved against the other bands (a moved camera, another capture's frames)",
                f"band[{index}] ({band}).frames",
                f"Its edges lie ({u:+.2f}, {v:+.2f}) px from theirs.",
            )


def _check_step(capture: Capture, shifts: NDArray[np.float64]) -> Iterator[Suspicion]:
    """The movement that divides the bands, in the order taken, into two groups that agree.

    shifts : (band, 2) px; NaN for bands without edges.
    """
    finite = np.flatnonzero(np.all(np.isfinite(shifts), axis=1))
    divisions = []
    for count in range(FEWEST_BANDS_OF_STEP, len(finite) - FEWEST_BANDS_OF_STEP + 1):
        groups = shifts[finite[:count]], shifts[finite[count:]]
        scatter = np.concatenate([group - group.mean(axis=0) for group in groups])
        rms = float(np.sqrt(np.mean(np.sum(scatter**2, axis=1))))
        divisions.append((rms, count, groups[1].mean(axis=0) - groups[0].mean(axis=0)))
    if not divisions:
        return
    rms, count, movement = min(divisions, key=lambda division: division[0])
    size = float(np.hypot(*movement))
    if size > SMALLEST_STEP_PX and rms < LARGEST_SCATTER_SHARE * size:
        before, after = capture.band_ids[finite[count - 1]], capture.band_ids[finite[count]]
        yield Suspicion(
            f"the camera or the box moved between {before} and {after}",
            f"band[{finite[count]}] ({after}).frames and later ones",
            f"The edges of {after} and all later bands lie ({movement[0]:+.2f}, {movement[1]:+.2f}) px from those of "
            f"the bands before; the bands of each group agree within {rms:.2f} px (rms).",
        )


def _shift(reference: NDArray[np.float64], image: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2,) shift of the edges of an image relative to a reference, px; NaN without common edges."""
    result = register(reference, image)
    return result.shift_px if result.converged and result.correlation > SMALLEST_CORRELATION else np.full(2, np.nan)


def _is_alike_in_halves(reference: NDArray[np.float64], image: NDArray[np.float64], shift: NDArray[np.float64]) -> bool:
    """Whether all four halves of the picture have the same shift; noise has none in common.

    The halves are cut where the pictures overlap at whole pixels of the shift. Small halves would lose their border.
    """
    u, v = (int(whole_px) for whole_px in np.rint(shift))
    rows, columns = (n - abs(offset) for n, offset in zip(reference.shape, (v, u), strict=True))
    if min(rows, columns) < SMALLEST_PICTURE_PX // 2:
        return False
    first = reference[max(-v, 0) :, max(-u, 0) :][:rows, :columns]
    second = image[max(v, 0) :, max(u, 0) :][:rows, :columns]
    y, x = rows // 2, columns // 2
    halves = (np.s_[:y], np.s_[y:], np.s_[:, :x], np.s_[:, x:])
    rest, tolerance = shift - (u, v), max(LARGEST_SHIFT_PX / 2, LARGEST_SCATTER_SHARE * float(np.hypot(*shift)))
    return all(np.hypot(*(_shift(first[half], second[half]) - rest)) < tolerance for half in halves)
