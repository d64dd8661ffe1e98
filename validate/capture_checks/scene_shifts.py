"""Shift of every photograph against the rendering of its scene.

Edges between paints of unlike colour bias a comparison of two bands by tenths of a pixel in small pictures. Each band
is therefore compared with the rendering in its own light. With P the rendering and y the photograph,

    y = P (a + b u + c v) + s_u dP/du + s_v dP/dv + m (u dP/du + v dP/dv) + e,

where -s / a is the shift, m a magnification, and b, c and e are slow errors of the light. Both sides are smoothed
alike, behind a mosaic over the pixels of the channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, gaussian_filter

from .scene_view import SceneView

__all__ = ["SceneShifts", "scene_shifts"]

#: Standard deviation of the smoothing, px: less keeps the staircases of a rendering of one ray a pixel.
SMOOTHING_PX = 1.0

#: The same, in addition, over the side of a mosaic's repeat: the pixels of a channel lie so far apart.
SMOOTHING_OF_CELL = 0.25

#: Pixels next to the lamp, the background and the border that are left out: smoothing mixes them with the scene.
BORDER_PX = 4

#: Smallest density of a channel's pixels over the mean one.
SMALLEST_DENSITY = 0.3

#: Light over white that is added to the local light in the weights: noise decides in the dark.
DARK_SHARE = 0.1

#: Robust standard deviations beyond which a deviation counts less.
OUTLIER_SIGMAS = 4.0

#: Rounds of the weights: the shift changes by less than 0.01 px in the last one.
ROUNDS = 5

#: Fewest usable pixels of a band.
FEWEST_PIXELS = 50


@dataclass(frozen=True, eq=False)
class SceneShifts:
    """Shifts of the bands against the rendering."""

    #: (band, 2) shift (u, v), px; NaN for bands without enough pixels.
    shift_px: NDArray[np.float64]

    #: (band,) standard deviation of a shift by the residual of the fit, px.
    sigma_px: NDArray[np.float64]

    #: (band,) size of the photograph over the rendering's, less 1; NaN for bands without enough pixels.
    enlargement: NDArray[np.float64]


def scene_shifts(bands: CorrectedBands, view: SceneView, cell: tuple[int, int] | None) -> SceneShifts:
    """Shift of every band's photograph against the rendering.

    Parameters
    ----------
    bands
        Corrected signals.
    view
        The known scene.
    cell
        (height, width) of the mosaic's repeat, px; None without a mosaic.

    Returns
    -------
    SceneShifts
        Precise for shifts of up to about a pixel of the rendering.
    """
    preview, count = view.preview, len(view.relative)
    shifts, sigmas, sizes = np.full((count, 2), np.nan), np.full(count, np.nan), np.full(count, np.nan)
    inside = binary_erosion(preview.on_surface, iterations=BORDER_PX - 1, border_value=1)
    inside[:BORDER_PX] = inside[-BORDER_PX:] = inside[:, :BORDER_PX] = inside[:, -BORDER_PX:] = False
    thinned = cell is not None and preview.step == 1
    smoothing = SMOOTHING_PX + (SMOOTHING_OF_CELL * max(cell) if thinned and cell is not None else 0.0)
    for band in range(count):
        usable = preview.on_surface & np.isfinite(view.relative[band])
        if thinned:
            usable &= bands.images["mask"].values[band] == 0
        if np.count_nonzero(usable & inside) < FEWEST_PIXELS:
            continue
        measured = np.where(usable, view.relative[band], 0.0)
        fit = _fitted(measured, preview.radiance[band], usable.astype(float), inside, smoothing)
        shifts[band], sigmas[band], sizes[band] = preview.step * fit[0], preview.step * fit[1], fit[2]
    return SceneShifts(shifts, sigmas, sizes)


def _fitted(
    measured: NDArray[np.float64],
    rendered: NDArray[np.float64],
    usable: NDArray[np.float64],
    inside: NDArray[np.bool_],
    smoothing_px: float,
) -> tuple[NDArray[np.float64], float, float]:
    """Shift (2,) of a photograph (y, x) with its standard deviation, px, and its enlargement."""
    density = gaussian_filter(usable, smoothing_px)

    def smooth(image: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(gaussian_filter(image * usable, smoothing_px) / np.maximum(density, 1e-6))

    compared = inside & (density > SMALLEST_DENSITY * usable.mean())
    down, across = (np.asarray(slope, np.float64) for slope in np.gradient(rendered))
    v, u = (np.asarray((axis - axis.mean()) / (max(rendered.shape) / 2)) for axis in np.indices(rendered.shape))
    white = float(np.percentile(rendered[inside], 95)) if inside.any() else 1.0
    maps: tuple[NDArray[np.float64], ...] = (
        rendered,
        rendered * u,
        rendered * v,
        across,
        down,
        across * u + down * v,
        np.full(rendered.shape, white),
    )
    weight = 1 / (smooth(rendered) + DARK_SHARE * white)
    design = np.stack([(smooth(image) * weight)[compared] for image in maps], axis=1)
    target = (smooth(measured) * weight)[compared]
    trust = np.ones(target.size)
    for _ in range(ROUNDS):
        fit = np.linalg.lstsq(design * trust[:, None], target * trust, rcond=None)[0]
        rest = target - design @ fit
        spread = robust_sigma(rest)
        trust = np.sqrt(np.minimum(1.0, OUTLIER_SIGMAS * spread / np.maximum(np.abs(rest), 1e-300)))
    weighted = design * trust[:, None]
    # number of pixels that share one independent value after smoothing
    shared = max(4 * np.pi * smoothing_px**2, 1.0)
    covariance = np.linalg.pinv(weighted.T @ weighted) * float(np.mean((rest * trust) ** 2)) * shared
    scale = float(fit[0]) if fit[0] else np.inf
    sigma = float(np.sqrt(np.mean(np.diag(covariance)[3:5]))) / abs(scale)
    return -fit[3:5] / scale, sigma, -float(fit[5]) / scale / (max(rendered.shape) / 2)
