"""Explanations by another view: mirrored, shifted, magnified, turned, distorted, another pixel filter or border."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from .evidence import Evidence
from .explanations import Explanation, exact

__all__ = ["from_view"]

#: Largest shift looked for, px. Magnifications less 1, angles (radians) and distortions at half a width (part of it).
_REACH_PX = 4
_PARTS = np.linspace(-0.1, 0.1, 41)
#: Pixels a side of the pictures by which starts are judged, at least.
_START_PX = 96
#: Steps of Gauss and Newton.
_STEPS = 6
#: Neighbours that differ by this part of their sum have an edge between them. Step of finite differences, px.
_EDGE, _SLOPE_PX = 0.05, 0.1
#: A picture is not moved more exactly than this, px: a smaller magnification or turn is none.
_EXACT_PX = 0.05
#: Widest border that a change of the view may bring into the picture, px.
_WIDEST_PX = 16


def from_view(evidence: Evidence) -> Iterator[Explanation]:
    """All of them, fitted."""
    yield from _mirrored(evidence)
    yield from _displaced(evidence.grouped())
    yield _filter(evidence)
    yield from _border(evidence)


def _mirrored(evidence: Evidence) -> Iterator[Explanation]:
    base = evidence.baseline
    for axis, picture in {
        "horizontal": base[:, ::-1],
        "vertical": base[::-1],
        "both": base[::-1, ::-1],
    }.items():
        yield Explanation("mirrored", {"axis": axis}, exact(evidence, picture).chi2, 1)


def moved(picture: NDArray[np.float64], by_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """The picture (y, x, w) whose pixels show what lies ``by_px`` (2, y, x) before them along x and y, edges sharp.

    A pixel whose value lies between those of its two neighbours, and whose neighbours differ much, holds an edge at the
    place that its value tells (volume of fluid, Hirt and Nichols 1981); all others are uniform.
    """
    along_x = _moved_along_x(picture, by_px[0])
    return np.swapaxes(_moved_along_x(np.swapaxes(along_x, 0, 1), by_px[1].T), 0, 1)


def _moved_along_x(picture: NDArray[np.float64], by_px: NDArray[np.float64]) -> NDArray[np.float64]:
    whole = np.floor(by_px).astype(int)
    part = (by_px - whole)[..., None]
    rows, columns = np.indices(by_px.shape)

    def at(step: int) -> NDArray[np.float64]:
        return picture[rows, np.clip(columns - whole + step, 0, by_px.shape[1] - 1)]

    far, coming, here, after = (at(step) for step in (-2, -1, 0, 1))
    place = _edge_place(far, coming, here)
    left = np.clip(place - (1 - part), 0, part) / np.maximum(part, 1e-9)
    last = np.where(np.isnan(place), coming, left * far + (1 - left) * here)
    place = _edge_place(coming, here, after)
    right = np.clip(place, 0, 1 - part) / (1 - part)
    rest = np.where(np.isnan(place), here, right * coming + (1 - right) * after)
    return part * last + (1 - part) * rest


def _edge_place(before: NDArray, own: NDArray, after: NDArray) -> NDArray[np.float64]:
    """The part of a pixel that is like the one before; NaN where it holds no edge."""
    step = before - after
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (own - after) / step
    edge = (np.abs(step) > _EDGE * (before + after)) & (place >= 0) & (place <= 1)
    return np.where(edge, place, np.nan)


def _displaced(evidence: Evidence) -> Iterator[Explanation]:
    """By fields of displacement, px at half a width from the picture's centre; clockwise turns are positive."""
    height, width = evidence.baseline.shape[:2]
    half = max(width - 1, 1) / 2
    y, x = np.meshgrid(np.arange(height) - (height - 1) / 2, np.arange(width) - half, indexing="ij")
    one, none, r2 = np.ones_like(x), np.zeros_like(x), (x**2 + y**2) / half**2
    shift = [np.array([one, none]), np.array([none, one])]
    zoom, turn, cubic = np.array([x, y]) / half, np.array([-y, x]) / half, r2 * np.array([x, y]) / half
    reach = range(-_REACH_PX, _REACH_PX + 1)
    place, chi2 = _fitted(evidence, shift, [(dx, dy) for dx in reach for dy in reach])
    yield Explanation("shift", {"dx_px": float(place[0]), "dy_px": float(place[1])}, chi2, 6)
    by_px = half * _PARTS
    starts = [(0, 0, 0, 0), *((0, 0, s, 0) for s in by_px), *((0, 0, 0, t) for t in by_px)]
    (dx, dy, s, t), chi2 = _fitted(evidence, [*shift, zoom, turn], starts)
    back = complex(1 - s / half, t / half)  # from the candidate's place to the baseline's, about the centre
    parameters = {
        "magnification": 1 / abs(back),
        "turned_deg": float(np.degrees(np.angle(back))),
        "dx_px": float(dx),
        "dy_px": float(dy),
    }
    if max(abs(s), abs(t)) > _EXACT_PX:
        yield Explanation("view", parameters, chi2, 8)
    (*_, cubic_px), chi2 = _fitted(evidence, [*shift, cubic], [(0, 0, c) for c in by_px])
    if abs(cubic_px) > _EXACT_PX / 2:  # twice as much or more in the corners
        yield Explanation("distortion", {"outwards_px_at_half_width": float(cubic_px)}, chi2, 7)


