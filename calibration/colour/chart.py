"""Patches of a ColorChecker, found in the corrected bands by OpenCV's detector."""

from __future__ import annotations

import cv2
import numpy as np
from cboxlab.scenes.wavelength_grid import FILTER_GRID
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..capture import Capture
from ..correction import CorrectedBands
from ..instrument import Mask, interpolated_channel

__all__ = ["chart_outlines", "find_chart"]

#: Wavelengths of the three bands of the picture in which the chart is found, nm: primaries of a display, B, G, R.
_PRIMARIES_NM = (455.0, 545.0, 610.0)

#: Channels that stand for them where a band states no filter.
_PRIMARY_CHANNELS = ("B", "G", "R")

#: Width and height of the enlarged picture at least, px: charts of a few hundred pixels are found as large ones are.
_SMALLEST_PX = 800

#: Width and height of the reduced picture at most, px: the detector takes seconds for a picture of 4 megapixels.
_LARGEST_PX = 1600

#: Half a side of a patch over the distance between patches: patches of 40 mm are 44 mm apart.
_HALF_PATCH = 20 / 44

#: Half a side of the part that must be uniform in the picture, in the same unit.
_HALF_UNIFORM = 0.42

#: Samples of that part across and down.
_SAMPLES = 9

#: Percentile of each band that becomes white: a lamp or a highlight in the picture must not darken the chart.
_WHITE_PERCENTILE = 99.0

#: Patches of the chart.
_PATCHES = 24

#: (24, 2) centres of the patches, in distances between patches, rows of six.
_CENTRES = np.stack([*np.meshgrid(np.arange(6.0), np.arange(4.0))], axis=-1).reshape(-1, 2)

#: Positions among the patches of the four in the corners.
_CORNERS = [0, 5, 23, 18]


def find_chart(capture: Capture, bands: CorrectedBands) -> NDArray[np.uint8]:
    """Label image of a ColorChecker of 24 patches.

    Parameters
    ----------
    capture
        The capture.
    bands
        The capture's corrected bands.

    Returns
    -------
    NDArray
        (y, x) label of each pixel, uint8: 1 to 24, left to right and top to bottom from dark skin to black; 0 for no
        patch.

    Raises
    ------
    InputError
        As of ``chart_outlines``.
    """
    labels = np.zeros(bands.images["signal"].shape[1:], np.uint8)
    for index, quad in enumerate(chart_outlines(capture, bands)):
        cv2.fillConvexPoly(labels, np.rint(quad).astype(np.int32), index + 1)
    return labels


def chart_outlines(capture: Capture, bands: CorrectedBands) -> NDArray[np.float64]:
    """Outlines of the patches of a ColorChecker in the picture.

    Parameters
    ----------
    capture
        The capture.
    bands
        The capture's corrected bands.

    Returns
    -------
    NDArray
        (24, 4, 2) corners (u, v) of the patches, px, left to right and top to bottom from dark skin to black.

    Raises
    ------
    InputError
        If the picture has no three bands for its colours, or no chart is found in it.
    """
    where = capture.folder / "capture.toml: labels"
    picture = _picture(capture, bands)
    size = np.array(picture.shape[:2])
    scale = max(_SMALLEST_PX / size.max(), 1.0) * min(_LARGEST_PX / size.max(), 1.0)
    method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    resized = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=method))
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    detected = detector.process(resized, 1)
    corners = np.asarray(detector.getBestColorChecker().getColorCharts()) if detected else np.empty((0, 2))
    if len(corners) != 4 * _PATCHES:
        raise InputError(
            where,
            "no image and no chart of 24 patches that could be found",
            "a whole ColorChecker in view, or a label image",
            "Turn the chart to the camera, or write image = 'labels.png' with a label per pixel.",
        )
    corners = _refined(picture, _before_resize(corners.reshape(_PATCHES, 4, 2), scale).mean(axis=1))
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return _projected(corners, _CENTRES[:, None] + _HALF_PATCH * square)


