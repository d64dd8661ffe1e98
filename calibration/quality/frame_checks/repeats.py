"""Checks of repeats of one exposure: their differences compared with noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.distributions import chi2_quantile
from numpy.typing import NDArray

from ...capture import Capture
from ...correction import ROUNDING_VARIANCE, DarkLibrary, NoiseModel
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_independence", "check_noise", "check_repeats"]

#: Largest variance of the difference of repeats relative to noise. Noise alone, with 1000 pixels, exceeds 1.25 once in
#: 30 million pairs; the noise model is accurate to a few per cent.
LARGEST_MISFIT = 2.0

#: Smallest variance of the difference relative to noise: copied or averaged frames have less.
SMALLEST_MISFIT = 1 / LARGEST_MISFIT / 2

#: Largest drift of the lamp between two repeats; different exposures differ by more.
LARGEST_DRIFT = 0.15

#: Variance of the difference relative to noise below which repeats are copies, which do not count for the median.
COPY_MISFIT = 1e-3

#: Largest ratio of the measured to the stated gain.
LARGEST_GAIN_RATIO = 1.5

#: Largest ratio of the measured to the stated read noise, which few frames determine less well.
LARGEST_READ_NOISE_RATIO = 2.0

#: Largest variance over that of noise of frames that are averages: of two it is a half. The noise model is accurate to
#: a few per cent, a group of 30 pixels to a quarter.
LARGEST_AVERAGED = 0.7

#: Fewest pairs that show averages: single tables may be copied.
FEWEST_AVERAGED = 3

#: Largest range of the misfits of averages over their median: the number of averaged frames is one for all.
AVERAGED_RANGE = 0.4

#: Largest difference from 1 of the misfit of a kind whose noise is as stated.
AS_STATED = 0.2

#: Smallest significant difference from the stated gain or read noise, standard deviations.
NOISE_SIGMAS = 8

#: Number of groups of pixels by signal: enough for a trend, with 30 pixels or more in each.
SIGNAL_BINS = 6

#: Smallest ratio of the misfit in the darkest to that in the brightest group by which counts are not linear.
GAMMA_RATIO = 2.5

#: Largest increase of the misfit from one group to the next brighter one in such counts.
GAMMA_INCREASE = 0.1

#: Largest correlation of neighbouring pixels' noise in the median of a kind's pairs; chance reaches 0.05 in 4000 pixels
#: once in a thousand pairs. Rows that share a common noise correlate along rows only.
LARGEST_CORRELATION = 0.1

#: The same in the median of one table's pairs, which are few: 6.7 standard deviations of chance in 2000 pixels.
LARGEST_TABLE_CORRELATION = 0.15

#: Correlation along rows alone, or along columns alone, from which on frames were interpolated: charge that lags behind
#: or interference correlates neighbours of one row by less.
ONE_WAY_CORRELATION = 0.25

#: Smallest negative correlation, along rows and columns, of sharpened frames; no sensor has one.
SHARPENED_CORRELATION = 0.05

#: Its significance, standard deviations of chance, one over the root of the pixels: once in 1e9 pairs.
SHARPENED_SIGMAS = 6

#: Fewest pixels of a table whose correlation is tested alone.
FEWEST_TABLE_PIXELS = 2000

#: Variance of the means of rows or columns over that of independent pixels, in the median of all pairs. With 40 rows
#: chance exceeds it in one pair of 5700.
LARGEST_LINE_VARIANCE = 2.0

#: Chance by which fewer rows or columns exceed their larger limit: that of 40 rows. Behind a mosaic a channel's pixels
#: may lie in every fourth row.
LINE_CHANCE = 1 / 5700

#: Fewest pixels of a comparison: the variance then has an error of 10 %.
FEWEST_PIXELS = 200

#: Largest squared deviation of a pixel over its variance: limits the effect of hot pixels and cosmic rays.
LARGEST_SQUARE = 400.0


@dataclass(frozen=True, eq=False)
class _Pair:
    """A repeat compared with the mean of the others of its table."""

    #: Its table.
    stack: Stack
    #: Index of the repeat.
    repeat: int
    #: Variance of the difference over that of noise.
    misfit: float
    #: Factor of its signal relative to the others.
    scale: float
    #: (SIGNAL_BINS,) misfit by ascending signal.
    bins: NDArray[np.float64]
    #: Correlation of the difference between adjacent pixels, and of a mosaic also between neighbours of one colour: the
    #: smaller one of those along rows and along columns, or the larger one from ONE_WAY_CORRELATION on. Of two
    #: negative ones, as sharpened frames have, the larger one; 0 where one alone is negative.
    neighbours: float
    #: Variance of the means of rows and of columns over that of independent pixels.
    lines: tuple[float, float]


def check_repeats(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Detect repeats with another picture, another exposure, or without independent noise.

    Deviations common to all pairs (a wrong gain, a nonlinearity) are removed by dividing by their median.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        The capture's gain and read noise, where they are not stated.

    Yields
    ------
    Suspicion
        For each kind of frames whose rows or columns have noise in common, then for the worst repeat of each set.
    """
    pairs = _pairs(capture, stacks, dark, noise)
    camera_gain = capture.manifest.camera.gain_e_per_dn
    if not pairs:
        return
    usual = _usual_misfit(pairs)
    averaged = {} if camera_gain is None else _averaged_kinds(pairs)
    for kind, misfit in averaged.items():
        yield Suspicion(
            f"each frame of {kind} is the average of several (about {1 / misfit:.0f}), which is not stated",
            f"{kind}.frames",
            f"Repeats differ by {misfit:.2f} times the variance that the stated gain and read noise give, at all "
            "signals; those of other kinds of frames by 1. Store single frames, or state the gain of the averages.",
        )
    yield from _check_lines(_of_one_picture(pairs))
    by_frames: dict[tuple[str, ...], list[_Pair]] = {}
    for pair in pairs:
        by_frames.setdefault(pair.stack.paths, []).append(pair)
    for of_frames in by_frames.values():
        worst = max(of_frames, key=lambda p: p.misfit)
        tables = ", ".join(dict.fromkeys(pair.stack.key for pair in of_frames))
        path = worst.stack.paths[worst.repeat]
        ratio = worst.misfit / usual
        if ratio > LARGEST_MISFIT:
            which = " It may be the other of the two." if len(worst.stack.paths) == 2 else ""
            yield Suspicion(
                f"a repeat of {tables} shows something else (another band, a moved camera, another gain)",
                path,
                f"The variance of its difference from the others is {ratio:.3g} times that of noise; 1 is expected."
                + which,
            )
        elif abs(np.log(max(worst.scale, 1e-6))) > np.log(1 + LARGEST_DRIFT):
            yield Suspicion(
                f"a repeat of {tables} has another exposure",
                path,
                f"It is {worst.scale:.3g} times as bright as the other repeats.",
            )
        elif ratio < SMALLEST_MISFIT:
            yield Suspicion(
                f"repeats of {tables} are not independent frames (copied, averaged or smoothed)",
                path,
                f"The variance of their difference is {ratio:.2g} times that of noise; 1 is expected.",
            )


