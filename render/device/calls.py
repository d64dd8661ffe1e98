"""Sizes of kernel calls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cboxlab.utils.progress import checkpoint, stops_promptly

from .libraries import dr, mi

__all__ = ["finish_call", "lane_ranges", "lanes_per_call"]

#: Samples of all lanes in one kernel call of a computation that stops promptly: 0.13 s of CPU time for gathering rays,
#: on cores of 2.5 GHz. Half of it would take 1.6 times the time in all.
_PROMPT_SAMPLES = 2**20

#: Fewest lanes in one kernel call: fewer would leave cores idle, or take most of their time to record the kernel.
_FEWEST_LANES = 2**8


def lanes_per_call(samples: int, most: int) -> int:
    """Number of lanes in one kernel call.

    Parameters
    ----------
    samples
        Samples of each lane.
    most
        Number of lanes where nothing limits the time of a call.

    Returns
    -------
    int
        ``most``, or fewer in a computation that stops promptly.
    """
    return min(most, max(_PROMPT_SAMPLES // samples, _FEWEST_LANES)) if stops_promptly() else most


def lane_ranges(lanes: int, samples: int) -> Iterator[tuple[int, int]]:
    """Ranges of lanes, each for one kernel call, with a checkpoint before each.

    Parameters
    ----------
    lanes
        Number of lanes.
    samples
        Samples of each lane.

    Yields
    ------
    tuple of int
        First lane and end of a range. All lanes are in one range unless the computation stops promptly.
    """
    size = lanes_per_call(samples, lanes)
    for first in range(0, lanes, max(size, 1)):
        checkpoint()
        yield first, min(first + size, lanes)


def finish_call(values: Sequence[mi.Float]) -> None:
    """Checkpoint behind a kernel call, in a computation that stops promptly.

    Parameters
    ----------
    values
        Results of the kernel, which are waited for. Other computations do nothing here.
    """
    if stops_promptly():
        dr.eval(values)
        dr.sync_thread()
        checkpoint()
