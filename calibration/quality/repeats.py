"""Checks of repeats of one exposure: their differences compared with noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..capture import Capture
from ..correction import ROUNDING_VARIANCE, DarkLibrary, NoiseModel
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_noise", "check_repeats"]

#: Largest variance of the difference of repeats relative to noise. Noise alone, with 1000 pixels, exceeds 1.25 once in
#: 30 million pairs; the noise model is accurate to a few per cent.
_MISFIT = 2.0
#: Largest drift of the lamp between two repeats; different exposures differ by more.
_DRIFT = 0.15
#: Variance of the difference of repeats relative to noise below which they are copies, which say nothing of others.
_COPIED = 1e-3
_WRONG_NOISE = 2.0
_BINS = 6
#: Largest correlation of neighbouring pixels' noise in the median of a kind's pairs; chance reaches 0.05 in 4000 pixels
#: once in a thousand pairs. Rows that share a noise of their own correlate along rows only.
_CORRELATED = 0.1
#: Variance of the means of rows or columns over that of independent pixels, in the median of all pairs. With 40 rows
#: chance exceeds it in one pair of 5700.
_STRIPED = 2.0


@dataclass(frozen=True, eq=False)
class _Pair:
    """A repeat compared with the others of its table. misfit : variance of the difference over that of noise.
    scale : factor of its signal relative to the others. bins : misfit by ascending signal. neighbours : correlation of
    the difference between adjacent pixels, the smaller one of those along rows and along columns. lines : variance of
    the means of rows and of columns over that of independent pixels.
    """

    stack: Stack
    repeat: int
    misfit: float
    scale: float
    bins: NDArray[np.float64]
    neighbours: float
    lines: tuple[float, float]


def _pair(stack: Stack, repeat: int, full: int, dark: DarkLibrary, gain: float, floor: float) -> _Pair | None:
    """The comparison of a repeat with the mean of the others; None with too few usable pixels."""
    counts = stack.counts.astype(float)
    others = np.delete(counts, repeat, axis=0)
    level = stack.thinned(dark.at(stack.exposure_s))
    first, second = others.mean(axis=0) - level, counts[repeat] - level
    good = (counts.max(axis=0) < full) & (counts.min(axis=0) > 0)
    if np.count_nonzero(good) < 200:
        return None
    a, b = first[good], second[good]
    scale = float(np.sum(a * b) / max(float(np.sum(a * a)), 1e-12)) if stack.kind != "dark" else 1.0
    residual = b - scale * a
    residual -= np.median(residual)
    charge = np.maximum(scale * a, 0) + stack.thinned(dark.thermal(stack.exposure_s))[good]
    expected = (charge / gain + floor) * (1 + 1 / len(others))
    image, weight = np.zeros(good.shape), np.zeros(good.shape)
    image[good], weight[good] = residual, 1 / expected
    own, (rows, columns) = _lines(image, weight)
    # limits the effect of hot pixels and cosmic rays
    squares = np.minimum(own[good] ** 2 / expected, 400.0)
    misfit = max(float(squares.mean()), 1e-6)
    bins = np.array([float(part.mean()) for part in np.array_split(squares[np.argsort(a)], _BINS)])
    noise = np.clip(image * np.sqrt(weight), -20, 20)
    return _Pair(stack, repeat, misfit, scale, bins, _neighbours(noise, good), (rows / misfit, columns / misfit))


def _without_means(
    noise: NDArray[np.float64], weight: NDArray[np.float64], axis: int
) -> tuple[NDArray[np.float64], float]:
    """Noise (y, x) less its weighted means over an axis, and their variance over that of independent noise of 1."""
    total = weight.sum(axis=axis, keepdims=True)
    mean = (noise * weight).sum(axis=axis, keepdims=True) / np.maximum(total, 1e-12)
    return noise - mean, float(np.mean(mean**2 * total))


def _lines(noise: NDArray[np.float64], weight: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Noise (y, x) less what rows and columns share, which readout may give them, and the variances of both."""
    without_rows, rows = _without_means(noise, weight, 1)
    without_both, columns = _without_means(without_rows, weight, 0)
    return without_both, (rows, columns)


def _neighbours(noise: NDArray[np.float64], good: NDArray[np.bool_]) -> float:
    """Correlation of adjacent pixels (y, x), the smaller one of those along rows and along columns."""
    found = []
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = good[one] & good[other]
        a, b = noise[one][both], noise[other][both]
        found.append(float(np.corrcoef(a, b)[0, 1]) if np.count_nonzero(both) > 200 and a.std() > 0 < b.std() else 0.0)
    return min(found)


def _pairs(capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel) -> list[_Pair]:
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
        if (pair := _pair(stack, repeat, capture.saturation_dn, dark, gain, floor)) is not None
    ]


