"""Layers of a file that differ: albedo, normal, depth, objects.

Two renderings of one scene have the same layers where a pixel shows one surface, whatever the noise of their light. A
paint, the geometry or the camera has changed where they differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, maximum_filter, minimum_filter

__all__ = ["LayerChange", "changed_layers"]

#: Relative change of an albedo, a normal or a depth that counts: samples inside a pixel change it by less.
_CHANGE = 0.02
#: Part of the even pixels that agree at least; else the layers have other definitions.
_AGREEING = 0.5
#: Pixels a side of the smallest group that counts: single samples do not make four equal neighbours.
_GROUP_PX = 2


@dataclass(frozen=True)
class LayerChange:
    """Comparison of one layer of two files."""

    #: Name of the layer.
    name: str
    #: Number of pixels that differ, of those around which both sides are even.
    pixels: int
    #: Part of the even pixels that differ; 0 where single pixels alone do.
    part: float


def changed_layers(
    guides: tuple[Mapping[str, NDArray[np.float64]], Mapping[str, NDArray[np.float64]]],
    objects: tuple[tuple[NDArray[np.int64], tuple[str, ...]] | None, tuple[NDArray[np.int64], tuple[str, ...]] | None],
) -> tuple[LayerChange, ...]:
    """Comparison of each layer that both sides have.

    Parameters
    ----------
    guides
        (y, x, c) albedo, normal, depth of each side by kind.
    objects
        (y, x) index of each side's objects, negative outside, and their names; None without a map of objects.

    Returns
    -------
    tuple of LayerChange
        Layers of other definitions are left out.
    """
    changes = []
    for name, even, apart in (*_of_guides(*guides), *_of_objects(*objects)):
        apart &= even
        if apart.sum() > (1 - _AGREEING) * max(int(even.sum()), 1):
            continue
        grouped = bool(binary_opening(apart, np.ones((_GROUP_PX, _GROUP_PX))).any())
        part = float(apart.sum()) / max(int(even.sum()), 1) if grouped else 0.0
        changes.append(LayerChange(name, int(apart.sum()), part))
    return tuple(changes)


def _of_guides(
    baseline: Mapping[str, NDArray[np.float64]], candidate: Mapping[str, NDArray[np.float64]]
) -> Iterator[tuple[str, NDArray[np.bool_], NDArray[np.bool_]]]:
    """Name of each guide, pixels around which both sides are even, and pixels that differ."""
    for kind in sorted(set(baseline) & set(candidate)):
        first, second = (np.nan_to_num(side[kind], posinf=0.0, neginf=0.0) for side in (baseline, candidate))
        if first.shape != second.shape:
            continue
        sizes = [np.abs(guide).max(axis=-1) for guide in (first, second)]
        least = 1e-3 * max(float(sizes[0].max()), 1e-30)
        steps = [_CHANGE * np.maximum(size, least) for size in sizes]
        even = (_span(first) < steps[0]) & (_span(second) < steps[1])
        yield kind, even, np.abs(second - first).max(axis=-1) > np.maximum(*steps)


def _of_objects(
    baseline: tuple[NDArray[np.int64], tuple[str, ...]] | None,
    candidate: tuple[NDArray[np.int64], tuple[str, ...]] | None,
) -> Iterator[tuple[str, NDArray[np.bool_], NDArray[np.bool_]]]:
    """The same of maps of objects by name."""
    if baseline is None or candidate is None:
        return
    names = sorted({*baseline[1], *candidate[1]})
    if baseline[0].shape != candidate[0].shape or len(names) < 2:
        return
    numbers = []
    for index, own_names in (baseline, candidate):
        number = np.array([*(names.index(name) for name in own_names), -1])
        numbers.append(number[np.where(index < 0, -1, index)])
    even = np.logical_and.reduce([(minimum_filter(n, 3) >= 0) & (_span(n[..., None]) == 0) for n in numbers])
    yield "objects", even, numbers[0] != numbers[1]


def _span(guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) largest range of a guide's component in 3 x 3 pixels."""
    return np.asarray((maximum_filter(guide, (3, 3, 1)) - minimum_filter(guide, (3, 3, 1))).max(axis=-1))
