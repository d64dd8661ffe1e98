"""Several exposures of one band merged into one measurement.

Exposure j shows y_j = a_j S + noise, with S the signal at the band's own exposure and a_j the ratio of the times. Its
variance v_j = c0_j + c1_j a_j S is known, so that the maximum likelihood is

    S = sum(w_j a_j y_j) / sum(w_j a_j^2),    w_j = 1 / v_j(S),

solved by repetition. For pure shot noise it is all electrons over all time. The weights take S from the mean over a
pixel's neighbourhood, so that they do not depend on its own noise.

A pixel's own counts do not decide either whether it is below saturation: those whose noise is positive would be left
out, and the mean of the others be too low. Its neighbours of the same channel decide, whose noise is independent. An
exposure is used where none of them comes near saturation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, uniform_filter

from ..capture import BandTable, BracketTable, Capture
from .correction import CorrectedFrames, FlatField, correct
from .dark import DarkLibrary
from .noise import NoiseModel

__all__ = [
    "Exposure",
    "MergedFrames",
    "exposures_of",
    "merge_exposures",
    "merged_tables",
    "neighbourhood_mean",
]

#: Standard deviations of noise below saturation that the neighbours of a pixel must keep: noise exceeds it once in 1e9.
_SATURATION_SIGMAS = 6.0
#: Repetitions of the weights: they depend on the signal weakly.
_ROUNDS = 4
#: Width of the neighbourhood that gives the weights their signal, in pixels of one channel.
_NEIGHBOURHOOD = 5


@dataclass(frozen=True, eq=False)
class Exposure:
    """One exposure of a band."""

    #: Table of the manifest.
    table: BandTable | BracketTable
    #: Its exposure time over that of the band.
    ratio: float
    #: Mean of its repeats, corrected.
    frames: CorrectedFrames
    #: (y, x) True where it can be used.
    unsaturated: NDArray[np.bool_]
    #: Relative standard deviation of its repeats' levels, noise included; NaN without repeats.
    repeatability: float = float("nan")


@dataclass(frozen=True, eq=False)
class MergedFrames:
    """Exposures of a band as one measurement at the band's exposure time."""

    #: Signal, variance and saturation at the band's exposure time.
    frames: CorrectedFrames
    #: Exposure tables, the band's own first.
    tables: tuple[BandTable | BracketTable, ...]
    #: (exposure,) exposure times over that of the band.
    ratios: NDArray[np.float64]
    #: (exposure, y, x) weights on the exposures' signals; the sum of weights times ratios is 1.
    weights: NDArray[np.float64]


def merged_tables(capture: Capture, band: BandTable) -> tuple[BandTable | BracketTable, ...]:
    """Tables whose frames differ from a band's in the exposure time alone.

    Parameters
    ----------
    capture
        The capture.
    band
        One of its bands.

    Returns
    -------
    tuple
        The band itself, then its brackets of the same aperture and image distance.
    """
    optics = capture.f_number(band), capture.image_distance_mm(band)
    same = [b for b in capture.brackets(band.id) if (capture.f_number(b), capture.image_distance_mm(b)) == optics]
    return (band, *same)


def _lattice(cell: tuple[int, int]) -> NDArray[np.bool_]:
    """Neighbours of a pixel that have its channel for certain, without itself."""
    height, width = cell
    pattern = np.zeros((2 * height + 1, 2 * width + 1), bool)
    pattern[::height, ::width] = True
    pattern[height, width] = False
    return pattern


