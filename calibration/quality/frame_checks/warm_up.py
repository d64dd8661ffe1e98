"""Check of the repeats of bands and brackets for a lamp that warms up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from cboxlab.utils.distributions import fisher_tail
from numpy.typing import NDArray

from ...correction import WARM_UP_REPEATS, DarkLibrary
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_warm_up"]

#: Probability with which drifting or trembling lamps pass for one that warms up; steady ones do not change enough.
FALSE_ALARM = 5e-4

#: Smallest change of the lamp over the series that is named, relative.
SMALLEST_CHANGE = 0.005

#: Time constants that are tried, min: from less than a series takes to where it looks like a straight drift.
TIME_CONSTANTS_MIN = np.geomspace(0.2, 20.0, 60)

#: Kinds of tables whose frames the scene's lamp lights.
OF_THE_LAMP = ("band", "bracket")


def check_warm_up(
    stacks: Sequence[Stack], dark: DarkLibrary, saturation_dn: int, readout_s: float
) -> Iterator[Suspicion]:
    """Detect a lamp whose repeats brighten less and less in the order of time.

    The light of the repeats, relative to the mean of their exposure, is compared with a straight line in time, as of a
    drift, and with an exponential.

    Parameters
    ----------
    stacks
        All frames.
    dark
        The dark levels.
    saturation_dn
        Count of saturated pixels, DN.
    readout_s
        Time between the end of a frame and the start of the next, s.

    Yields
    ------
    Suspicion
        At most one.
    """
    bands = [s for s in stacks if s.kind in OF_THE_LAMP and s.start_s is not None and len(s.frames) > 1]
    first_of = {stack.paths: stack for stack in reversed(bands)}  # channels of a mosaic share their frames
    measured = [each for s in first_of.values() if (each := _light(s, dark, saturation_dn, readout_s)) is not None]
    further = sum(minutes.size - 1 for minutes, _ in measured)
    if further < WARM_UP_REPEATS:
        return
    degrees = further - 2
    minutes, light = [minutes for minutes, _ in measured], np.concatenate([light for _, light in measured])
    start, end = min(each.min() for each in minutes), max(each.max() for each in minutes)
    straight = np.concatenate([each - each.mean() for each in minutes])
    decays = [np.exp(-(each - start) / TIME_CONSTANTS_MIN[:, None]) for each in minutes]
    shapes = np.concatenate([each - each.mean(axis=1, keepdims=True) for each in decays], axis=1)
    steady = float(np.sum((light - straight * (straight @ light) / (straight @ straight)) ** 2))
    sizes = shapes @ light / np.sum(shapes**2, axis=1)
    misfits = np.sum((light - sizes[:, None] * shapes) ** 2, axis=1)
    best = int(np.argmin(misfits))
    statistic = (steady - misfits[best]) / max(misfits[best] / degrees, 1e-300)
    constant = float(TIME_CONSTANTS_MIN[best])
    change = -float(sizes[best]) * (1 - np.exp(-(end - start) / constant))
    if statistic > 0 and fisher_tail(statistic, 1, degrees) < FALSE_ALARM and abs(change) > SMALLEST_CHANGE:
        yield Suspicion(
            "the lamp had not warmed up" if change > 0 else "the lamp fades after it was switched on",
            "band.frames",
            f"Its power changes by {change:+.1%} during the series, with a time constant of {constant:.2g} min, by the "
            "repeats of bands and brackets. Let it burn until repeats agree.",
        )


def _light(
    stack: Stack, dark: DarkLibrary, saturation_dn: int, readout_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Times of a band's repeats, min, and logarithms of their relative light, or None."""
    counts = stack.frames.astype(float)
    good = (counts.max(axis=0) < saturation_dn) & (counts.min(axis=0) > 0)
    levels: NDArray[np.float64] = (counts - dark.at(stack.exposure_s))[:, good].sum(axis=1)
    if not good.any() or levels.min() <= 0:
        return None
    times = ((stack.start_s or 0.0) + np.arange(len(levels)) * (stack.exposure_s + readout_s)) / 60
    return times, np.log(levels) - np.log(levels).mean()