def check_repeats(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Detects repeats with another picture, another exposure, or without independent noise.

    Deviations common to all pairs (a wrong gain, a nonlinearity) are removed by dividing by their median.
    """
    pairs = _pairs(capture, stacks, dark, noise)
    if not pairs:
        return
    differing = [pair.misfit for pair in pairs if pair.misfit > _COPIED]
    usual = float(np.median(differing)) if len(differing) > 2 else 1.0
    yield from _resampled(pairs)
    yield from _striped(pairs)
    by_table: dict[str, list[_Pair]] = {}
    for pair in pairs:
        by_table.setdefault(pair.stack.key, []).append(pair)
    for own in by_table.values():
        worst = max(own, key=lambda p: p.misfit)
        path = worst.stack.paths[worst.repeat]
        ratio = worst.misfit / usual
        if ratio > _MISFIT:
            yield Suspicion(
                f"a repeat of {worst.stack.key} shows something else (another band, a moved camera, another gain)",
                path,
                f"The variance of its difference from the others is {ratio:.3g} times that of noise; 1 is expected.",
            )
        elif abs(np.log(max(worst.scale, 1e-6))) > np.log(1 + _DRIFT):
            yield Suspicion(
                f"a repeat of {worst.stack.key} has another exposure",
                path,
                f"It is {worst.scale:.3g} times as bright as the other repeats.",
            )
        elif ratio < 1 / _MISFIT / 2:
            yield Suspicion(
                f"repeats of {worst.stack.key} are not independent frames (copied, averaged or smoothed)",
                path,
                f"The variance of their difference is {ratio:.2g} times that of noise; 1 is expected.",
            )


def _resampled(pairs: Sequence[_Pair]) -> Iterator[Suspicion]:
    """Detects frames whose noise is not independent from pixel to pixel, as that of a sensor is."""
    for kind in dict.fromkeys(pair.stack.kind for pair in pairs):
        own = [pair.neighbours for pair in pairs if pair.stack.kind == kind]
        middle = float(np.median(own))
        if middle > _CORRELATED:
            yield Suspicion(
                f"the {kind} frames were resampled, binned, smoothed or compressed after the exposure",
                f"{kind}.frames",
                f"The noise of neighbouring pixels has a correlation of {middle:.2f} (median of {len(own)} pairs of "
                "repeats); a sensor's has none.",
            )


def _striped(pairs: Sequence[_Pair]) -> Iterator[Suspicion]:
    """Detects noise that the pixels of a row or of a column have in common."""
    for kind in dict.fromkeys(pair.stack.kind for pair in pairs):
        own = [pair.lines for pair in pairs if pair.stack.kind == kind]
        for name, middle in zip(("row", "column"), np.median(own, axis=0), strict=True):
            if middle > _STRIPED:
                yield Suspicion(
                    f"the pixels of a {name} share a noise of their own (readout or interference)",
                    f"{kind}.frames",
                    f"From repeat to repeat the means of {name}s differ {np.sqrt(middle):.2g} times as much as "
                    f"independent pixels make them (median of {len(own)} pairs of repeats).",
                )


def check_noise(capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel) -> Iterator[Suspicion]:
    """Checks the stated gain and read noise against the scatter of repeats, and its increase with the signal."""
    camera = capture.manifest.camera
    for name, key, stated, value, sigma in (
        ("gain", "camera.gain_e_per_dn", camera.gain_e_per_dn, noise.gain_e_per_dn, noise.gain_sigma),
        (
            "read noise",
            "camera.read_noise_e",
            camera.read_noise_e,
            noise.read_noise_e,
            noise.read_noise_sigma,
        ),
    ):
        if stated is None or value is None or sigma is None or not stated > 0:
            continue
        ratio = max(value, 1e-9) / stated
        limit = 1.5 if name == "gain" else _WRONG_NOISE
        if abs(value - stated) > 8 * sigma and not 1 / limit < ratio < limit:
            hint = ""
            if name == "gain" and 0.7 < value * stated < 1.4:
                hint = " It is its inverse, counts per electron."
            if name == "read noise" and noise.gain_e_per_dn and 0.7 < ratio / noise.gain_e_per_dn < 1.4:
                hint = " It is in DN, not in electrons."
            yield Suspicion(
                f"the stated {name} does not fit the frames (a wrong {name}, or rescaled counts)",
                key,
                f"The noise of the frames gives {value:.4g} +- {sigma:.2g}; {stated:g} is stated.{hint}",
            )
    curves = [pair.bins / pair.misfit for pair in _pairs(capture, stacks, dark, noise) if pair.stack.kind == "band"]
    if len(curves) > 1:
        curve = np.median(curves, axis=0)
        if curve[0] > 2.5 * curve[-1] and np.all(np.diff(curve) < 0.1):
            yield Suspicion(
                "counts are not proportional to light: gamma-encoded frames",
                "band.frames",
                f"The variance between repeats, over that of shot and read noise, falls from {curve[0]:.2g} in the "
                f"darkest sixth of the pixels to {curve[-1]:.2g} in the brightest; in linear counts it is constant.",
            )
