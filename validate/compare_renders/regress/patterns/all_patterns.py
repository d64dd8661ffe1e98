"""All tests of patterns of a difference, with their shares of the false alarms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .dark import cut_values, dark_pixels
from .difference import Difference, Finding
from .fine_light import moved_slightly, other_contrast
from .moved import moved_texture
from .noise_of_sides import filtered_noise, reused_numbers, shared_numbers
from .odd_parts import fixed_lines, odd_lines, odd_tiles, tile_steps
from .odd_squares import moved_part, small_part
from .periodic import periodic
from .pooled_mean import CANCELLING, SHARES, STRUCTURE, PooledMean, pool_of_finding
from .slow import slow_change
from .texture import fixed_pixels, textures
from .wave import ripple

__all__ = ["all_patterns"]


def _dark(
    difference: Difference, baseline: NDArray[np.float64], candidate: NDArray[np.float64], critical: float
) -> Finding:
    """Black pixels of one side."""
    with_errors = difference.variance is not None
    return dark_pixels(baseline, candidate, difference.smooth, critical, with_errors=with_errors)


def all_patterns(
    difference: Difference,
    totals: tuple[NDArray[np.float64], NDArray[np.float64]],
    false_alarms: float,
    cubes: tuple[NDArray[np.float64], NDArray[np.float64]],
    apart: tuple[NDArray[np.float64], NDArray[np.float64]],
    steps: float = 0.0,
    rounding: float = 0.0,
) -> tuple[PooledMean, ...]:
    """Tests of all patterns.

    Parameters
    ----------
    difference
        The difference.
    totals
        (y, x) pictures of both sides with their outliers, summed over wavelengths, the baseline first.
    false_alarms
        Rate of false alarms of the verdict.
    cubes
        (b, y, x) independent pictures of each side, as many of either, summed over wavelengths.
    apart
        (n, g, y, x) differences of independent pictures in groups of bands, and the mean (g, y, x) of both sides.
    steps
        Relative standard deviation that pixels have in common from the steps of files; 0 for fine steps.
    rounding
        The same of single pixels.

    Returns
    -------
    tuple of PooledMean
        One for each kind of pattern, at its clearest instance.
    """
    critical = {kind: false_alarms * SHARES[kind] for kind in (*CANCELLING, *STRUCTURE, "place")}
    findings = [
        ("grid", periodic(difference)),
        ("wave", ripple(difference, steps)),
        ("line", odd_lines(difference)),
        ("lines", fixed_lines(difference, apart[0])),
        ("fixed", fixed_pixels(difference, *apart, rounding)),
        ("tile", odd_tiles(difference)),
        ("steps", tile_steps(difference)),
        ("dark", _dark(difference, *totals, critical["dark"])),
        ("cut", cut_values(*cubes)),
        ("place", moved_texture(*totals)),
        ("slow", slow_change(difference)),
        ("contrast", other_contrast(difference, rounding)),
        ("displacement", moved_slightly(difference, rounding)),
        ("reused", reused_numbers(difference)),
        ("shared", shared_numbers(difference)),
        ("filter", filtered_noise(difference)),
        ("part", small_part(difference, *totals)),
        ("motion", moved_part(difference, *totals)),
    ]
    rows = [pool_of_finding(kind, finding, critical[kind]) for kind, finding in findings if finding is not None]
    of_texture = textures(difference)
    share = critical["texture"] / max(len(of_texture), 1)
    return (*rows, *(pool_of_finding("texture", finding, share) for finding in of_texture))
