"""Checks for a photograph that is moved against the others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.quality import Suspicion
from cboxlab.calibration.radiometry import register
from numpy.typing import NDArray

from .scene_shifts import SceneShifts, scene_shifts
from .scene_view import SceneView, without_gaps

__all__ = ["check_registration"]

#: Largest shift of a band in a sound capture, px: simulated lenses with lateral colour shift bands by up to 0.16 px.
LARGEST_SHIFT_PX = 0.75

#: Smallest suspicious shift between the bands before and after a movement, px: twice the largest of sound captures.
SMALLEST_STEP_PX = 0.35

#: Largest rms distance of the bands before and after it from their means, over the step; of a half from the picture,
#: over the shift: walls of different colours draw the edges of a small picture by up to a sixth of it.
LARGEST_SCATTER_SHARE = 0.25

#: Smallest suspicious step of frames that were compared with the rendering of their scene, px: sound ones differ by up
#: to 0.15 px.
SMALLEST_SCENE_STEP_PX = 0.3

#: Smallest such step over its standard deviation: chance exceeds it in one of 25,000 pairs of frames.
STEP_SIGMAS = 4.5

#: Standard deviation of a frame's shift against the rendering by errors of the light, px: 0.02 to 0.07 in five sound
#: captures of two boxes.
SCENE_SIGMA_PX = 0.06

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


def check_registration(capture: Capture, bands: CorrectedBands, view: SceneView | None) -> Iterator[Suspicion]:
    """Detect a band shifted relative to the others, and a camera that moved between two bands.

    The median shift of all bands is taken off. A lens changes the magnification between bands, which is no error.
    A smaller movement is detected if it divides the frames, in the order taken, into two groups that agree.

    Parameters
    ----------
    capture
        A capture. Behind a mosaic the gaps of every channel are filled from neighbours.
    bands
        The capture's corrected signals.
    view
        The capture's known scene; None compares bands of unlike colours, which is less precise.

    Yields
    ------
    Suspicion
        For each band that is shifted by more than ``LARGEST_SHIFT_PX``; without one, for a movement.
    """
    if len({band.frames for band in capture.manifest.band}) < 2 or min(capture.shape) < SMALLEST_PICTURE_PX:
        return
    shifts: NDArray[np.float64] | None = None
    moved: list[Suspicion] = []
    if len(capture.band_ids) >= FEWEST_BANDS:
        shifts, moved = _of_bands(capture, bands)
    if moved:
        yield from moved
    elif view is not None and view.scene.diffuse:
        yield from _check_scene_step(capture, scene_shifts(bands, view, capture.cell))
    elif shifts is not None:
        yield from _check_step(capture, shifts)


def _of_bands(capture: Capture, bands: CorrectedBands) -> tuple[NDArray[np.float64], list[Suspicion]]:
    """Shifts of the bands (band, 2) relative to one, px, and those that are shifted far."""
    step = 1 + (max(capture.shape) > LARGEST_COMPLETE_PX)
    filled = bands.images["signal"].values if capture.cell is None else without_gaps(bands, capture.cell)
    signal = filled[:, ::step, ::step]
    order = np.argsort([np.nanpercentile(s, 90) for s in signal])
    middle = int(order[len(order) // 2])
    to_middle = [_shift(signal[middle], image) for image in np.delete(signal, middle, axis=0)]
    shifts = step * np.insert(np.array(to_middle), middle, 0.0, axis=0)  # the reference has none against itself
    return shifts, [*_check_single_bands(capture, signal, shifts, middle, int(order[0]), step)]


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


def _check_scene_step(capture: Capture, shifts: SceneShifts) -> Iterator[Suspicion]:
    """The movement that divides the frames, in the order taken, into two groups that agree.

    The channels of a mosaic share their frames, and the shift is their weighted mean.
    """
    of_frames: dict[tuple[str, ...], list[int]] = {}
    for index, band in enumerate(capture.manifest.band):
        if np.isfinite(shifts.sigma_px[index]):
            of_frames.setdefault(band.frames, []).append(index)
    members = list(of_frames.values())
    weights = [shifts.sigma_px[of_frame] ** -2.0 for of_frame in members]
    pairs = list(zip(members, weights, strict=True))
    mean = np.array([w @ shifts.shift_px[of_frame] / w.sum() for of_frame, w in pairs])
    variance = np.array([1 / w.sum() + SCENE_SIGMA_PX**2 for w in weights])
    divisions = []
    for count in range(1, len(members)):
        groups = mean[:count], mean[count:]
        scatter = np.concatenate([group - group.mean(axis=0) for group in groups])
        sigma = float(np.sqrt(variance[:count].mean() / count + variance[count:].mean() / (len(members) - count)))
        rms = float(np.sqrt(np.mean(np.sum(scatter**2, axis=1))))
        divisions.append((rms, count, groups[1].mean(axis=0) - groups[0].mean(axis=0), sigma))
    if not divisions:
        return
    rms, count, movement, sigma = min(divisions, key=lambda division: division[0])
    size = float(np.hypot(*movement))
    if size > max(SMALLEST_SCENE_STEP_PX, STEP_SIGMAS * sigma) and rms < LARGEST_SCATTER_SHARE * size:
        before, after = (", ".join(capture.band_ids[k] for k in members[index]) for index in (count - 1, count))
        alone = " (or one filter displaces the picture)" if 1 in (count, len(members) - count) else ""
        yield Suspicion(
            f"the camera or the box moved between {before} and {after}{alone}",
            f"band[{members[count][0]}] ({capture.band_ids[members[count][0]]}).frames and later ones",
            f"Against the rendering of the scene, the edges of the later frames lie ({movement[0]:+.2f}, "
            f"{movement[1]:+.2f}) +- {sigma:.2f} px from those of the frames before.",
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