def _before_resize(resized_px: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """Positions before OpenCV's resize by a scale, px: u' + 1/2 = scale (u + 1/2)."""
    return (resized_px + 0.5) / scale - 0.5


def _projected(corners: NDArray[np.float64], chart: NDArray[np.float64]) -> NDArray[np.float64]:
    """Image positions (..., 2) of positions on the chart, px, from its four corner patches."""
    matrix = cv2.getPerspectiveTransform(_CENTRES[_CORNERS].astype(np.float32), corners.astype(np.float32))
    homogeneous = np.concatenate([chart, np.ones((*chart.shape[:-1], 1))], axis=-1) @ np.asarray(matrix, float).T
    return np.asarray(homogeneous[..., :2] / homogeneous[..., 2:])


def _refined(picture: NDArray[np.uint8], centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centres (4, 2) of the corner patches, px, that make the patches the most uniform.

    OpenCV's centres are off by up to a tenth of a patch. A patch that reaches over its edge has a larger variance.
    """
    matrix, _ = cv2.findHomography(_CENTRES, centres)
    start = cv2.perspectiveTransform(_CENTRES[None, _CORNERS], matrix)[0]
    grid = np.linspace(-_HALF_UNIFORM, _HALF_UNIFORM, _SAMPLES)
    within = np.stack([*np.meshgrid(grid, grid)], axis=-1).reshape(-1, 2)
    points = _CENTRES[:, None] + within
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32)
    pitch = float(np.linalg.norm(start[1] - start[0])) / 5

    def unevenness(shift: NDArray[np.float64]) -> float:
        uv = _projected(start + pitch * shift.reshape(4, 2), points).astype(np.float32)
        values = cv2.remap(smooth, uv[..., 0], uv[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return float(np.mean(np.var(values, axis=1)))

    simplex = np.concatenate([np.zeros((1, 8)), 0.05 * np.eye(8)])
    solution = minimize(
        unevenness, np.zeros(8), method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 2000}
    )
    return np.asarray(start + pitch * solution.x.reshape(4, 2))


def _picture(capture: Capture, bands: CorrectedBands) -> NDArray[np.uint8]:
    """(y, x, 3) picture in the order blue, green, red, with a display's tone curve."""
    layers = []
    for index in _three_bands(capture, bands):
        signal = bands.images["signal"].values[index]
        if capture.cell is not None:
            in_channel = (bands.images["mask"].values[index] & Mask.OTHER_CHANNEL) == 0
            signal = interpolated_channel(signal, in_channel, capture.cell)
        layers.append(signal / max(float(np.percentile(signal, _WHITE_PERCENTILE)), np.finfo(float).tiny))
    return np.round(255 * np.clip(np.stack(layers, axis=-1), 0, 1) ** (1 / 2.2)).astype(np.uint8)


def _three_bands(capture: Capture, bands: CorrectedBands) -> list[int]:
    """Positions of the bands nearest to the primaries of a display, by filter or by channel."""
    filters = [band.transmittance for band in capture.manifest.band]
    channels = [] if capture.cell is None else [str(c)[0] for c in bands.images["channel"].values]
    if set(_PRIMARY_CHANNELS) <= set(channels) and len(set(filters)) == 1:
        return [channels.index(channel) for channel in _PRIMARY_CHANNELS]
    if None in filters or len(filters) < len(_PRIMARIES_NM):
        raise InputError(
            capture.folder / "capture.toml: labels",
            "no image, and no bands in which the chart's colours could be seen",
            "three bands with filters, or the channels R, G and B, or a label image",
        )
    curves = np.stack([capture.light(str(name)).at(FILTER_GRID.nm) for name in filters])
    centres = curves @ FILTER_GRID.nm / curves.sum(axis=1)
    nearest = [int(np.argmin(np.abs(centres - primary))) for primary in _PRIMARIES_NM]
    if len(set(nearest)) != len(nearest):
        raise InputError(
            capture.folder / "capture.toml: labels",
            f"no image, and bands at {', '.join(f'{nm:.0f}' for nm in centres)} nm",
            "bands near 455, 545 and 610 nm, in which the chart's colours can be seen, or a label image",
        )
    return nearest
