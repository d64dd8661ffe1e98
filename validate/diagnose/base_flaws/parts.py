"""Amplitudes of an effect in disjoint parts of its pattern.

A block that moved shifts its outline, and changes the light where it meets the floor. Light that is wrong there leaves
the outline as it is. Charge that leaks is in proportion to the light, a blur of shadows is not. A true effect has one
amplitude in all places and at all levels, to within errors of its shape. What imitates it has its own in each: they
scatter by as much as their size. The evidence of the two is that of a random-effects model (DerSimonian and Laird,
"Meta-analysis in clinical trials", Controlled Clinical Trials 7(3), 1986).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ..hypotheses import SHAPE_ERROR, SIGNIFICANT_SIGMA

__all__ = ["LEVELS", "PLACES", "PartAmplitudes", "amplitudes_by_part", "places_of", "thirds_by_level"]

#: Places in a picture: well inside faces, near the outline of something before another, near the line where two touch.
PLACES = ("inside faces", "at outlines", "where things touch")

#: Thirds of a pattern by the level of the signal.
LEVELS = ("in dim light", "in middling light", "in bright light")

#: Distance from a border within which a pixel belongs to it, px: contact shadows reach further than outlines.
_REACH_PX = (1.5, 2.5)

#: Share of the square of a pattern from which a part of it has an amplitude: less says nothing.
_MIN_PART = 1e-3


@dataclass(frozen=True)
class PartAmplitudes:
    """Amplitudes of an effect in parts of its pattern, what remains marginalised; 1 as fitted."""

    #: Names of the parts that show it.
    parts: tuple[str, ...] = ()
    #: Amplitude in each part.
    amplitude: tuple[float, ...] = ()
    #: Their standard deviations, by the scatter of what remains.
    sigma: tuple[float, ...] = ()
    #: 2 ln of the evidence of amplitudes that scatter by their size, over one amplitude for all parts.
    lead: float = -np.inf

    @property
    def unlike(self) -> str:
        """The two parts whose amplitudes differ most, in words; empty where chance explains it."""
        each = list(zip(self.amplitude, self.sigma, self.parts, strict=True))
        pairs = [(abs(a[0] - b[0]) / np.hypot(a[1], b[1]), a, b) for a in each for b in each if a < b]
        if not pairs or self.lead <= 0 or max(pairs)[0] <= SIGNIFICANT_SIGMA:
            return ""
        return " and ".join(f"{size:.2f} ± {sigma:.2f} {part}" for size, sigma, part in max(pairs)[1:])


def places_of(
    face: NDArray[np.int64], meeting: Iterable[tuple[int, int]], touching: Iterable[tuple[int, int]]
) -> NDArray[np.int64]:
    """Place that each pixel lies in.

    Parameters
    ----------
    face
        (y, x) face that a pixel shows; -1 for none.
    meeting
        Pairs of faces that meet in the picture.
    touching
        Those of them that touch in space.

    Returns
    -------
    NDArray
        (y, x) index of ``PLACES``; the nearer border decides.
    """
    close, away = set(touching), np.full((2, *face.shape), np.inf)
    for pair in meeting:
        apart = np.maximum(*(distance_transform_edt(face != side) for side in pair))
        nearest = away[int(pair in close)]
        np.minimum(nearest, apart, out=nearest)
    outline, contact = (distance <= reach for distance, reach in zip(away, _REACH_PX, strict=True))
    return np.where(contact & (away[1] <= away[0]), 2, np.where(outline, 1, 0))


def thirds_by_level(
    signal: NDArray[np.float64], band: NDArray[np.int64], shape: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Third of a pattern that each sample lies in, from dim to bright.

    Parameters
    ----------
    signal
        (n,) predicted signal, DN.
    band
        (n,) band of each sample.
    shape
        (n,) the pattern over sigma; each third has a third of its square in every band.

    Returns
    -------
    NDArray
        (n,) index of ``LEVELS``.
    """
    order = np.lexsort((signal, band))
    square = np.cumsum(shape[order] ** 2)
    bands, index = np.unique(band[order], return_inverse=True)
    total = np.diff(square[np.searchsorted(band[order], bands, side="right") - 1], prepend=0.0)
    before = np.cumsum(total) - total
    third = np.empty(len(shape), np.int64)
    third[order] = np.minimum(3 * (square - before[index]) / np.maximum(total[index], 1e-300), 2)
    return third


def amplitudes_by_part(
    names: tuple[str, ...],
    columns: NDArray[np.float64],
    part: NDArray[np.int64],
    patch: NDArray[np.int64],
    weigh: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    residual: NDArray[np.float64],
    flaws: NDArray[np.float64] | float = 0.0,
) -> PartAmplitudes:
    """Amplitudes of a pattern in its parts, fitted together.

    Parameters
    ----------
    names
        Names of the parts.
    columns
        (m, part) the pattern in each part, over sigma.
    part
        (n,) part of each sample; rows of priors follow them in the other arrays.
    patch
        (n,) patch of the picture within which what remains is correlated.
    weigh
        Columns times the inverse covariance by noise and flaws.
    residual
        (m,) residual without the effect.
    flaws
        (m,) part of the residual that the fitted flaws explain.

    Returns
    -------
    PartAmplitudes
        Of the parts with some of the pattern.
    """
    squares = np.sum(columns**2, axis=0)
    present = np.flatnonzero(squares > _MIN_PART * squares.sum())
    if len(present) < 2:
        return PartAmplitudes()
    columns, count = columns[:, present], len(part)
    weighted = weigh(columns)
    covariance = np.linalg.pinv(columns.T @ weighted, hermitian=True)
    amplitude = covariance @ (weighted.T @ residual)
    rest = residual - flaws - columns @ amplitude
    scores = np.zeros((int(patch.max()) + 1, len(names)))
    np.add.at(scores, (patch, part), columns[:count].sum(axis=1) * rest[:count])
    covariance = covariance * max(float(np.sum(scores**2)) / float(squares.sum()), 1.0)
    alike, unlike = (_score(amplitude, covariance + square * np.eye(len(present))) for square in (SHAPE_ERROR, 1.0))
    return PartAmplitudes(
        tuple(names[i] for i in present),
        tuple(amplitude.tolist()),
        tuple(np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()),
        alike - unlike,
    )


def _score(amplitude: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """-2 ln of the evidence of amplitudes about a mean that may be anything, but for a constant."""
    weight = np.linalg.inv(covariance)
    total = float(weight.sum())
    away = amplitude - float(weight.sum(axis=0) @ amplitude) / total
    return float(away @ weight @ away + np.linalg.slogdet(covariance)[1] + np.log(total))
