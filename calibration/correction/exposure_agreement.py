"""Agreement of a capture's exposures: which stated time does not fit the counts.

Two exposures of one field share pixels, in which their counts above dark have the ratio of their times. A shutter that
is open longer than commanded by the same time in all exposures is no wrong statement: the effect ``shutter-offset``
predicts it. Its time is therefore fitted first, within plausible bounds. What one exposure then deviates from the
others of its band is the error of its statement.

Counts that bend with their level make the ratio change with it, a wrong time does not. The ratio is therefore that of
the straight line through its values by level, at level 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .exposure_merge import Exposure, neighbourhood_mean

__all__ = ["ExposureFinding", "exposure_findings"]

#: Times by which all exposures may be longer than stated, s: shutters and their electronics differ by this at most.
_PLAUSIBLE_OFFSETS_S = (-0.02, 0.1)
#: Steps of the search for that time.
_OFFSETS_TRIED = 121
#: Smallest deviation of an exposure time that is named where repeats show how steady the lamp is: from one exposure to
#: the next it may drift by this.
_SMALLEST_DEVIATION = 0.02
#: The same without repeats: lamps flicker by a few per cent.
_SMALLEST_WITHOUT_REPEATS = 0.05
#: Standard deviations of a named deviation.
_SMALLEST_SIGMAS = 7.0
#: Relative scatter of lamp and shutter from exposure to exposure, where repeats do not show it.
_REPEATABILITY = 0.003
#: The same at least where they do: two repeats may agree by chance.
_SMALLEST_REPEATABILITY = 0.001
#: Lowest signal over the noise of a dark pixel of those compared: darker ones depend on the dark level.
_LOWEST_SIGNAL_TO_NOISE = 5.0
#: Fewest pixels in which two exposures are compared.
_FEWEST_PIXELS = 50
#: Groups of pixels by level, through whose ratios the line goes.
_LEVELS = 8


@dataclass(frozen=True)
class ExposureFinding:
    """An exposure time that does not fit the counts."""

    #: Identifier of the band.
    band: str
    #: Position among the band's exposures, 0 for the band's own; None where two exposures accuse each other.
    index: int | None
    #: Stated exposure time, s; of the longer one of two.
    stated_s: float
    #: Exposure time that fits the others of the band, s.
    fitting_s: float
    #: Largest relative deviation from proportionality.
    deviation: float


@dataclass(frozen=True, eq=False)
class _Series:
    """Exposures of a band with their levels relative to each other."""

    #: Identifier of the band.
    band: str
    #: (n,) stated exposure times, s.
    time: NDArray[np.float64]
    #: (n,) logarithm of level over time, relative to the first exposure; NaN where nothing can be compared.
    rate: NDArray[np.float64]
    #: (n,) standard deviation of the same.
    sigma: NDArray[np.float64]
    #: Smallest deviation that is named.
    smallest: float


def _scatter(exposures: Sequence[Exposure]) -> float | None:
    """Relative scatter of the light from frame to frame by all repeats; None without any."""
    squares = [e.repeatability**2 for e in exposures if np.isfinite(e.repeatability)]
    return max(float(np.sqrt(np.mean(squares))), _SMALLEST_REPEATABILITY) if squares else None


def _level_ratio(
    first: Exposure, second: Exposure, good: NDArray[np.bool_], cell: tuple[int, int]
) -> tuple[float, float] | None:
    """Logarithm of the ratio of two exposures at level 0, and its standard deviation by noise.

    None without light, and where all pixels have one level: nothing leads from it to level 0.
    """
    signals = [exposure.frames.signal[good] for exposure in (first, second)]
    noises = [
        exposure.frames.coefficients[0][good] + exposure.frames.coefficients[1][good] * np.maximum(signal, 0)
        for exposure, signal in zip((first, second), signals, strict=True)
    ]
    # neighbours sort the pixels: by its own noise a pixel would seem bright where its ratio is large
    nearby = neighbourhood_mean(second.frames.signal, good, cell)[good]
    groups = np.array_split(np.argsort(nearby), _LEVELS)
    sums = np.array([[signal[group].sum() for group in groups] for signal in signals])
    if sums.min() <= 0:
        return None
    variance = sum(
        np.array([noise[group].sum() for group in groups]) / total**2 for noise, total in zip(noises, sums, strict=True)
    )
    level = np.array([nearby[group].mean() for group in groups])
    design = np.stack([np.ones(_LEVELS), level / level.max()], axis=1) / np.sqrt(variance)[:, None]
    if np.linalg.matrix_rank(design) < 2:
        return None
    inverse = np.linalg.inv(design.T @ design)
    line = inverse @ design.T @ (np.log(sums[1] / sums[0]) / np.sqrt(variance))
    return float(line[0]), float(np.sqrt(inverse[0, 0]))


def _series(
    band: str,
    exposures: Sequence[Exposure],
    used: NDArray[np.bool_],
    scatter: float | None,
    cell: tuple[int, int],
) -> _Series:
    """Levels of a band's exposures, each compared with the next longer one."""
    time = np.array([exposure.table.exposure_s for exposure in exposures])
    rate, sigma = np.full(time.size, np.nan), np.full(time.size, np.nan)
    order = np.argsort(time, kind="stable")
    light = _REPEATABILITY if scatter is None else scatter
    rate[order[0]], sigma[order[0]] = 0.0, light
    for shorter, longer in itertools.pairwise(order):
        first, second = exposures[shorter], exposures[longer]
        good = used & first.unsaturated & second.unsaturated
        # the longer exposure chooses the pixels, so that noise of the shorter one does not
        expected = second.frames.signal * time[shorter] / time[longer]
        good &= expected > _LOWEST_SIGNAL_TO_NOISE * np.sqrt(first.frames.coefficients[0])
        if np.count_nonzero(good) < _FEWEST_PIXELS or np.isnan(rate[shorter]):
            break
        ratio = _level_ratio(first, second, good, cell)
        if ratio is None:
            break
        rate[longer] = rate[shorter] + ratio[0] - np.log(time[longer] / time[shorter])
        sigma[longer] = np.hypot(ratio[1], light)
    return _Series(band, time, rate, sigma, _SMALLEST_WITHOUT_REPEATS if scatter is None else _SMALLEST_DEVIATION)