def _averaged_kinds(pairs: Sequence[_Pair]) -> dict[str, float]:
    """Median misfit of the kinds of frames that are averages, by kind.

    Their noise is too small at all signals and in all tables, while that of another kind is as stated.
    """
    by_kind: dict[str, list[_Pair]] = {}
    for pair in pairs:
        if pair.misfit > COPY_MISFIT:
            by_kind.setdefault(pair.stack.kind, []).append(pair)
    misfits = {kind: np.array([pair.misfit for pair in of_kind]) for kind, of_kind in by_kind.items()}
    if not any(abs(float(np.median(values)) - 1) < AS_STATED for values in misfits.values()):
        return {}
    return {
        kind: float(np.median(values))
        for kind, values in misfits.items()
        if values.size >= FEWEST_AVERAGED
        and values.max() < LARGEST_AVERAGED
        and np.ptp(values) < AVERAGED_RANGE * np.median(values)
        and np.median([pair.bins for pair in by_kind[kind]], axis=0).max() < LARGEST_AVERAGED
    }


def _of_one_picture(pairs: Sequence[_Pair]) -> list[_Pair]:
    """Pairs without those of a moved camera, whose edges are no correlation of the noise."""
    usual = _usual_misfit(pairs) if pairs else 1.0
    return [pair for pair in pairs if pair.misfit <= LARGEST_MISFIT * usual or _is_sharpened(pair)]


