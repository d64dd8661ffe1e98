"""Changes between frames by their time: steps and drifts of the lamp, image persistence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..field_fit import (
    Advice,
    Family,
    FieldFit,
    FitInput,
    FittedExplanation,
    ResidualData,
    equations_in_all_bands,
    fixed_spectrum,
)
from ..shared_forms import EVEN, fit_levels, level_equations, relative_levels

__all__ = ["FAMILY"]

#: Chi2 of the differences of repeats, over its mean by noise, above which repeats differ.
_MIN_REPEATS_CHI2 = 4.0


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    repeats = repeats_excess(fit_input.data)
    yield from _in_order(fit_input, repeats)
    if repeats > 0 or not np.isfinite(fit_input.data.repeat_sigma).any():  # single frames carry no other information
        columns = relative_levels(fit_input.data)
        _, frame = np.unique(fit_input.data.minutes, return_inverse=True)
        fit = fit_levels(level_equations(fit_input.data), np.eye(int(frame.max()) + 1)[frame], repeats)
        yield FittedExplanation(FAMILY, "levels that differ from frame to frame", fit, columns, "gain", EVEN)


def _in_order(fit_input: FitInput, repeats: float = 0.0) -> Iterator[FittedExplanation]:
    """Steps, drifts and persistence.

    Channels of one frame have one time; without a second one nothing changed.

    repeats : 2 ln evidence from differences of repeats; against effects the picture alone counts.
    """
    data = fit_input.data
    columns = relative_levels(data)

    def levels(form: str, fit: FieldFit, num_choices: int = 1) -> FittedExplanation:
        return FittedExplanation(FAMILY, form, fit, columns, "gain", EVEN, num_choices=num_choices)

    moments, rank = np.unique(data.minutes, return_inverse=True)
    if len(moments) < 2:
        return
    n = level_equations(data)
    number = len(moments)
    time = data.minutes - moments[0]
    for first, last in combinations(range(number + 1), 2):
        if (first, last) == (0, number):
            continue
        form = "a step of the lamp" if first == 0 or last == number else "another level of the lamp for a while"
        inside = ((rank >= first) & (rank < last)).astype(float)
        yield levels(form, fit_levels(n, inside[:, None], repeats), number * (number + 1) // 2)
    for moment in moments[1:-1]:
        ramp = np.maximum(data.minutes - moment, 0)
        yield levels("a drift of the lamp that sets in", fit_levels(n, ramp[:, None], repeats), number)
    powers = np.array([(time / max(time.max(), 1e-9)) ** p for p in (1, 2, 3)]).T
    yield levels("a drift of the lamp", fit_levels(n, powers[:, :2], repeats))
    yield _persistence(data, repeats)


def _persistence(data: ResidualData, repeats: float) -> FittedExplanation:
    """Image persistence: a part of every frame is visible again in the next one.

    ``repeats`` is the evidence from differences of repeats.
    """
    bands = len(data.bands)
    frames = np.maximum(np.isfinite(data.repeats).sum(axis=1), 1)
    before = np.diag((frames - 1.0) / frames)
    _, rank = np.unique(data.minutes, return_inverse=True)
    for band in np.flatnonzero(rank):
        earlier = np.flatnonzero(rank == rank[band] - 1)
        same_pixels = [int((data.used[band] & data.used[other]).sum()) for other in earlier]
        before[band, earlier[int(np.argmax(same_pixels))]] += 1 / frames[band]
    signal = data.signal.reshape(bands, -1)

    def previous(band: int) -> NDArray[Any]:
        return (before[band] @ signal).astype(np.float32).reshape(1, -1)

    fit = fixed_spectrum(equations_in_all_bands(data, previous), np.ones(bands))
    fit = replace(fit, coefficients=fit.coefficients * before, evidence=fit.evidence + repeats)
    form = "a part of each frame stays in the next"
    return FittedExplanation(FAMILY, form, fit, lambda _: signal.astype(np.float32), "previous", EVEN)


def repeats_excess(data: ResidualData) -> float:
    """Chi2 by which the repeats of bands differ beyond noise.

    Parameters
    ----------
    data
        Residual with the levels of its repeats.

    Returns
    -------
    float
        Chi2 less its mean by noise; 0 where noise explains the differences.
    """
    determined = np.isfinite(data.repeats) & np.isfinite(data.repeat_sigma)[:, None]
    chi2 = float(np.sum(np.where(determined, data.repeats / data.repeat_sigma[:, None], 0.0) ** 2))
    free = float(np.sum(np.maximum(determined.sum(axis=1) - 1, 0)))
    return chi2 - free if free and chi2 > _MIN_REPEATS_CHI2 * free else 0.0


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "stays in the next",
        "in the sensor, from frame to frame",
        ("charge that a sensor releases late", "a filter wheel that is late", "frames read before they were cleared"),
        "Take a dark frame right after a bright one: an image in it settles it.",
    ),
    Advice(
        "frame to frame",
        "in time: each frame has its level",
        ("a lamp that flickers", "a shutter that is not repeatable", "a supply without regulation"),
        "Take ten frames of one band in a row, and compare their mean counts.",
    ),
    Advice(
        "drift",
        "in time",
        ("a lamp that warms up", "a lamp that ages", "a sensor whose temperature drifts"),
        "Let the lamp burn for an hour, then take the first band at the beginning and at the end.",
    ),
    Advice(
        "",
        "in time",
        (
            "a setting of the camera, such as its gain, that was changed during the series",
            "a step of the supply's voltage",
            "a lamp that arcs",
        ),
        "Take the bands again in the reverse order, with the camera's settings locked: a step in time then shows in "
        "other bands.",
    ),
)

FAMILY = Family(
    id="time-order",
    title="a change between frames in the order of time",
    acts_on="frames",
    generate=_generate,
    order=50,
    localised=False,
    levels=True,
    rivals=_in_order,
    advice=_ADVICE,
)
