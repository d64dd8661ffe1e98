"""Layers of a file that differ: albedo, normal, depth, objects.

Two renderings of one scene have the same layers where a pixel shows one surface, whatever the noise of their light. A
paint, the geometry or the camera has changed where they differ.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, maximum_filter, minimum_filter

from .patterns import SHARES, Finding, PooledMean, pool_of_finding
from .sides import Side

__all__ = ["changed_layers"]

#: Relative change of an albedo, a normal or a depth that counts: samples inside a pixel change it by less.
_CHANGE = 0.02
#: Part of the even pixels that agree at least; else the layers have other definitions.
_AGREEING = 0.5
#: Pixels a side of the smallest group that counts: single samples do not make four equal neighbours.
_GROUP_PX = 2
#: Probability of a finding over its critical one: a layer has no noise where it is even.
_CERTAIN = 1e-6


def changed_layers(baseline: Side, candidate: Side, false_alarms: float) -> tuple[PooledMean, ...]:
    """Test of each layer that both sides have.

    Parameters
    ----------
    baseline, candidate
        The sides, of one size.
    false_alarms
        Rate of false alarms of the verdict.

    Returns
    -------
    tuple of PooledMean
        The size is the part of the even pixels that differ. Layers of other definitions are left out.
    """
    critical = false_alarms * SHARES["layer"]
    rows = []
    for name, even, apart in (*_of_guides(baseline, candidate), *_of_objects(baseline, candidate)):
        apart &= even
        if apart.sum() > (1 - _AGREEING) * max(int(even.sum()), 1):
            continue
        grouped = bool(binary_opening(apart, np.ones((_GROUP_PX, _GROUP_PX))).any())
        size = float(apart.sum()) / max(int(even.sum()), 1) if grouped else 0.0
        probability = _CERTAIN * critical if grouped else 1.0
        finding = Finding(name, int(apart.sum()), size, max(size, 1e-12) / 10, 12.0, probability)
        rows.append(pool_of_finding("layer", finding, critical))
    return tuple(rows)


def _of_guides(baseline: Side, candidate: Side) -> Iterator[tuple[str, NDArray[np.bool_], NDArray[np.bool_]]]:
    """Name of each guide, pixels around which both sides are even, and pixels that differ."""
    for kind in sorted(set(baseline.guides) & set(candidate.guides)):
        first, second = (np.nan_to_num(side.guides[kind], posinf=0.0, neginf=0.0) for side in (baseline, candidate))
        if first.shape != second.shape:
            continue
        sizes = [np.abs(guide).max(axis=-1) for guide in (first, second)]
        least = 1e-3 * max(float(sizes[0].max()), 1e-30)
        steps = [_CHANGE * np.maximum(size, least) for size in sizes]
        even = (_span(first) < steps[0]) & (_span(second) < steps[1])
        yield kind, even, np.abs(second - first).max(axis=-1) > np.maximum(*steps)


def _of_objects(baseline: Side, candidate: Side) -> Iterator[tuple[str, NDArray[np.bool_], NDArray[np.bool_]]]:
    """The same of maps of objects by name."""
    maps = [side.surfaces for side in (baseline, candidate)]
    first, second = maps
    if first is None or second is None or not (first.of_objects and second.of_objects):
        return
    names = sorted({*first.names, *second.names})
    if first.index.shape != second.index.shape or len(names) < 2:
        return
    numbers = []
    for surfaces in (first, second):
        number = np.array([*(names.index(name) for name in surfaces.names), -1])
        numbers.append(number[np.where(surfaces.index < 0, -1, surfaces.index)])
    even = np.logical_and.reduce([(minimum_filter(n, 3) >= 0) & (_span(n[..., None]) == 0) for n in numbers])
    yield "objects", even, numbers[0] != numbers[1]


def _span(guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) largest range of a guide's component in 3 x 3 pixels."""
    return np.asarray((maximum_filter(guide, (3, 3, 1)) - minimum_filter(guide, (3, 3, 1))).max(axis=-1))