def exposures_of(
    capture: Capture,
    tables: Sequence[BandTable | BracketTable],
    flat: FlatField,
    dark: DarkLibrary,
    noise: NoiseModel,
) -> tuple[Exposure, ...]:
    """Correct every exposure of a band and find the pixels in which it can be used.

    Parameters
    ----------
    capture
        The capture.
    tables
        Tables of one band, its own first, see ``merged_tables``.
    flat
        Flat field of the band.
    dark
        The dark levels.
    noise
        Noise model of one count.

    Returns
    -------
    tuple
        In the order of the tables.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    neighbours = _lattice(capture.cell or (1, 1))
    # charge spreads to neighbours of other channels, too
    spread = np.ones((3, 3), bool) if capture.cell is not None else np.ones((1, 1), bool)
    exposures = []
    for table in tables:
        frames = correct(capture, table, flat, dark, noise)
        sigma = float(np.sqrt(noise.variance(capture.saturation_dn) / len(table.frames)))
        near = capture.frames(table).mean(axis=0) >= capture.saturation_dn - _SATURATION_SIGMAS * sigma
        unsaturated = ~binary_dilation(near, neighbours) & ~binary_dilation(frames.saturated, spread)
        ratio = table.exposure_s / tables[0].exposure_s
        repeatability = _repeatability(capture, table, dark, unsaturated)
        exposures.append(Exposure(table, ratio, frames, unsaturated, repeatability))
    return tuple(exposures)


def _repeatability(
    capture: Capture, table: BandTable | BracketTable, dark: DarkLibrary, usable: NDArray[np.bool_]
) -> float:
    """Relative standard deviation of the levels of repeats; NaN without repeats or light."""
    level = (capture.frames(table) - dark.at(table.exposure_s))[:, usable].sum(axis=1)
    if len(level) < 2 or not level.mean() > 0:
        return float("nan")
    return float(level.std(ddof=1) / level.mean())


def merge_exposures(exposures: Sequence[Exposure], cell: tuple[int, int] = (1, 1)) -> MergedFrames:
    """Merge exposures by maximum likelihood, pixel by pixel.

    Parameters
    ----------
    exposures
        Exposures of one band, its own first.
    cell
        (height, width) of one repeat of the mosaic, px.

    Returns
    -------
    MergedFrames
        Saturated where no exposure can be used; the signal there is that of the shortest one.
    """
    ratios = np.array([exposure.ratio for exposure in exposures])
    signals = np.stack([exposure.frames.signal for exposure in exposures])
    terms = np.stack([exposure.frames.coefficients for exposure in exposures])
    used = np.stack([exposure.unsaturated for exposure in exposures])
    saturated: NDArray[np.bool_] = ~np.any(used, axis=0)
    used[int(np.argmin(ratios)), saturated] = True
    a = ratios[:, None, None]
    # to begin with, all light over all time
    merged = np.sum(used * signals, axis=0) / np.sum(used * a, axis=0)
    weights = np.zeros_like(signals)
    for _ in range(_ROUNDS):
        level = np.maximum(neighbourhood_mean(merged, ~saturated, cell), 0.0)
        variance = terms[:, 0] + terms[:, 1] * a * level
        inverse = used / variance
        weights = inverse * a / np.sum(inverse * a**2, axis=0)
        merged = np.sum(weights * signals, axis=0)
    coefficients = np.stack(
        [
            np.sum(weights**2 * terms[:, 0], axis=0),
            np.sum(weights**2 * a * terms[:, 1], axis=0),
            terms[0, 2],  # the flat's noise is that of all exposures
        ]
    )
    tables = tuple(exposure.table for exposure in exposures)
    return MergedFrames(CorrectedFrames(merged, coefficients, saturated), tables, ratios, weights)


def neighbourhood_mean(
    signal: NDArray[np.float64], good: NDArray[np.bool_], cell: tuple[int, int]
) -> NDArray[np.float64]:
    """Mean over good pixels of the same channel nearby.

    Parameters
    ----------
    signal
        (y, x) signal.
    good
        (y, x) True for pixels that count.
    cell
        (height, width) of one repeat of the mosaic, px.

    Returns
    -------
    NDArray
        (y, x) mean, or the pixel itself where none is good.
    """
    result = signal.copy()
    height, width = cell
    for row in range(height):
        for column in range(width):
            part = (slice(row, None, height), slice(column, None, width))
            weight = good[part].astype(float)
            total = uniform_filter(weight, _NEIGHBOURHOOD, mode="constant")
            values = uniform_filter(np.where(good[part], signal[part], 0.0), _NEIGHBOURHOOD, mode="constant")
            result[part] = np.where(total > 1e-9, values / np.maximum(total, 1e-9), signal[part])
    return result
