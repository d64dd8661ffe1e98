"""Check of the bands' repeats for a lamp that warms up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from cboxlab.utils.distributions import fisher_tail
from numpy.typing import NDArray

from ..correction import DarkLibrary
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_warm_up"]

#: Probability with which steady, drifting or trembling lamps pass for one that warms up.
FALSE_ALARM = 1e-6

#: Smallest change of the lamp over the series that is named, relative.
SMALLEST_CHANGE = 0.005

#: Time constants that are tried, min: from less than a series takes to where it looks like a straight drift.
TIME_CONSTANTS_MIN = np.geomspace(0.2, 20.0, 60)

#: Fewest bands with repeats at different times.
FEWEST_BANDS = 5


def check_warm_up(
    stacks: Sequence[Stack], dark: DarkLibrary, saturation_dn: int, readout_s: float
) -> Iterator[Suspicion]:
    """Detect a lamp whose repeats brighten less and less in the order of time.

    The rate of change between the repeats of each band is compared with a constant, which a drift has, and with an
    exponential.

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
    bands = [s for s in stacks if s.kind == "band" and s.start_s is not None and len(s.frames) > 1]
    first_of = {stack.paths: stack for stack in reversed(bands)}  # channels of a mosaic share their frames
    measured = [
        rate for stack in first_of.values() if (rate := _rate(stack, dark, saturation_dn, readout_s)) is not None
    ]
    if len(measured) < FEWEST_BANDS:
        return
    minutes, rates = np.array(measured).T
    minutes = minutes - minutes.min()
    steady = float(np.sum((rates - rates.mean()) ** 2))
    shapes = np.exp(-minutes / TIME_CONSTANTS_MIN[:, None])
    sizes = shapes @ rates / np.sum(shapes**2, axis=1)
    misfits = np.sum((rates - sizes[:, None] * shapes) ** 2, axis=1)
    best = int(np.argmin(misfits))
    degrees = len(rates) - 2
    statistic = (steady - misfits[best]) / max(misfits[best] / degrees, 1e-300)
    constant = float(TIME_CONSTANTS_MIN[best])
    change = float(sizes[best]) * constant * (1 - np.exp(-np.ptp(minutes) / constant))
    if statistic > 0 and fisher_tail(statistic, 1, degrees) < FALSE_ALARM and abs(change) > SMALLEST_CHANGE:
        yield Suspicion(
            "the lamp had not warmed up" if change > 0 else "the lamp fades after it was switched on",
            "band.frames",
            f"Its power changes by {change:+.1%} during the series, with a time constant of {constant:.2g} min, by the "
            "repeats of the bands. Let it burn until repeats agree.",
        )


def _rate(stack: Stack, dark: DarkLibrary, saturation_dn: int, readout_s: float) -> tuple[float, float] | None:
    """Middle of a band's repeats, min, and their relative change a minute; None without light."""
    counts = stack.counts.astype(float)
    good = (counts.max(axis=0) < saturation_dn) & (counts.min(axis=0) > 0)
    levels: NDArray[np.float64] = (counts - stack.thinned(dark.at(stack.exposure_s)))[:, good].sum(axis=1)
    if not good.any() or levels.min() <= 0:
        return None
    period = (stack.exposure_s + readout_s) / 60
    times = np.arange(len(levels)) * period
    slope = float(np.polyfit(times, np.log(levels), 1)[0])
    return (stack.start_s or 0.0) / 60 + float(times.mean()), slope
