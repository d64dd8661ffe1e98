"""Checks of the photographs' orientation and position against a rendering by their camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.quality import Suspicion
from cboxlab.calibration.radiometry import register
from numpy.typing import NDArray

from .scene_shifts import scene_shifts
from .scene_view import SceneView

__all__ = ["check_orientation", "check_survey"]

#: Largest shift of the photograph against the rendering, px: strong effects of the catalogue on the camera stay below.
LARGEST_SHIFT_PX = 1.2

#: Largest shift over the picture's width: a camera moved by the same angle shifts a larger picture by more pixels.
LARGEST_SHIFT_SHARE = 0.006

#: Largest difference of the magnification from 1: a focal length wrong by less is no other picture.
LARGEST_MAGNIFICATION = 0.03

#: Smallest gain of the correlation, in the mean of the bands, by another orientation.
CORRELATION_GAIN = 0.08

#: The same for a single band, whose paints differ from those of another by more.
BAND_CORRELATION_GAIN = 0.15

#: Smallest correlation of the right orientation: it is 0.98 in sound captures, up to 0.41 by a wrong camera.
SMALLEST_CORRELATION = 0.5

#: Smallest correlation of the edges at which position and magnification count: it is 0.98 in sound captures.
SMALLEST_EDGE_CORRELATION = 0.6

#: Fewest pixels of the scene in the picture, for the correlation of all bands.
FEWEST_PIXELS = 100

#: Fewest usable pixels of a band, for its correlation.
FEWEST_BAND_PIXELS = 50

#: Smallest picture for which the position is checked, px.
SMALLEST_PICTURE_PX = 48

#: Smallest share of the scene in the picture for which the position is checked.
SMALLEST_SCENE_SHARE = 0.5

#: Percentile of a band's pixels that is taken as white.
WHITE_PERCENTILE = 99

#: Orientations of a picture other than its own, by the words of the suspicion.
ORIENTATIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "mirrored left to right": lambda image: image[..., ::-1],
    "upside down": lambda image: image[..., ::-1, :],
    "turned by 180 degrees": lambda image: image[..., ::-1, ::-1],
    "exchanged in rows and columns": lambda image: np.swapaxes(image, -1, -2),
    "turned by 90 degrees": lambda image: np.rot90(image, 1, (-2, -1)),
    "turned by 270 degrees": lambda image: np.rot90(image, 3, (-2, -1)),
    "exchanged about the other diagonal": lambda image: np.swapaxes(image[..., ::-1, ::-1], -1, -2),
}


def check_orientation(capture: Capture, view: SceneView | None) -> Iterator[Suspicion]:
    """Check the photographs, as stored and in seven other orientations, against the rendering.

    Parameters
    ----------
    capture
        A capture.
    view
        The capture's known scene; None leaves the check out.

    Yields
    ------
    Suspicion
        For all photographs together, or else for each band that fits better in another orientation.
    """
    if view is None or np.count_nonzero(view.preview.on_surface) < FEWEST_PIXELS or not view.clear.any():
        return
    stored = _correlations(view, view.relative)
    turned = {
        name: _correlations(view, turn(view.relative))
        for name, turn in ORIENTATIONS.items()
        if turn(view.relative).shape == view.relative.shape
    }
    name = max(turned, key=lambda n: float(np.nanmean(turned[n])))
    best, as_stored = float(np.nanmean(turned[name])), float(np.nanmean(stored))
    if best > as_stored + CORRELATION_GAIN and best > SMALLEST_CORRELATION:
        yield Suspicion(
            f"the photographs are {name} against the surveyed points",
            "band.frames, geometry.points",
            f"The picture that the points' camera would see agrees with the frames by a correlation of {as_stored:.2f} "
            f"as they lie, of {best:.2f} when they are {name}.",
        )
        return
    for index, band in enumerate(capture.band_ids):
        for name, values in turned.items():
            if values[index] > stored[index] + BAND_CORRELATION_GAIN and values[index] > SMALLEST_CORRELATION:
                yield Suspicion(
                    f"the photograph of {band} is {name}",
                    f"band[{index}] ({band}).frames",
                    f"It agrees with the scene by a correlation of {stored[index]:.2f} as it lies, of "
                    f"{values[index]:.2f} when it is {name}.",
                )
                break


def _correlations(view: SceneView, photographs: NDArray[np.float64]) -> NDArray[np.float64]:
    """(band,) correlation of the logarithms of photographs (band, y, x) and rendering.

    NaN for a band with few usable pixels.
    """
    with np.errstate(invalid="ignore"):
        logarithm = np.log(np.where(photographs > 0, photographs, np.nan))
    correlations = []
    for photograph, rendering in zip(logarithm, view.preview.radiance, strict=True):
        usable = view.preview.on_surface & (rendering > 0) & np.isfinite(photograph)
        few = np.count_nonzero(usable) <= FEWEST_BAND_PIXELS
        pair = photograph[usable], np.log(rendering[usable])
        correlations.append(np.nan if few else float(np.corrcoef(*pair)[0, 1]))
    return np.array(correlations)


def check_survey(capture: Capture, bands: CorrectedBands, view: SceneView | None) -> Iterator[Suspicion]:
    """Check position and size of the photographs against the rendering by the points' camera.

    Parameters
    ----------
    capture
        A capture. Behind a mosaic the pixels of each channel must confirm a magnification.
    bands
        The capture's corrected signals.
    view
        The capture's known scene; None leaves the check out.

    Yields
    ------
    Suspicion
        For a magnification that differs, and for a shift.
    """
    if view is None or min(capture.shape) < SMALLEST_PICTURE_PX:
        return
    if np.mean(view.preview.on_surface) < SMALLEST_SCENE_SHARE:
        return
    if not view.clear.any():
        return
    fit = register(_mean_rendering(view), _mean_photograph(view))
    if not fit.converged or fit.correlation < SMALLEST_EDGE_CORRELATION:
        return
    enlarged = abs(fit.magnification - 1) > LARGEST_MAGNIFICATION
    if enlarged and capture.cell is not None:
        # filling the gaps of a small picture moves its edges
        of_channels = np.nanmedian(scene_shifts(bands, view, capture.cell).enlargement)
        enlarged = bool(of_channels * np.sign(fit.magnification - 1) > LARGEST_MAGNIFICATION / 2)
    if enlarged:
        yield Suspicion(
            "the photographs were cropped and enlarged, or the points are those of another focal length",
            "band.frames, geometry.points",
            f"The photographs are {fit.magnification:.3f} times as large as what the points' camera sees.",
        )
    u, v = fit.shift_px * view.preview.step
    limit = max(LARGEST_SHIFT_PX, LARGEST_SHIFT_SHARE * capture.shape[1])
    if np.hypot(u, v) > limit:
        yield Suspicion(
            "the points are those of another capture, or the camera was moved far after the survey",
            "geometry.points",
            f"The edges in the photographs lie ({u:+.1f}, {v:+.1f}) px from where the points' camera sees them; below "
            f"{limit:.1f} px is expected.",
        )


def _mean_rendering(view: SceneView) -> NDArray[np.float64]:
    """(y, x) mean of the bands' renderings over white, at most 1; 1 for lamp and background."""
    radiance, on_surface = view.preview.radiance[view.clear], view.preview.on_surface
    white = np.percentile(radiance[:, on_surface], WHITE_PERCENTILE, axis=1)[:, None, None]
    return np.where(on_surface, np.minimum((radiance / white).mean(axis=0), 1.0), 1.0)


def _mean_photograph(view: SceneView) -> NDArray[np.float64]:
    """(y, x) mean of the bands' photographs over white, at most 1; 1 where all are masked."""
    relative = view.relative[view.clear]
    with np.errstate(invalid="ignore"):
        white = np.nanpercentile(relative, WHITE_PERCENTILE, axis=(1, 2))[:, None, None]
        parts = relative / white
    photograph = np.nansum(parts, axis=0) / np.maximum(np.isfinite(parts).sum(axis=0), 1)
    photograph[~np.any(np.isfinite(parts), axis=0)] = 1.0
    return np.minimum(photograph, 1.0)
