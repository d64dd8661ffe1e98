"""Checks of dark frames for light in them and for another temperature."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from ...correction import DarkLibrary
from .fingerprint import NEIGHBOURHOOD_PX, local_spread, surroundings
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_dark_temperature", "check_light_in_darks"]

#: Smallest correlation of a dark level with the flats' pattern, standard deviations: chance stays below 5.
SMALLEST_CORRELATION = 8.0

#: Smallest share of the increase of the dark level that is light: the rest is dark current, which has another pattern.
SMALLEST_LIGHT_SHARE = 0.3

#: Smallest rms of the flats' pattern, relative: without a pattern light and dark current cannot be distinguished.
SMALLEST_PATTERN = 1e-3

#: Smallest difference of the channels in a flat, over the brightest: without one light has no colour.
SMALLEST_COLOUR = 0.1

#: Details of a level beyond this many robust standard deviations are clipped: hot pixels.
CLIP_SIGMAS = 4

#: Smallest deviation of the dark current's factor in lit frames, standard deviations.
TEMPERATURE_SIGMAS = 6.0

#: Smallest suspicious deviation of that factor from 1: charge bends by a few percent, and repeats differ by as much.
SMALLEST_TEMPERATURE_CHANGE = 0.3

#: Fewest pixels that show the factor: one whose charge comes and goes shows nothing.
FEWEST_PIXELS = 3

#: Brightest count over full scale at which charge still adds up.
BRIGHTEST = 0.9


def check_light_in_darks(stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detect light in dark frames, which shows the sensitivities; dark current does not.

    The increase of the level over that of the shortest exposure is compared with the pattern of flats. Neither of the
    two levels was subtracted from these flats, so that no noise is common.

    Parameters
    ----------
    stacks
        All frames.
    dark
        Dark frames; two exposures or more.

    Yields
    ------
    Suspicion
        One for the capture, with the largest light.
    """
    flats = [s for s in stacks if s.kind == "flat"]
    if not flats:
        return
    measured = _light if len({s.lattice for s in flats}) == 1 else _light_by_colour
    pattern_text = "pixels'" if measured is _light else "colours'"
    lights = []
    for index in range(1, dark.exposure_s.size):
        light = measured(flats, dark, index)
        if light is not None:
            lights.append((light, index))
    if not lights:
        return
    (light_dn, share), index = max(lights)
    tables = [s.key for s in stacks if s.kind == "dark" for _, i in lights if s.exposure_s == dark.exposure_s[i]]
    shortest_s, exposure_s = dark.exposure_s[0], dark.exposure_s[index]
    at_exposure = light_dn * exposure_s / (exposure_s - shortest_s)
    yield Suspicion(
        "the dark frames hold light",
        ", ".join(tables),
        f"Of the level at {exposure_s:g} s, {light_dn:.3g} DN ({min(share, 1.0):.0%} of the increase over "
        f"the shortest exposure) show the {pattern_text} sensitivities as the flats do; dark current does not show "
        f"them. If this light shone in all dark frames, it is {at_exposure:.3g} DN at {exposure_s:g} s.",
    )


def _light(flats: Sequence[Stack], dark: DarkLibrary, index: int) -> tuple[float, float] | None:
    """Light, DN, in the increase of a dark level over the shortest exposure's, and its share.

    None if it is not significant.
    """
    patterns = []
    for flat in flats:
        weights = dark.weights(flat.exposure_s)
        if weights[0] == 0 and weights[index] == 0:
            net = flat.mean - flat.thinned(dark.at(flat.exposure_s))
            patterns.append(_detail(net) / max(float(np.median(net)), 1e-9))
    if len(patterns) < 2:
        return None
    pattern = np.mean(patterns, axis=0)
    # Noise of single flats is not in the product of different ones.
    rms = float(np.sqrt(max(_mean_product(patterns), 0.0)))
    increase = flats[0].thinned(dark.level[index] - dark.level[0])
    level = float(np.median(increase))
    if rms < SMALLEST_PATTERN or level <= 0:
        return None
    detail = _detail(increase)
    product = float(np.mean(detail * pattern))
    significance = product / max(float(detail.std() * pattern.std()), 1e-300) * np.sqrt(detail.size)
    light = product / rms**2
    if significance < SMALLEST_CORRELATION or light < SMALLEST_LIGHT_SHARE * level:
        return None
    return light, light / level


def _light_by_colour(flats: Sequence[Stack], dark: DarkLibrary, index: int) -> tuple[float, float] | None:
    """Light by the channels of a mosaic, as of ``_light``: their increase over that of a flat.

    A level of each channel that no exposure changes is not in the increase.
    """
    colours = [flat for flat in flats if flat.paths == flats[0].paths]
    bright = np.array([np.median(flat.mean - flat.thinned(dark.at(flat.exposure_s))) for flat in colours])
    if len(colours) < 2 or np.ptp(bright) < SMALLEST_COLOUR * bright.max():
        return None
    increases = [flat.thinned(dark.level[index] - dark.level[0]) for flat in colours]
    levels = np.array([np.median(increase) for increase in increases])
    # pixels whose charge is unusual are left out; the median of n normal values has a variance of pi / 2n
    spreads = [robust_sigma(x - np.median(x)) for x in increases]
    weight = np.array(
        [x.size / max(np.pi / 2 * spread**2, 1 / 12) for x, spread in zip(increases, spreads, strict=True)]
    )
    offset = bright - np.average(bright, weights=weight)
    slope = float(np.sum(weight * offset * levels) / np.sum(weight * offset**2))
    level, light = float(levels.mean()), slope * float(bright.mean())
    significance = slope * float(np.sqrt(np.sum(weight * offset**2)))
    if level <= 0 or significance < SMALLEST_CORRELATION or light < SMALLEST_LIGHT_SHARE * level:
        return None
    return light, light / level


