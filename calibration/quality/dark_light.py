"""Check for light in the dark frames, by the pattern of the pixels' sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from ..correction import DarkLibrary
from .fingerprint import NEIGHBOURHOOD_PX
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_light_in_darks"]

#: Smallest correlation of a dark level with the flats' pattern, standard deviations: chance stays below 5.
SMALLEST_CORRELATION = 8.0

#: Smallest share of the increase of the dark level that is light: the rest is dark current, which has another pattern.
SMALLEST_LIGHT_SHARE = 0.3

#: Smallest rms of the flats' pattern, relative: without a pattern light and dark current cannot be distinguished.
SMALLEST_PATTERN = 1e-3

#: Details of a level beyond this many robust standard deviations are clipped: hot pixels.
CLIP_SIGMAS = 4


def check_light_in_darks(stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detect light in dark frames, which shows the pixels' sensitivities; dark current does not.

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
    if len({s.lattice for s in flats}) != 1:
        return
    lights = []
    for index in range(1, dark.exposure_s.size):
        light = _light(flats, dark, index)
        if light is not None:
            lights.append((light, index))
    if not lights:
        return
    (light_dn, share), index = max(lights)
    tables = [s.key for s in stacks if s.kind == "dark" for _, i in lights if s.exposure_s == dark.exposure_s[i]]
    yield Suspicion(
        "the dark frames hold light",
        ", ".join(tables),
        f"Of the level at {dark.exposure_s[index]:g} s, {light_dn:.3g} DN ({min(share, 1.0):.0%} of the increase over "
        "the shortest exposure) show the pixels' sensitivities as the flats do; dark current does not show them.",
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


def _detail(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) difference of each pixel from its neighbours, DN, mean 0, clipped."""
    detail = level - uniform_filter(level, NEIGHBOURHOOD_PX)
    spread = 1.4826 * float(np.median(np.abs(detail - np.median(detail))))
    detail = np.clip(detail, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)
    return np.asarray(detail - detail.mean(), np.float64)


def _mean_product(patterns: Sequence[NDArray[np.float64]]) -> float:
    """Mean product of different patterns (y, x): the variance of what they have in common."""
    total = np.sum(patterns, axis=0)
    squares = sum(float(np.mean(pattern**2)) for pattern in patterns)
    count = len(patterns)
    return (float(np.mean(total**2)) - squares) / (count * (count - 1))
