"""Check for a band whose photograph is moved against the other bands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.quality import Suspicion
from cboxlab.calibration.radiometry import register
from numpy.typing import NDArray

__all__ = ["check_registration"]

#: Largest shift of a band in a sound capture, px: simulated lenses with lateral colour shift bands by up to 0.16 px.
LARGEST_SHIFT_PX = 0.75

#: Smallest correlation of two bands' edges at which their shift counts.
SMALLEST_CORRELATION = 0.5

#: Fewest bands: the median of fewer does not say which of them moved.
FEWEST_BANDS = 3

#: Smallest picture, px: smaller ones have too few edges.
SMALLEST_PICTURE_PX = 32

#: Largest picture that is compared in every pixel, px: every second pixel of larger ones takes a fourth of the time.
LARGEST_COMPLETE_PX = 160


def check_registration(capture: Capture, bands: CorrectedBands) -> Iterator[Suspicion]:
    """Detect a band shifted relative to the others.

    The median shift of all bands is taken off. A lens changes the magnification between bands, which is no error.

    Parameters
    ----------
    capture
        A capture; a sensor with a mosaic is not checked.
    bands
        Its corrected signals.

    Yields
    ------
    Suspicion
        For each band that is shifted by more than ``LARGEST_SHIFT_PX``.
    """
    if capture.manifest.mosaic is not None or len(capture.band_ids) < FEWEST_BANDS:
        return
    if min(capture.shape) < SMALLEST_PICTURE_PX:
        return
    step = 1 + (max(capture.shape) > LARGEST_COMPLETE_PX)
    signal = bands.images["signal"].values[:, ::step, ::step]
    order = np.argsort([np.nanpercentile(s, 90) for s in signal])
    middle = int(order[len(order) // 2])
    to_middle = [_shift(signal[middle], image) for image in np.delete(signal, middle, axis=0)]
    shifts = step * np.insert(np.array(to_middle), middle, 0.0, axis=0)  # the reference has none against itself
    usual = np.median(shifts[np.all(np.isfinite(shifts), axis=1)], axis=0)
    for index, (u, v) in enumerate(shifts - usual):
        # If the reference band itself is shifted, compare with another band.
        base = middle if index != middle else int(order[0])
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


def _shift(reference: NDArray[np.float64], image: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2,) shift of the edges of an image relative to a reference, px; NaN without common edges."""
    result = register(reference, image)
    return result.shift_px if result.found and result.correlation > SMALLEST_CORRELATION else np.full(2, np.nan)


def _is_alike_in_halves(reference: NDArray[np.float64], image: NDArray[np.float64], shift: NDArray[np.float64]) -> bool:
    """Whether all four halves of the picture have the same shift; noise has none in common."""
    v, u = (n // 2 for n in reference.shape)
    halves = (np.s_[:v], np.s_[v:], np.s_[:, :u], np.s_[:, u:])
    return all(np.hypot(*(_shift(reference[half], image[half]) - shift)) < LARGEST_SHIFT_PX / 2 for half in halves)
