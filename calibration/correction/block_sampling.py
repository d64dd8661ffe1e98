"""Error of sums over blocks behind a mosaic, whose pixels of one channel lie apart.

Where an edge crosses a block, the mean of its summed pixels differs from that of the block. Their scatter about a plane
shows the edge if noise and the pixels' own sensitivities are known: the noise from the model of a count, the
sensitivities from a flat. An edge along rows or columns errs most, since it misses the same part of every row. It is in
the means of rows and columns alone, and so the scatter counts in two parts, see ``capture.scatters``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from cboxlab.utils.distributions import chi2_quantile
from cboxlab.utils.median_line import median_line
from numpy.typing import NDArray

from ..capture import BandTable, Capture, FrameTable, Reduction, degrees_of_freedom, scatters
from .dark import DarkLibrary
from .noise import NoiseModel

__all__ = ["edge_errors", "sampling_variance", "variance_by_edges"]

#: Share of the blocks whose pixels scatter by noise as if they saw an edge: it raises the mean variance by 1 %.
_FALSE_EDGES = 0.02

#: Straight edges at random places that give the error of a sum across one: to 5 % of its variance.
_EDGES = 2000

#: Share of these edges along rows or columns, as of a box in front of the camera; the others have any angle.
_UPRIGHT = 0.5

#: Largest angle of an upright edge: a box that is slightly turned, radians.
_UPRIGHT_ANGLE = 0.05

#: Parts of a pixel across, for its coverage by an edge.
_PARTS = 4

#: Smallest error of a mean in the fit, over the contrast of the edge: noise hides smaller ones.
_FAINT = 0.003

#: Rounds of the fit, each with weights of the one before.
_ROUNDS = 4

#: Groups of blocks of similar sums, through whose median scatters a line of the noise goes where there is no flat.
_LEVELS = 40


def sampling_variance(
    capture: Capture, table: FrameTable, dark: DarkLibrary, noise: NoiseModel
) -> NDArray[np.float64] | None:
    """Variance of a table's mean counts because sums behind a mosaic leave pixels out.

    Parameters
    ----------
    capture
        The capture.
    table
        A table of the manifest.
    dark
        The capture's dark levels.
    noise
        Noise model of one count.

    Returns
    -------
    NDArray | None
        (y, x) variance, DN^2, the same in all repeats; None where all pixels count.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    scatter, reduction = capture.block_scatter(table), capture.reduction
    if scatter is None or reduction is None:
        return None
    sums, spread = scatter
    pixels = reduction.summed**2
    band = table.id if isinstance(table, BandTable) else getattr(table, "band", None)
    flats = [flat for flat in capture.manifest.flats if flat.band == band]
    of_flat = capture.block_scatter(flats[0]) if flats else None
    if of_flat is None:
        by_noise = _line_of_medians(sums, spread[1])
    else:
        level, flat_spread = of_flat[0] - dark.bias, of_flat[1][1]
        bright = level > 0
        excess = (flat_spread - noise.variance(level) / pixels)[bright] / (level[bright] / pixels) ** 2
        sensitivities = max(float(np.median(excess)), 0.0) if excess.size else 0.0
        light = np.maximum(sums - dark.bias, 0.0)
        by_noise = noise.variance(light) / pixels + sensitivities * (light / pixels) ** 2
    return variance_by_edges(reduction, spread, by_noise, len(table.frames))


def variance_by_edges(
    reduction: Reduction, spread: NDArray[np.float64], noise: NDArray[np.float64], repeats: int
) -> NDArray[np.float64]:
    """Variance of sums by edges between the pixels that are summed.

    Parameters
    ----------
    reduction
        Window and blocks.
    spread
        (2, y, x) scatters of a block's pixels, DN^2, see ``Reduction.spread``; the mean over repeats.
    noise
        (y, x) scatter that noise and the pixels' sensitivities give, DN^2.
    repeats
        Number of repeats.

    Returns
    -------
    NDArray
        (y, x) variance, DN^2; 0 where the pixels scatter as noise makes them.
    """
    variance = np.zeros_like(noise)
    errors = edge_errors(reduction.side_px, reduction.step_px)
    for scatter, error, degrees in zip(spread, errors, degrees_of_freedom(reduction.summed), strict=True):
        largest = float(chi2_quantile(_FALSE_EDGES / len(errors), repeats * degrees)) / (repeats * degrees)
        variance += error * reduction.summed**4 * np.where(scatter > largest * noise, scatter - noise, 0.0)
    return variance


@lru_cache
def edge_errors(side_px: int, step_px: int) -> tuple[float, float]:
    """Square of the error of the summed pixels' mean, by each of the two scatters.

    Fitted so that the squares are those expected in the mean over edges, each relative to its own expectation: then
    chi-square is 1 where they are counted.

    Parameters
    ----------
    side_px
        Side of a block, px.
    step_px
        Distance of the pixels that are summed, px.

    Returns
    -------
    tuple[float, float]
        Factors for the two scatters.
    """
    from scipy.optimize import nnls  # slow to import, rarely needed

    generator = np.random.default_rng(0)
    position = (np.arange(side_px * _PARTS) + 0.5) / _PARTS - side_px / 2
    shift = generator.uniform(-side_px, side_px, _EDGES) / np.sqrt(2)
    upright = generator.random(_EDGES) < _UPRIGHT
    angle = np.where(upright, _UPRIGHT_ANGLE, np.pi / 4) * generator.random(_EDGES)
    squares, parts = np.empty(_EDGES), np.empty((_EDGES, 2))
    for index, (turn, distance) in enumerate(zip(angle, shift, strict=True)):
        bright = np.add.outer(np.sin(turn) * position, np.cos(turn) * position) > distance
        pixels = bright.reshape(side_px, _PARTS, side_px, _PARTS).mean(axis=(1, 3))
        summed = pixels[::step_px, ::step_px]
        squares[index] = (summed.mean() - pixels.mean()) ** 2
        parts[index] = scatters(summed[None, :, None])[:, 0, 0]
    expected = np.full(_EDGES, squares.mean())
    for _ in range(_ROUNDS):
        weight = 1 / (expected + _FAINT**2)
        factors = nnls(parts * weight[:, None], squares * weight)[0]
        expected = parts @ factors
    return float(factors[0]), float(factors[1])


def _line_of_medians(sums: NDArray[np.float64], spread: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) scatter by noise, linear in the sums, from medians: most blocks see no edge."""
    groups = np.array_split(np.argsort(sums, axis=None), _LEVELS)
    pairs = [np.median([sums.ravel()[g], spread.ravel()[g]], axis=1) for g in groups if g.size]
    slope, constant = median_line(*np.transpose(pairs))
    return np.asarray(np.maximum(constant + slope * sums, 0.0), np.float64)
