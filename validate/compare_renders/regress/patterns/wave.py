"""Ripples of any period and direction: lines in the spectrum of the difference.

Noise of a renderer, a pixel filter or a denoiser has a spectrum that is smooth from frequency to frequency. A ripple
has its power at one frequency. Its power is compared with that of the frequencies near it, and with all frequencies of
its period, so that no variance has to be known.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.distributions import NORMAL_OVER_MEDIAN, fisher_tail
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .difference import Difference, Finding, sigma_of

__all__ = ["ripple"]

#: Frequencies that are tested for each cycle over the picture: between them a ripple loses a tenth of its power.
_STEPS_PER_CYCLE = 2
#: Fewest cycles over the picture: slower changes are gradients, which a denoiser's errors have too.
_FEWEST_CYCLES = 1.5
#: Frequencies whose power is compared, from the clearest on.
_CANDIDATES = 6
#: Cycles over the picture that count as the frequency of the ripple itself.
_OWN_CYCLES = 1.0
#: Cycles over the picture up to which frequencies lie near.
_NEAR_CYCLES = 5.0
#: Cycles over the picture up to which all slower frequencies are compared, too: noise of denoisers grows there.
_SLOW_CYCLES = 6.0
#: Cycles by which the frequency of a candidate is refined: an eighth of a cycle loses a hundredth of the power.
_FINE_CYCLES = (-0.375, -0.25, -0.125, 0.0, 0.125, 0.25, 0.375)
#: Scatters at which single pixels are cut: a firefly has power at all frequencies.
_CUT = 4.0
#: Standard deviations of a file's steps that a ripple may be.
_STEPS_ALLOWED = 3.0
#: Pixels a side of the windows that give the local level and the local scatter.
_WINDOW_PX = 7
#: Part of the picture that is tested at least.
_LEAST_PART = 0.3
#: Pixels a side of the smallest picture.
_LEAST_PX = 24
#: Fewest degrees of freedom of the power near a frequency.
_LEAST_DEGREES = 8.0


def ripple(difference: Difference, steps: float = 0.0) -> Finding | None:
    """Clearest ripple.

    Parameters
    ----------
    difference
        The difference.
    steps
        Relative standard deviation from the steps in which files store values; steps of a smooth light are ripples.

    Returns
    -------
    Finding or None
        The size is the ripple's root mean square. None for a small picture, or one of few pixels with light.
    """
    used = np.logical_or.reduce([difference.smooth, difference.groups.get("edges", difference.smooth)])
    part = float(used.mean())
    if min(used.shape) < _LEAST_PX or part < _LEAST_PART:
        return None
    values, scale = _normalised(difference, used)
    if scale == 0:
        return None
    spectrum, down, right, cycles = _spectrum(values)
    tested = (cycles >= _FEWEST_CYCLES) & (np.hypot(down / used.shape[0], right / used.shape[1]) <= 0.5)
    tested &= (right > 0) | ((right == 0) & (down > 0))
    clear = np.where(tested, spectrum / _by_cycles(spectrum, cycles), 0.0)
    lines = []
    for index in np.argsort(clear, axis=None)[: -_CANDIDATES - 1 : -1]:
        at = _refined(values, used, float(down.flat[index]), float(right.flat[index]))
        power, degrees, squares = _line(values, used, *at)
        lines.append((float(fisher_tail(power, 2, degrees)) if power > 0 else 1.0, at, degrees, squares))
    least, (y, x), degrees, squares = min(lines)
    probability = min(1.0, least * int(tested.sum()))
    period = 1 / max(float(np.hypot(y / used.shape[0], x / used.shape[1])), 1e-9)
    size = scale * float(np.sqrt(squares / max(int(used.sum()), 1)))
    if size < _STEPS_ALLOWED * steps:
        probability = 1.0
    parameters = {"period_px": period, "cycles_right": x, "cycles_down": y}
    name = f"ripple with a period of {period:.3g} px"
    return Finding(name, int(used.sum()), size, sigma_of(size, probability, degrees), degrees, probability, parameters)


def _normalised(difference: Difference, used: NDArray[np.bool_]) -> tuple[NDArray[np.float64], float]:
    """(y, x) relative difference over its local scatter; the median scatter, or 0."""
    local = median_filter(difference.level + 0.5 * difference.total, 3, mode="nearest")
    relative = difference.total / np.maximum(local, 1e-3 * max(float(local.mean()), 1e-300))
    relative = np.where(used, relative - np.median(relative[used]), 0.0)
    around = NORMAL_OVER_MEDIAN * median_filter(np.abs(relative), _WINDOW_PX, mode="nearest")
    typical = float(np.median(around[used]))
    if typical <= 0:
        return relative, 0.0
    values = np.clip(relative / np.maximum(around, typical), -_CUT, _CUT)
    return np.where(used, values - values[used].mean(), 0.0), typical


def _spectrum(values: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """(v, u) power; cycles over the picture, downwards, to the right and along."""
    height, width = (_STEPS_PER_CYCLE * size for size in values.shape)
    power = np.abs(np.fft.fft2(values, (height, width))) ** 2
    down = np.fft.fftfreq(height, 1 / height)[:, None] / _STEPS_PER_CYCLE + np.zeros((1, width))
    right = np.fft.fftfreq(width, 1 / width)[None] / _STEPS_PER_CYCLE + np.zeros((height, 1))
    return power, down, right, np.hypot(down, right)


def _by_cycles(power: NDArray, cycles: NDArray) -> NDArray[np.float64]:
    """(v, u) median power of the frequencies of about the same period."""
    ring = np.round(cycles).astype(int)
    medians = np.array([np.median(power[ring == r]) if (ring == r).any() else 1.0 for r in range(ring.max() + 1)])
    return np.maximum(medians, 1e-12 * max(float(power.max()), 1e-300))[ring]


def _refined(values: NDArray, used: NDArray[np.bool_], down: float, right: float) -> tuple[float, float]:
    """Frequency (down, right) of most power around another, in cycles over the picture."""
    rows, columns = (np.arange(size) / size for size in values.shape)
    fine = np.array(_FINE_CYCLES)
    along = np.exp(-2j * np.pi * np.outer(down + fine, rows))
    across = np.exp(-2j * np.pi * np.outer(right + fine, columns))
    mask = along @ used @ across.T
    # a fit with a free mean: slow ripples share a part with the outline of the pixels
    power = np.abs(along @ values @ across.T) ** 2 / np.maximum(1 - np.abs(mask / used.sum()) ** 2, 0.1)
    best_down, best_right = np.unravel_index(int(power.argmax()), power.shape)
    return down + float(fine[best_down]), right + float(fine[best_right])


def _line(values: NDArray, used: NDArray[np.bool_], down: float, right: float) -> tuple[float, float, float]:
    """Power of a ripple over that around it, degrees of freedom, sum of squares."""
    rows, columns = np.nonzero(used)
    phase = 2 * np.pi * (down * rows / used.shape[0] + right * columns / used.shape[1])
    shapes = np.stack([np.cos(phase), np.sin(phase), np.ones(phase.size)], axis=1)
    goal = values[used]
    amplitudes = np.linalg.lstsq(shapes, goal, rcond=None)[0]
    remainder = np.zeros_like(values)
    remainder[used] = goal - shapes @ amplitudes
    squares = float(((shapes[:, :2] @ amplitudes[:2]) ** 2).sum())
    power, y, x, cycles = _spectrum(remainder)
    power /= phase.size
    apart = np.minimum(np.hypot(y - down, x - right), np.hypot(y + down, x + right))
    length = float(np.hypot(down, right))
    others = (apart >= _OWN_CYCLES) & (cycles >= _OWN_CYCLES)
    regions = [others & (apart <= _NEAR_CYCLES), others & (np.abs(cycles - length) <= _OWN_CYCLES)]
    if length <= _SLOW_CYCLES:
        regions.append(others & (cycles <= length + _OWN_CYCLES))
    around, degrees = 0.0, np.inf
    for region in regions:
        # a real picture has each frequency twice, and masked pixels make neighbours alike
        free = float(region.sum()) / _STEPS_PER_CYCLE**2 * float(used.mean())
        if free >= _LEAST_DEGREES and float(power[region].mean()) > around:
            around, degrees = float(power[region].mean()), free
    return (squares / 2 / around, degrees, squares) if around > 0 and np.isfinite(degrees) else (0.0, 8.0, squares)