def _detail(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) difference of each pixel from its neighbours, DN, mean 0, clipped."""
    detail = level - uniform_filter(level, NEIGHBOURHOOD_PX)
    spread = robust_sigma(detail - np.median(detail))
    detail = np.clip(detail, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)
    return np.asarray(detail - detail.mean(), np.float64)


def _mean_product(patterns: Sequence[NDArray[np.float64]]) -> float:
    """Mean product of different patterns (y, x): the variance of what they have in common."""
    total = np.sum(patterns, axis=0)
    squares = sum(float(np.mean(pattern**2)) for pattern in patterns)
    count = len(patterns)
    return (float(np.mean(total**2)) - squares) / (count * (count - 1))


def check_dark_temperature(stacks: Sequence[Stack], saturation_dn: float) -> Iterator[Suspicion]:
    """Detect dark frames of a sensor that was warmer or colder than in the lit frames.

    The uneven dark current of the longest dark frames is in each lit frame with a factor of 1, since both have the same
    current for their exposure. The lit frames are compared before any dark level is subtracted, with the product of two
    halves of the dark frames, so that no noise is common.

    Parameters
    ----------
    stacks
        All frames; the shortest and the longest dark exposure need two frames each.
    saturation_dn
        Full scale, DN.

    Yields
    ------
    Suspicion
        At most one.
    """
    darks = sorted((s for s in stacks if s.kind == "dark"), key=lambda s: s.exposure_s)
    if not darks or min(len(darks[0].frames), len(darks[-1].frames)) < 2:
        return
    span = darks[-1].exposure_s - darks[0].exposure_s
    exposed = [s for s in stacks if s.kind in ("band", "flat", "reference") and s.lattice == darks[0].lattice]
    if span <= 0 or not exposed:
        return
    first, other = (_unevenness([darks[0], darks[-1]], half) / span for half in (0, 1))
    rate, spread = (first + other) / 2, (first - other) / 2
    noise = robust_sigma(spread)
    not_full = darks[-1].counts.max(axis=0) < BRIGHTEST * saturation_dn
    charge, expected_charge, variance = (np.zeros_like(rate) for _ in range(3))
    for stack in exposed:
        detail = stack.mean - surroundings(stack.mean)
        weight = stack.exposure_s / np.maximum(local_spread(detail) ** 2, 1 / 12)
        weight = np.where(not_full & (stack.counts.max(axis=0) < BRIGHTEST * saturation_dn), weight, 0.0)
        charge += weight * detail * rate
        expected_charge += weight * stack.exposure_s * first * other
        variance += weight * stack.exposure_s * (rate**2 + noise**2)
        variance += (weight * stack.exposure_s) ** 2 * noise**2 * (rate**2 + noise**2)
    for _ in range(FEWEST_PIXELS):  # without the pixels that deviate most
        factor, pull = _factor_and_pull(charge, expected_charge, variance)
        if not abs(pull) > TEMPERATURE_SIGMAS or not abs(factor - 1) > SMALLEST_TEMPERATURE_CHANGE:
            return
        worst = int(np.argmax((expected_charge - charge) * np.sign(pull)))
        charge.flat[worst] = expected_charge.flat[worst] = variance.flat[worst] = 0.0
    yield Suspicion(
        f"the dark frames are of a sensor that was {'warmer' if factor < 1 else 'colder'} than in the other frames",
        "dark",
        f"The dark current of single pixels is in the photographs, flats and references with a factor of {factor:.2f} "
        f"+- {abs((factor - 1) / pull):.2f} of what the dark frames of {darks[-1].exposure_s:g} s show; 1 is expected.",
    )


def _unevenness(darks: Sequence[Stack], half: int) -> NDArray[np.float64]:
    """(y, x) DN by which pixels exceed their surroundings, long dark frames less short ones.

    half : 0 or 1, of the frames in turn.
    """
    short, long = (stack.counts[half::2].mean(axis=0) for stack in darks)
    return np.asarray(long - short - surroundings(long - short), np.float64)


def _factor_and_pull(
    charge: NDArray[np.float64], expected_charge: NDArray[np.float64], variance: NDArray[np.float64]
) -> tuple[float, float]:
    """Factor of the dark current in lit frames, and its distance below 1 in standard deviations."""
    total = float(expected_charge.sum())
    if total <= 0:
        return 1.0, 0.0
    return float(charge.sum()) / total, float((expected_charge - charge).sum()) / max(
        float(np.sqrt(variance.sum())), 1e-300
    )
