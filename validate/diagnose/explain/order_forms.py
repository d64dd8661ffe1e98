"""Levels of the bands, by the order in time in which they were taken or by their wavelengths; frames that stay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray

from .excess import Excess
from .field import FieldFit, Normal, finished, fixed_spectrum, solved, trial
from .form import Form, equations

__all__ = ["order_forms"]

#: Repeats of a band differ where their chi2 exceeds this multiple of what noise makes of it.
_REPEATS_DIFFER = 4.0

#: Lines of the lamp are looked for in up to so many bands together, of the bands that stand out most.
_MOST_LINES, _LIKELY_LINES = 3, 8

#: One map, 1 everywhere.
_EVEN = ImageMaps("cosines")


def order_forms(excess: Excess) -> Iterator[Form]:
    """Levels that step or run with time, levels that follow the wavelength or stand out in a line, and a part of each
    frame that stays in the next one."""

    def made(band: int) -> NDArray[Any]:
        return excess.signal[band].astype(np.float32).reshape(1, -1)

    def in_time(words: str, fit: FieldFit, choices: int = 1) -> Form:
        return Form("time-order", words, fit, made, "gain", _EVEN, choices=choices)

    def in_lamp(words: str, fit: FieldFit, choices: int = 1) -> Form:
        return Form("lamp-spectrum", words, fit, made, "lamp", _EVEN, choices=choices)

    n = equations(excess, made)
    bands = len(excess.bands)
    rank = np.argsort(np.argsort(excess.minutes))
    time = excess.minutes - excess.minutes.min()
    repeats = repeats_excess(excess)
    for first, last in combinations(range(bands + 1), 2):
        if (first, last) == (0, bands):
            continue
        words = "a step of the lamp" if first == 0 or last == bands else "another level of the lamp for a while"
        inside = ((rank >= first) & (rank < last)).astype(float)
        yield in_time(words, _shaped(n, inside[:, None], repeats), bands * (bands + 1) // 2)
    for k in range(1, bands - 1):
        ramp = np.maximum(time - np.sort(time)[k], 0)
        yield in_time("a drift of the lamp that sets in", _shaped(n, ramp[:, None], repeats), bands)
    powers = np.array([(time / max(time.max(), 1e-9)) ** p for p in (1, 2, 3)]).T
    yield in_time("a drift of the lamp", _shaped(n, powers[:, :2], repeats))
    if repeats > 0 or not np.isfinite(excess.repeat_sigma).any():  # of single frames nothing else is known
        yield in_time("levels that differ from frame to frame", _shaped(n, np.eye(bands), repeats))
    yield _persistence(excess, repeats)
    place = (excess.nm - excess.nm.min()) / max(np.ptp(excess.nm), 1e-9)
    waves = np.array([np.cos(np.pi * i * place) for i in (1, 2, 3)]).T
    yield in_lamp("smooth over the wavelength", _shaped(n, waves, 0.0))
    alone = n.b[:, 0] ** 2 / np.maximum(n.a[:, 0, 0], 1e-300)
    likely = np.argsort(-alone)[:_LIKELY_LINES]
    for size in range(1, _MOST_LINES + 1):
        for some in combinations(np.sort(likely), size):
            lines = _shaped(n, np.eye(bands)[:, list(some)], 0.0)
            yield in_lamp("a line" if size == 1 else "lines", lines, comb(bands, size))
    yield in_lamp("free in each band", _shaped(n, np.eye(bands), 0.0))


def _persistence(excess: Excess, repeats: float) -> Form:
    """A part of every frame is seen again in the next one. repeats : evidence from differences of repeats."""
    bands = len(excess.bands)
    frames = np.maximum(np.isfinite(excess.repeats).sum(axis=1), 1)
    before = np.diag((frames - 1.0) / frames)
    order = np.argsort(excess.minutes, kind="stable")
    before[order[1:], order[:-1]] += 1 / frames[order[1:]]
    signal = excess.signal.reshape(bands, -1)

    def alone(band: int) -> NDArray[Any]:
        return (before[band] @ signal).astype(np.float32).reshape(1, -1)

    fit = fixed_spectrum(equations(excess, alone), np.ones(bands))
    fit = replace(fit, coefficients=fit.coefficients * before, evidence=fit.evidence + repeats)
    words = "a part of each frame stays in the next"
    return Form("time-order", words, fit, lambda _: signal.astype(np.float32), "previous", _EVEN)


def repeats_excess(excess: Excess) -> float:
    """Chi2 by which repeats of bands differ beyond noise; 0 where noise explains it."""
    known = np.isfinite(excess.repeats) & np.isfinite(excess.repeat_sigma)[:, None]
    chi2 = float(np.sum(np.where(known, excess.repeats / excess.repeat_sigma[:, None], 0.0) ** 2))
    free = float(np.sum(np.maximum(known.sum(axis=1) - 1, 0)))
    return chi2 - free if free and chi2 > _REPEATS_DIFFER * free else 0.0


def _shaped(n: Normal, shapes: NDArray[Any], more: float) -> FieldFit:
    """Levels of the bands that are sums of shapes (band, q). more : evidence from elsewhere."""
    nuisance = n.c[:, :, 0]
    h = np.diag(n.a[:, 0, 0]) - nuisance @ nuisance.T
    own = np.diag(n.own_a[:, 0, 0])
    size = np.linalg.norm(shapes, axis=0)
    shapes = shapes / np.where(size > 0, size, 1)
    x, evidence, freedom, width = solved(shapes.T @ h @ shapes, shapes.T @ n.b[:, 0])
    seen = trial(shapes.T @ own @ shapes, shapes.T @ n.own_b[:, 0], width)
    return finished(n, (shapes @ x)[:, None], (shapes @ seen)[:, None], evidence + more, freedom)