def _residuals(series: _Series, offset_s: float) -> NDArray[np.float64]:
    """(n,) logarithms of level over time plus offset, about their median."""
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = series.rate - np.log1p(offset_s / series.time)
    return deviation - np.nanmedian(deviation)


def exposure_findings(
    of_bands: Mapping[str, Sequence[Exposure]], used: Mapping[str, NDArray[np.bool_]], cell: tuple[int, int] = (1, 1)
) -> tuple[ExposureFinding, ...]:
    """Stated exposure times that do not fit the counts.

    Parameters
    ----------
    of_bands
        By band, its exposures with the band's own first.
    used
        By band, (y, x) True for sound pixels that the band sees.
    cell
        (height, width) of one repeat of the mosaic, px.

    Returns
    -------
    tuple
        At most one for each band; empty where all fit, and for bands with one exposure.
    """
    scatter = _scatter([exposure for each in of_bands.values() for exposure in each])
    several = [_series(band, each, used[band], scatter, cell) for band, each in of_bands.items() if len(each) > 1]
    several = [series for series in several if np.count_nonzero(np.isfinite(series.rate)) > 1]
    if not several:
        return ()
    shortest = min(float(series.time.min()) for series in several)
    low, high = max(_PLAUSIBLE_OFFSETS_S[0], -0.5 * shortest), _PLAUSIBLE_OFFSETS_S[1]
    offsets = np.union1d(np.linspace(low, high, _OFFSETS_TRIED), [0.0])
    # the offset by which the fewest exposures are wrong, and of these the smallest
    offset = min(
        offsets.tolist(), key=lambda each: (sum(_finding(series, each) is not None for series in several), abs(each))
    )
    findings = (_finding(series, offset) for series in several)
    return tuple(finding for finding in findings if finding is not None)


def _finding(series: _Series, offset_s: float) -> ExposureFinding | None:
    """The exposure of a band that deviates most from the others, where it deviates by enough."""
    deviation = _residuals(series, offset_s)
    finite = np.flatnonzero(np.isfinite(deviation))
    worst = int(finite[np.argmax(np.abs(deviation[finite]))])
    # in a pair both deviate from their mean by half
    size = float(np.ptp(deviation[finite])) if finite.size == 2 else abs(float(deviation[worst]))
    sigma = float(np.nanmax(series.sigma))
    if size < max(series.smallest, _SMALLEST_SIGMAS * sigma):
        return None
    if finite.size == 2:
        short, long = finite[np.argsort(series.time[finite])]
        ratio = float(np.exp(deviation[long] - deviation[short]))
        return ExposureFinding(series.band, None, float(series.time[long]), float(series.time[long]) * ratio, size)
    time = float(series.time[worst])
    return ExposureFinding(series.band, worst, time, time * float(np.exp(deviation[worst])), size)
