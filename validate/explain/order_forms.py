"""Levels of the bands: by the order in time in which they were taken, or by their wavelengths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .excess import Excess
from .field import FieldFit, Normal, finished, solved
from .form import Form, equations

__all__ = ["order_forms"]

#: Repeats of a band differ where their chi2 exceeds this multiple of what noise makes of it.
_REPEATS_DIFFER = 4.0


def order_forms(excess: Excess) -> Iterator[Form]:
    """Levels that step or run with time, and levels that follow the wavelength or stand out in a line."""

    def made(band: int) -> NDArray[Any]:
        return excess.signal[band].astype(np.float32).reshape(1, -1)

    n = equations(excess, made)
    bands = len(excess.bands)
    rank = np.argsort(np.argsort(excess.minutes))
    time = excess.minutes - excess.minutes.min()
    repeats = repeats_excess(excess)
    for k in range(1, bands):
        step = (rank >= k).astype(float)
        yield Form(
            "time-order", "a step of the lamp", _shaped(n, step[:, None], repeats), made, choices=bands
        )
        if k < bands - 1:
            ramp = np.maximum(time - np.sort(time)[k], 0)
            yield Form(
                "time-order",
                "a drift of the lamp that sets in",
                _shaped(n, ramp[:, None], repeats),
                made,
                choices=bands,
            )
    powers = np.array([(time / max(time.max(), 1e-9)) ** p for p in (1, 2, 3)]).T
    yield Form("time-order", "a drift of the lamp", _shaped(n, powers[:, :2], repeats), made)
    if repeats > 0:
        yield Form(
            "time-order", "levels that differ from frame to frame", _shaped(n, np.eye(bands), repeats), made
        )
    place = (excess.nm - excess.nm.min()) / max(np.ptp(excess.nm), 1e-9)
    waves = np.array([np.cos(np.pi * i * place) for i in (1, 2, 3)]).T
    yield Form("lamp-spectrum", "smooth over the wavelength", _shaped(n, waves, 0.0), made)
    order = np.argsort(excess.nm)
    for i in range(bands):
        yield Form("lamp-spectrum", "a line", _shaped(n, np.eye(bands)[:, [i]], 0.0), made, choices=bands)
        if i + 1 < bands:
            pair = np.eye(bands)[:, order[i : i + 2]]
            yield Form("lamp-spectrum", "a line", _shaped(n, pair, 0.0), made, choices=bands)
    yield Form("lamp-spectrum", "free in each band", _shaped(n, np.eye(bands), 0.0), made)


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
    trial, *_ = solved(shapes.T @ own @ shapes, shapes.T @ n.own_b[:, 0], width)
    return finished(n, (shapes @ x)[:, None], (shapes @ trial)[:, None], evidence + more, freedom)
