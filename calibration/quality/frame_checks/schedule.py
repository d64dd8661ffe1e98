"""Checks of start times and exposures against each other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from ...correction import CorrectedBands
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_brackets", "check_exposures", "check_schedule"]

#: Overlap of two exposures that is not suspected, s: clocks are read to a second.
CLOCK_S = 2.0

#: The same over the exposure of the first frames: the readout may be a little shorter than stated.
CLOCK_SHARE = 0.02

#: Longest plausible capture, s: two days.
LONGEST_CAPTURE_S = 2 * 86400.0

#: Longest plausible exposure, s: two hours.
LONGEST_EXPOSURE_S = 7200.0

#: Exposures are equal within this relative difference, the rounding of a decimal number.
EQUAL_EXPOSURES = 1e-6


def check_schedule(stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Check that bands are in the order taken and that exposures do not overlap.

    Parameters
    ----------
    stacks
        All frames; tables without ``start_s`` are not checked.

    Yields
    ------
    Suspicion
        At most one for each kind of contradiction, one for each pair of bands that start together.
    """
    timed: list[Stack] = []
    for stack in stacks:
        if stack.start_s is not None and not any(stack.shares_frames(other) for other in timed):
            timed.append(stack)
    order = sorted(timed, key=lambda s: s.start_s or 0.0)
    yield from _check_order(timed)
    yield from _check_overlap(order)
    yield from _check_same_start(order)
    yield from _check_unit_of_time(order)


def _check_order(timed: Sequence[Stack]) -> Iterator[Suspicion]:
    """Bands must be in the order taken."""
    bands = [s for s in timed if s.kind == "band"]
    starts = [s.start_s for s in bands if s.start_s is not None]
    if len(starts) > 1 and np.any(np.diff(starts) < 0):
        late = bands[1 + int(np.argmax(np.diff(starts) < 0))]
        yield Suspicion(
            "the start times are out of order",
            f"{late.key}.start_s",
            f"Bands must be in the order taken, but this one started at {late.start_s:g} s, before the previous one.",
        )


def _check_overlap(order: Sequence[Stack]) -> Iterator[Suspicion]:
    """First table that starts before the exposures of the one before it end.

    Exposures alone count: a camera may read one frame out while it exposes the next.
    """
    for before, after in itertools.pairwise(order):
        if before.start_s is None or after.start_s is None:
            continue
        end = before.start_s + len(before.paths) * before.exposure_s
        if after.start_s < end - CLOCK_S - CLOCK_SHARE * (end - before.start_s):
            yield Suspicion(
                "start times and exposures contradict each other (an exposure or a start time in another unit, or "
                "wrong)",
                f"{after.key}.start_s",
                f"It starts at {after.start_s:g} s, but {before.key} (start {before.start_s:g} s, "
                f"{len(before.paths)} x {before.exposure_s:g} s) is exposed until {end:g} s.",
            )
            break


def _check_same_start(order: Sequence[Stack]) -> Iterator[Suspicion]:
    """Two bands cannot start at the same time."""
    for before, after in itertools.pairwise(order):
        if before.kind == after.kind == "band" and before.start_s == after.start_s:
            yield Suspicion(
                "two bands begin at the same time",
                f"{after.key}.start_s",
                f"{before.key} begins then as well.",
            )


def _check_unit_of_time(order: Sequence[Stack]) -> Iterator[Suspicion]:
    """Start times must count from the first frame, in seconds."""
    if order and abs(order[0].start_s or 0.0) > LONGEST_CAPTURE_S:
        yield Suspicion(
            "start times do not count from the first frame",
            f"{order[0].key}.start_s",
            f"The first begins at {order[0].start_s:g} s.",
        )
    elif order and (order[-1].start_s or 0.0) > LONGEST_CAPTURE_S:
        yield Suspicion(
            "the start times are in another unit than seconds",
            f"{order[-1].key}.start_s",
            f"The last begins at {order[-1].start_s:g} s, {(order[-1].start_s or 0) / 86400:.1f} days after the first.",
        )


def check_exposures(stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detect exposures too long for a camera, and an exposure without dark frames.

    Parameters
    ----------
    stacks
        All frames.

    Yields
    ------
    Suspicion
        For the longest exposure. For an exposure without dark frames, if one exposure of the darks fits no frames and
        all others match.
    """
    longest = max(stacks, key=lambda s: s.exposure_s)
    if longest.exposure_s > LONGEST_EXPOSURE_S:
        yield Suspicion(
            "exposures are in another unit than seconds (milliseconds)",
            f"{longest.key}.exposure_s",
            f"The longest is {longest.exposure_s:g} s, {longest.exposure_s / 3600:.1f} hours.",
        )
    darks = {s.exposure_s for s in stacks if s.kind == "dark"}
    bright = [s for s in stacks if s.kind != "dark"]
    used = {s.exposure_s for s in bright}
    missing = [s for s in bright if not any(np.isclose(s.exposure_s, d, rtol=EQUAL_EXPOSURES) for d in darks)]
    unused = [d for d in darks if not any(np.isclose(d, e, rtol=EQUAL_EXPOSURES) for e in used)]
    if len(darks) > 2 and len({s.exposure_s for s in missing}) == 1 and len(unused) == 1:
        yield Suspicion(
            "an exposure is wrong: of the frames or of their dark frames",
            f"{missing[0].key}.exposure_s",
            f"There are no dark frames at its {missing[0].exposure_s:g} s, and those at {unused[0]:g} s match no "
            "exposure; all others match.",
        )


def check_brackets(bands: CorrectedBands) -> Iterator[Suspicion]:
    """Name the exposure times that do not fit the counts of a band's other exposures.

    Parameters
    ----------
    bands
        Corrected bands of a capture, whose exposures were compared.

    Yields
    ------
    Suspicion
        At most one for each band.
    """
    for finding in bands.exposure_findings:
        # a band's own exposure comes first, then its brackets, see ``merged_tables``
        wrong = finding.index
        what = "an exposure time does not fit the counts"
        if wrong is None:
            what = "the exposure time of one of two exposures does not fit the counts"
        key = f"band ({finding.band})" if wrong == 0 else f"bracket ({finding.band})"
        counted = "the other exposure" if wrong is None else "the other exposures"
        yield Suspicion(
            what,
            f"{key}.exposure_s",
            f"{finding.stated_s:g} s are stated; by {counted} of {finding.band} the counts are those of "
            f"{finding.fitting_s:.3g} s ({finding.fitting_s / finding.stated_s - 1:+.1%}). "
            + ("It was left out." if wrong else "The exposures were not merged."),
        )
