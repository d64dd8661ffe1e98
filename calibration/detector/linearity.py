"""Linearity from brackets: black level and exposure offset.

With both, counts are proportional to time: the mean count of an image tile with rate r at the exposure t is

    DN = r (t + exposure_offset) - black_level + dark(t)

A black level above 0 means that the converter subtracts it before digitising; dark frames clipped at 0 do not show
this.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import chi2_tail, robust_sigma
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.optimize import least_squares

from ..capture import Capture, FrameTable, channel_mask
from ..correction import DarkLibrary, NoiseModel
from .response import REPEATABILITY

__all__ = ["Linearity", "measure_linearity"]

#: Width and height of a tile, px.
_TILE_PX = 16
#: Lowest mean count of a tile, DN: below it rounding and clipping at 0 bias the mean.
_MIN_MEAN_DN = 3.0
#: Largest share of saturation in a tile: above it single pixels clip.
_MAX_SATURATION_SHARE = 0.92
#: Assumed relative scatter of tile means beyond the noise model: limits the weight of bright tiles.
_RELATIVE_SCATTER = 0.003
#: Probability below which the scatter of exposures is significantly larger than expected.
_SIGNIFICANCE = 1e-2


@dataclass(frozen=True)
class Linearity(FrozenMappings):
    """Black level and exposure offset, common to all bands. A sigma is one standard deviation."""

    #: Level that the converter subtracts before digitising, DN.
    black_level_dn: float
    #: Its standard deviation, DN.
    black_level_sigma: float
    #: Time by which the shutter is open longer than stated, s.
    exposure_offset_s: float
    #: Its standard deviation, s.
    exposure_offset_sigma: float
    #: By band, root mean square relative deviation of the tile means from proportionality to time.
    rms_deviation: Mapping[str, float]
    #: By band, the same with black level and exposure offset corrected.
    rms_corrected: Mapping[str, float]
    #: Number of tile means used.
    tiles: int


@dataclass(frozen=True, eq=False)
class _TileMeans:
    """Mean counts of n tiles, over all bands and exposures; each tile occurs twice or more."""

    #: (n,) index of the band.
    band: NDArray[np.int64]
    #: (n,) index of the tile, different for each band.
    tile: NDArray[np.int64]
    #: (n,) exposure time, s.
    exposure: NDArray[np.float64]
    #: (n,) mean count above dark, DN.
    mean: NDArray[np.float64]
    #: (n,) standard deviation by noise and ``_RELATIVE_SCATTER``, DN.
    sigma: NDArray[np.float64]
    #: (n,) standard deviation by noise alone, DN.
    noise: NDArray[np.float64]
    #: (n,) repeats averaged.
    frames: NDArray[np.int64]
    #: (n,) index of the table of the manifest.
    table: NDArray[np.int64]


def _tile_means(
    capture: Capture, dark: DarkLibrary, noise: NoiseModel, channels: Mapping[str, str] | None
) -> _TileMeans:
    """Means of the unclipped tiles of all exposures of all bands."""
    width = capture.shape[1]
    rows, columns = np.indices(capture.shape) // _TILE_PX
    tiles = rows * (width // _TILE_PX + 1) + columns
    limit = _MAX_SATURATION_SHARE * capture.saturation_dn
    parts: list[tuple[NDArray, ...]] = []
    for index, band in enumerate(capture.manifest.band):
        in_channel: NDArray[np.bool_] = np.ones(capture.shape, bool)
        if channels is not None and capture.manifest.mosaic is not None:
            in_channel = channel_mask(capture.manifest.mosaic.pattern, capture.shape, channels[band.id])
        tables: tuple[FrameTable, ...] = (band, *capture.brackets(band.id))
        for table in tables:
            counts = capture.frames(table)
            net = counts.mean(axis=0) - dark.at(table.exposure_s)
            # Tiles with a clipped pixel of any channel are left out, since charge spreads between channels.
            usable = (maximum_filter(counts.max(axis=0), 3) < limit) & ((counts.min(axis=0) > 0) | ~in_channel)
            size = np.bincount(tiles[in_channel], minlength=tiles.max() + 1)
            unclipped = (np.bincount(tiles[~usable], minlength=size.size) == 0) & (size > 0)
            mean = np.bincount(tiles[in_channel], net[in_channel], size.size) / np.maximum(size, 1)
            good = np.flatnonzero(unclipped & (mean > _MIN_MEAN_DN))
            variance = noise.variance(mean[good]) / (size[good] * len(table.frames))
            parts.append(
                (
                    np.full(good.size, index),
                    index * size.size + good,
                    np.full(good.size, table.exposure_s),
                    mean[good],
                    np.sqrt(variance + (_RELATIVE_SCATTER * mean[good]) ** 2),
                    np.sqrt(variance),
                    np.full(good.size, len(table.frames)),
                    np.full(good.size, len(parts)),
                )
            )
    owner, tile, *rest = (np.concatenate(column) for column in zip(*parts, strict=True))
    _, tile, members = np.unique(tile, return_inverse=True, return_counts=True)
    several = members[tile] > 1
    _, tile = np.unique(tile[several], return_inverse=True)
    return _TileMeans(owner[several], tile, *(values[several] for values in rest))


def _deviations(means: _TileMeans, black: float, offset: float) -> NDArray[np.float64]:
    """(n,) deviation of the means from proportionality to time at each tile's best rate, DN."""
    signal, time = means.mean + black, means.exposure + offset
    weight = 1 / means.sigma**2
    rate = np.bincount(means.tile, weight * signal * time) / np.bincount(means.tile, weight * time**2)
    return signal - rate[means.tile] * time