def check_independence(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> tuple[tuple[Suspicion, ...], frozenset[str]]:
    """Detect frames whose pixels share noise: resampled, binned, smoothed or compressed.

    No other statistics of such frames are those of a sensor.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        The capture's gain and read noise, where they are not stated.

    Returns
    -------
    tuple of Suspicion
        At most one.
    frozenset of str
        Keys of their tables.
    """
    correlated: dict[str, Stack] = {}
    strengths: list[tuple[float, int]] = []
    pairs = _of_one_picture(_pairs(capture, _whole_frames(stacks), dark, noise))
    for kind in dict.fromkeys(pair.stack.kind for pair in pairs):
        tables, strength = _correlated([pair for pair in pairs if pair.stack.kind == kind])
        files = {stack.paths for stack in tables}
        correlated |= {stack.key: stack for stack in stacks if stack.kind == kind and stack.paths in files}
        strengths += [strength] if tables else []
    if not correlated:
        return (), frozenset()
    kinds = {stack.kind for stack in correlated.values()}
    complete = all(stack.key in correlated for stack in stacks if stack.kind in kinds)
    where = list(dict.fromkeys(stack.kind if complete else stack.key for stack in correlated.values()))
    how = "interpolated (demosaiced), " if capture.manifest.mosaic is not None else ""
    how += "resampled, binned, smoothed or compressed"
    correlation, count = max(strengths, key=_strength)
    suspicion = Suspicion(
        f"the frames of {', '.join(where)} were {how if correlation > 0 else 'sharpened'} after the exposure",
        ", ".join(f"{name}.frames" for name in where),
        f"The noise of neighbouring pixels has a correlation of {correlation:.2f} (median of {count} pairs of "
        "repeats); a sensor's has none.",
    )
    return (suspicion,), frozenset(correlated)


def _is_sharpened(pair: _Pair) -> bool:
    """Whether the noise of neighbours is opposed by more than chance."""
    return pair.neighbours < -max(SHARPENED_CORRELATION, SHARPENED_SIGMAS / np.sqrt(pair.stack.counts[0].size))


def _strength(correlation_and_count: tuple[float, int]) -> float:
    """Size of a correlation, whatever its sign."""
    return abs(correlation_and_count[0])


def _whole_frames(stacks: Sequence[Stack]) -> list[Stack]:
    """Frames with all pixels, each once: neighbours behind a mosaic have different colours."""
    first_of: dict[tuple[str, ...], Stack] = {}
    for stack in stacks:
        first_of.setdefault(stack.paths, stack)
    return [replace(stack, lattice=None) for stack in first_of.values()]


def _usual_misfit(pairs: Sequence[_Pair]) -> float:
    """Misfit that a wrong gain or a nonlinearity gives all pairs; 1 where few pairs disagree.

    Behind a mosaic the channels of one frame have one cause, so they count once.
    """
    by_frames: dict[tuple[tuple[str, ...], int], list[float]] = {}
    for pair in pairs:
        if pair.misfit > COPY_MISFIT:
            by_frames.setdefault((pair.stack.paths, pair.repeat), []).append(pair.misfit)
    differing = [float(np.median(misfits)) for misfits in by_frames.values()]
    agree = bool(differing) and max(differing) < LARGEST_MISFIT * min(differing)
    return float(np.median(differing)) if len(differing) > 2 or (len(pairs) > 2 and agree) else 1.0


def check_noise(capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel) -> Iterator[Suspicion]:
    """Check gain, read noise and the increase of noise with the signal by the repeats.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        Gain and read noise by its frames.

    Yields
    ------
    Suspicion
        For gain, read noise, and counts that are not proportional to light.
    """
    yield from _check_stated_noise(capture, noise)
    curves = [pair.bins / pair.misfit for pair in _pairs(capture, stacks, dark, noise) if pair.stack.kind == "band"]
    if len(curves) > 1:
        curve = np.median(curves, axis=0)
        if curve[0] > GAMMA_RATIO * curve[-1] and np.all(np.diff(curve) < GAMMA_INCREASE):
            yield Suspicion(
                "counts are not proportional to light: gamma-encoded frames",
                "band.frames",
                f"The variance between repeats, over that of shot and read noise, falls from {curve[0]:.2g} in the "
                f"darkest sixth of the pixels to {curve[-1]:.2g} in the brightest; in linear counts it is constant.",
            )


def _check_stated_noise(capture: Capture, noise: NoiseModel) -> Iterator[Suspicion]:
    """Stated gain and read noise against those of the frames, with a hint at a wrong unit."""
    camera = capture.manifest.camera
    quantities = (
        ("gain", "camera.gain_e_per_dn", camera.gain_e_per_dn, noise.gain_e_per_dn, noise.gain_sigma),
        ("read noise", "camera.read_noise_e", camera.read_noise_e, noise.read_noise_e, noise.read_noise_sigma),
    )
    for name, key, stated_value, value, sigma in quantities:
        if stated_value is None or value is None or sigma is None or not stated_value > 0:
            continue
        ratio = max(value, 1e-9) / stated_value
        limit = LARGEST_GAIN_RATIO if name == "gain" else LARGEST_READ_NOISE_RATIO
        if abs(value - stated_value) > NOISE_SIGMAS * sigma and not 1 / limit < ratio < limit:
            hint = ""
            if name == "gain" and 0.7 < value * stated_value < 1.4:
                hint = " It is its inverse, counts per electron."
            if name == "read noise" and noise.gain_e_per_dn and 0.7 < ratio / noise.gain_e_per_dn < 1.4:
                hint = " It is in DN, not in electrons."
            yield Suspicion(
                f"the stated {name} does not fit the frames (a wrong {name}, or rescaled counts)",
                key,
                f"The noise of the frames gives {value:.4g} +- {sigma:.2g}; {stated_value:g} is stated.{hint}",
            )


def _pairs(capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel) -> list[_Pair]:
    """Comparisons of all repeats except darks; one for two repeats, none without a gain."""
    camera = capture.manifest.camera
    gain = camera.gain_e_per_dn or noise.gain_e_per_dn
    if gain is None:
        return []
    read = camera.read_noise_e if camera.read_noise_e is not None else noise.read_noise_e
    floor = ((read or 0.0) / gain) ** 2 + ROUNDING_VARIANCE
    return [
        pair
        for stack in stacks
        if len(stack.paths) > 1 and stack.kind != "dark"
        for repeat in range(1 if len(stack.paths) == 2 else 0, len(stack.paths))
        if (pair := _pair(stack, repeat, capture, dark, gain, floor)) is not None
    ]


def _pair(stack: Stack, repeat: int, capture: Capture, dark: DarkLibrary, gain: float, floor: float) -> _Pair | None:
    """The comparison of a repeat with the mean of the others; None with too few usable pixels.

    gain : electrons/DN. floor : variance of reading, DN^2.
    """
    counts = stack.counts.astype(float)
    others = np.delete(counts, repeat, axis=0)
    level = stack.thinned(dark.at(stack.exposure_s))
    first, second = others.mean(axis=0) - level, counts[repeat] - level
    usable = (counts.max(axis=0) < capture.saturation_dn) & (counts.min(axis=0) > 0)
    if np.count_nonzero(usable) < FEWEST_PIXELS:
        return None
    a, b = first[usable], second[usable]
    scale = float(np.sum(a * b) / max(float(np.sum(a * a)), 1e-12)) if stack.kind != "dark" else 1.0
    residual = b - scale * a
    residual -= np.median(residual)
    charge = np.maximum(scale * a, 0) + stack.thinned(dark.thermal(stack.exposure_s))[usable]
    expected = (charge / gain + floor) * (1 + 1 / len(others))
    image, weight = np.zeros(usable.shape), np.zeros(usable.shape)
    image[usable], weight[usable] = residual, 1 / expected
    independent, (rows, columns) = _without_lines(image, weight)
    squares = np.minimum(independent[usable] ** 2 / expected, LARGEST_SQUARE)
    misfit = max(float(squares.mean()), 1e-6)
    bins = np.array([float(part.mean()) for part in np.array_split(squares[np.argsort(a)], SIGNAL_BINS)])
    noise = np.clip(independent * np.sqrt(weight), -20, 20)
    steps = {(1, 1)} if stack.lattice is not None or capture.cell is None else {(1, 1), capture.cell}
    correlation = max((_neighbour_correlation(noise, usable, step) for step in steps), key=abs)
    return _Pair(stack, repeat, misfit, scale, bins, correlation, (rows / misfit, columns / misfit))


def _without_means(
    noise: NDArray[np.float64], weight: NDArray[np.float64], axis: int
) -> tuple[NDArray[np.float64], float]:
    """Noise (y, x) less its weighted means over an axis, and their variance.

    The variance is relative to that of independent noise of variance 1.
    """
    total = weight.sum(axis=axis, keepdims=True)
    mean = (noise * weight).sum(axis=axis, keepdims=True) / np.maximum(total, 1e-12)
    return noise - mean, float(np.mean(mean**2 * total))


def _without_lines(
    noise: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Noise (y, x) less the common noise of rows and columns, and the variances of both."""
    without_rows, rows = _without_means(noise, weight, 1)
    without_both, columns = _without_means(without_rows, weight, 0)
    return without_both, (rows, columns)


def _neighbour_correlation(noise: NDArray[np.float64], usable: NDArray[np.bool_], step: tuple[int, int]) -> float:
    """Correlation of pixels (y, x) ``step`` rows or columns apart, see ``_Pair.neighbours``."""
    correlations = []
    rows, columns = step
    for first, second in ((np.s_[:, columns:], np.s_[:, :-columns]), (np.s_[rows:], np.s_[:-rows])):
        both = usable[first] & usable[second]
        a, b = noise[first][both], noise[second][both]
        varied = np.count_nonzero(both) > FEWEST_PIXELS and a.std() > 0 < b.std()
        correlations.append(float(np.corrcoef(a, b)[0, 1]) if varied else 0.0)
    smaller, larger = sorted(correlations)
    if larger < 0 or larger > ONE_WAY_CORRELATION:
        return larger
    return max(smaller, 0.0)


def _correlated(pairs: Sequence[_Pair]) -> tuple[list[Stack], tuple[float, int]]:
    """Frames of one kind whose noise is not independent from pixel to pixel.

    The second value is the largest median correlation and its number of pairs. All frames, if those of the kind are
    correlated in the median; else single tables with enough pixels.
    """
    middle = float(np.median([pair.neighbours for pair in pairs]))
    if middle > LARGEST_CORRELATION:
        return [pair.stack for pair in pairs], (middle, len(pairs))
    by_table: dict[str, list[_Pair]] = {}
    for pair in pairs:
        by_table.setdefault(pair.stack.key, []).append(pair)
    correlated, strongest = [], (0.0, 0)
    for of_table in by_table.values():
        middle, stack = float(np.median([pair.neighbours for pair in of_table])), of_table[0].stack
        is_large = middle > LARGEST_TABLE_CORRELATION and stack.counts[0].size >= FEWEST_TABLE_PIXELS
        if is_large or all(_is_sharpened(pair) for pair in of_table):
            correlated.append(stack)
            strongest = max(strongest, (middle, len(of_table)), key=_strength)
    return correlated, strongest


def _check_lines(pairs: Sequence[_Pair]) -> Iterator[Suspicion]:
    """Noise that the pixels of a row or of a column have in common."""
    for kind in dict.fromkeys(pair.stack.kind for pair in pairs):
        variances = [pair.lines for pair in pairs if pair.stack.kind == kind]
        fewest = np.min([pair.stack.counts.shape[1:] for pair in pairs if pair.stack.kind == kind], axis=0)
        limits = np.maximum(LARGEST_LINE_VARIANCE, chi2_quantile(LINE_CHANCE, fewest) / fewest)
        for name, middle, limit in zip(("row", "column"), np.median(variances, axis=0), limits, strict=True):
            if middle > limit:
                yield Suspicion(
                    f"the pixels of a {name} share a common noise (readout or interference)",
                    f"{kind}.frames",
                    f"From repeat to repeat the means of {name}s differ {np.sqrt(middle):.2g} times as much as "
                    f"independent pixels make them (median of {len(variances)} pairs of repeats).",
                )