def _fitted(
    evidence: Evidence, fields: Sequence[NDArray[np.float64]], starts: Sequence[Sequence[float]]
) -> tuple[NDArray[np.float64], float]:
    """Amplitudes of fields of displacement (2, y, x) px, and chi-square; from the best start by the slopes of the moved
    picture."""
    base, fields_px = evidence.baseline, np.array(fields)
    every = max(1, min(base.shape[:2]) // _START_PX)  # starts are judged on coarse pixels
    total, goal = (_coarse(p.sum(axis=-1), every)[..., None] for p in (base, evidence.candidate))
    coarse_px = np.array([[_coarse(part, every) / every for part in field] for field in fields])
    size = np.maximum(total, 1e-3 * total.mean())

    def by(place: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.tensordot(place, fields_px, 1)

    def cost(start: NDArray[np.float64]) -> float:
        there = moved(total, np.tensordot(start, coarse_px, 1))
        return float(np.minimum(np.abs((goal - there) / size), 0.5).sum())

    place = min((np.array(start, float) for start in starts), key=cost)
    # what comes into the picture at its border cannot be known
    widest = min(_WIDEST_PX, max(1, int(np.ceil(np.abs(by(place)).max()))))
    unseen = [base * (distance < widest)[..., None] for distance in _distances(evidence).values()]
    best, chi2 = place, np.inf
    for _ in range(_STEPS):
        picture = moved(base, by(place))
        own = evidence.fit(unseen, picture - base).chi2
        if own >= chi2:
            break
        best, chi2 = place, own
        slopes = [
            (moved(base, by(place + step)) - moved(base, by(place - step))) / (2 * _SLOPE_PX)
            for step in _SLOPE_PX * np.eye(len(place))
        ]
        step = evidence.fit([*slopes, *unseen], picture - base).amplitudes[: len(place)]
        if np.abs(step).max() < _EXACT_PX / 10:
            break
        place = place + np.clip(step, -1, 1)
    return best, chi2


def _coarse(picture: NDArray[np.float64], every: int) -> NDArray[np.float64]:
    """(y, x) means of ``every`` x ``every`` pixels."""
    height, width = (size // every for size in picture.shape)
    return picture[: height * every, : width * every].reshape(height, every, width, every).mean(axis=(1, 3))


def _curvature(picture: NDArray) -> NDArray[np.float64]:
    kernel = np.array([1.0, -2.0, 1.0])
    return convolve1d(picture, kernel, 0, mode="nearest") + convolve1d(picture, kernel, 1, mode="nearest")


def _filter(evidence: Evidence) -> Explanation:
    once = _curvature(evidence.baseline)
    fit = evidence.fit([once, _curvature(once)])
    blur = 2 * float(fit.amplitudes[0])
    return Explanation("pixel-filter", {"added_variance_px2": blur}, fit.chi2, 2)


def _border(evidence: Evidence) -> Iterator[Explanation]:
    distances = _distances(evidence)
    for ring in (1, 2, 3):
        templates = [evidence.baseline * (distance < ring)[..., None] for distance in distances.values()]
        fit = evidence.fit(templates)
        factors = {f"{name}_factor": 1 + float(a) for name, a in zip(distances, fit.amplitudes, strict=True)}
        yield Explanation("border", {"width_px": ring, **factors}, fit.chi2, 5)


def _distances(evidence: Evidence) -> dict[str, NDArray[np.int64]]:
    """(y, x) px from each side of the picture."""
    height, width = evidence.baseline.shape[:2]
    rows, columns = np.indices((height, width))
    return {"left": columns, "right": width - 1 - columns, "top": rows, "bottom": height - 1 - rows}