def _covariance(
    means: _TileMeans, residual: NDArray[np.float64], jacobian: NDArray[np.float64], freedom: int
) -> NDArray[np.float64]:
    """Covariance (2, 2) of the fit with weights 1 / sigma, from the actual scatter of the means.

    Each mean has its noise or the observed scatter, whichever is larger. All tiles of one exposure share the error
    of lamp and shutter: REPEATABILITY or the scatter of the exposures' mean residuals, whichever is larger.
    """
    weight = 1 / means.sigma**2
    rate_rows = weight * means.exposure**2
    total = np.bincount(means.tile, rate_rows)
    _, shot = np.unique(means.table, return_inverse=True)
    count = int(shot.max()) + 1

    def without_rates(columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns (n, k) in units of sigma, with their projection on the tiles' rates removed."""
        along = means.exposure / means.sigma
        part = np.stack([np.bincount(means.tile, along * column) / total for column in columns.T], axis=1)
        return columns - along[:, None] * part[means.tile]

    common = np.zeros((means.mean.size, count))
    common[np.arange(means.mean.size), shot] = means.mean / means.sigma
    common = without_rates(common)
    sizes = np.bincount(shot, common[np.arange(shot.size), shot] ** 2, count)
    projection = np.bincount(shot, common[np.arange(shot.size), shot] * residual, count)
    exposure_residual = projection / np.maximum(sizes, 1e-12)
    spare = count - np.unique(means.band).size - 2
    scatter = robust_sigma(residual) ** 2 * residual.size / freedom
    relative_sigma = np.maximum(means.noise / means.sigma, np.sqrt(scatter))
    frames = np.array([means.frames[shot == k][0] for k in range(count)])
    jitter = REPEATABILITY**2 / frames
    mean_variance = np.bincount(shot, relative_sigma**2, count) / np.bincount(shot, minlength=count)
    expected = jitter + mean_variance / np.maximum(sizes, 1e-12)
    # With few exposures the observed scatter is uncertain: it is used only if significantly larger.
    misfit = float(np.sum(exposure_residual**2 / expected))
    if spare > 0 and chi2_tail(misfit, spare) < _SIGNIFICANCE:
        jitter = jitter + expected * (misfit / spare - 1)
    lever = np.linalg.inv(jacobian.T @ jacobian) @ jacobian.T
    return np.asarray(
        (lever * relative_sigma**2) @ lever.T + (lever @ common * jitter) @ (lever @ common).T, np.float64
    )


def measure_linearity(
    capture: Capture, dark: DarkLibrary, noise: NoiseModel, channels: Mapping[str, str] | None = None
) -> Linearity | None:
    """Black level and exposure offset by robust least squares over all bands.

    The rate of each tile of 16 x 16 px is eliminated from the fit. Sigmas: see ``_covariance``.

    Parameters
    ----------
    capture
        The capture.
    dark
        The capture's dark levels.
    noise
        Noise model of one count.
    channels
        With a mosaic, the channel of each band; None without one.

    Returns
    -------
    Linearity | None
        None without brackets, for a single exposure time, or for fewer than ten degrees of freedom.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    if not capture.manifest.bracket:
        return None
    means = _tile_means(capture, dark, noise, channels)
    freedom = means.mean.size - np.unique(means.tile).size - 2
    shortest = float(means.exposure.min())
    if freedom < 10 or np.unique(means.exposure).size < 2:
        return None
    fit = least_squares(
        lambda p: _deviations(means, p[0], p[1] * shortest) / means.sigma,
        [0.0, 0.0],
        x_scale=[0.1, 0.01],
        bounds=([-np.inf, -0.9], np.inf),
        loss="soft_l1",
    )
    covariance = _covariance(means, fit.fun, fit.jac, freedom)
    black, offset = float(fit.x[0]), float(fit.x[1] * shortest)

    def by_band(deviations: NDArray[np.float64]) -> dict[str, float]:
        relative = (deviations / means.mean) ** 2
        return {
            identifier: float(np.sqrt(relative[means.band == index].mean()))
            for index, identifier in enumerate(capture.band_ids)
            if np.any(means.band == index)
        }

    return Linearity(
        black_level_dn=black,
        black_level_sigma=float(np.sqrt(covariance[0, 0])),
        exposure_offset_s=offset,
        exposure_offset_sigma=float(np.sqrt(covariance[1, 1]) * shortest),
        rms_deviation=by_band(_deviations(means, 0.0, 0.0)),
        rms_corrected=by_band(_deviations(means, black, offset)),
        tiles=int(means.mean.size),
    )
