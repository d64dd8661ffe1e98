"""Explanations by the view: mirrored, moved, magnified, turned, distorted, filter, border.

A rectangle of another factor describes an unknown cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations, product

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from .evidence import Evidence, Fit
from .explanations import FittedChange, exact
from .outcome import UNKNOWN

__all__ = ["from_view", "rectangle"]

#: Largest shift from which a fit starts, px.
_MAX_SHIFT_PX = 4
#: Starts of magnification less 1, of angle in radians, and of distortion at half a width as a part of it.
_STARTS = np.linspace(-0.1, 0.1, 41)
#: Fewest pixels a side of the coarse pictures by which starts are compared.
_COARSE_PX = 96
#: Largest relative difference of a pixel that counts in the comparison of starts.
_MAX_START_ERROR = 0.5
#: Steps of Gauss and Newton: shifts of some pixels settle in four.
_STEPS = 6
#: Difference of two neighbours of a pixel over their sum, from which it may hold an edge.
_EDGE_CONTRAST = 0.05
#: Step of finite differences, px.
_SLOPE_PX = 0.1
#: Accuracy with which a picture is moved, px: a smaller magnification or turn is none.
_ACCURACY_PX = 0.05
#: Part of what a displacement and free borders explain that borders alone may explain: nothing has moved otherwise.
_MOST_BY_BORDERS = 0.5
#: Parts of each side of the picture at which borders of a rectangle are first looked for.
_PARTS = 16
#: Weight of a pixel at an edge of the scene in that look, over that of others: it is as uncertain as that.
_AT_EDGES = 0.25
#: Scatters about the median at which a pixel's relative difference is cut in that look.
_CUT = 5.0
#: Widest border of the change `border`, px: pixel filters reach so far.
_WIDEST_RING_PX = 3
#: Widest border that a change of the view may bring into the picture, px.
_MAX_BORDER_PX = 16


def from_view(evidence: Evidence) -> Iterator[FittedChange]:
    """Fitted explanations by the view.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.

    Yields
    ------
    FittedChange
        One for each kind of change and each mirror axis and width of border.
    """
    yield from _mirrored(evidence)
    yield from _rolled(evidence)
    yield from _displaced(evidence.grouped())
    yield _filter(evidence)
    yield from _border(evidence)


def _mirrored(evidence: Evidence) -> Iterator[FittedChange]:
    """The picture mirrored along either axis or both."""
    base = evidence.baseline
    for axis, picture in {
        "horizontal": base[:, ::-1],
        "vertical": base[::-1],
        "both": base[::-1, ::-1],
    }.items():
        yield FittedChange("mirrored", {"axis": axis}, exact(evidence, picture), 1)


def _rolled(evidence: Evidence) -> Iterator[FittedChange]:
    """The picture rolled: what leaves at one side enters at the other.

    The clearest peak of the pictures' correlation gives the number of pixels.
    """
    before, after = (
        np.log1p(p.sum(axis=-1) / max(float(p.sum(axis=-1).mean()), 1e-300)) for p in _without_negative(evidence)
    )
    spectrum = np.fft.rfft2(after - after.mean()) * np.conj(np.fft.rfft2(before - before.mean()))
    correlation = np.fft.irfft2(spectrum, before.shape)
    rows, columns = (int(i) for i in np.unravel_index(int(correlation.argmax()), before.shape))
    if rows == 0 and columns == 0:
        return
    picture = np.roll(evidence.baseline, (rows, columns), axis=(0, 1))
    dy, dx = ((n + size // 2) % size - size // 2 for n, size in zip((rows, columns), before.shape, strict=True))
    values = {"dx_px": float(dx), "dy_px": float(dy), "rolled": True}
    yield FittedChange("shift", values, exact(evidence, picture), 2)


def _without_negative(evidence: Evidence) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both pictures without values below 0."""
    return np.maximum(evidence.baseline, 0.0), np.maximum(evidence.candidate, 0.0)


def moved(picture: NDArray[np.float64], by_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Picture moved by a field of displacements, with sharp edges.

    A pixel whose value lies between those of two different neighbours holds an edge, at the position that its value
    gives (volume of fluid, Hirt and Nichols 1981). All other pixels are uniform.

    Parameters
    ----------
    picture
        (y, x, w) picture.
    by_px
        (2, y, x) displacement of each pixel along x and y, px.

    Returns
    -------
    NDArray
        (y, x, w) moved picture; border pixels are repeated.
    """
    along_x = _moved_along_x(picture, by_px[0])
    return np.swapaxes(_moved_along_x(np.swapaxes(along_x, 0, 1), by_px[1].T), 0, 1)


def _moved_along_x(picture: NDArray[np.float64], by_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x, w) picture moved along its rows."""
    pixels = np.floor(by_px).astype(int)
    part = (by_px - pixels)[..., None]
    rows, columns = np.indices(by_px.shape)

    def at(step: int) -> NDArray[np.float64]:
        return picture[rows, np.clip(columns - pixels + step, 0, by_px.shape[1] - 1)]

    second_before, before, pixel, after = (at(step) for step in (-2, -1, 0, 1))
    edge = _edge_position(second_before, before, pixel)
    share = np.clip(edge - (1 - part), 0, part) / np.maximum(part, 1e-9)
    entering = np.where(np.isnan(edge), before, share * second_before + (1 - share) * pixel)
    edge = _edge_position(before, pixel, after)
    share = np.clip(edge, 0, 1 - part) / (1 - part)
    staying = np.where(np.isnan(edge), pixel, share * before + (1 - share) * after)
    return part * entering + (1 - part) * staying


def _edge_position(before: NDArray, pixel: NDArray, after: NDArray) -> NDArray[np.float64]:
    """Part of a pixel before its edge, which is like the pixel before; NaN without an edge."""
    step = before - after
    with np.errstate(divide="ignore", invalid="ignore"):
        position = (pixel - after) / step
    edge = (np.abs(step) > _EDGE_CONTRAST * (before + after)) & (position >= 0) & (position <= 1)
    return np.where(edge, position, np.nan)


def _displaced(evidence: Evidence) -> Iterator[FittedChange]:
    """Shift, magnification with turn, and distortion, as fields of displacement.

    Sizes are px at half a width from the picture's centre; clockwise turns are positive.
    """
    height, width = evidence.baseline.shape[:2]
    half = max(width - 1, 1) / 2
    y, x = np.meshgrid(np.arange(height) - (height - 1) / 2, np.arange(width) - half, indexing="ij")
    unit, zero, r2 = np.ones_like(x), np.zeros_like(x), (x**2 + y**2) / half**2
    shift = [np.array([unit, zero]), np.array([zero, unit])]
    zoom, turn, cubic = np.array([x, y]) / half, np.array([-y, x]) / half, r2 * np.array([x, y]) / half
    reach = range(-_MAX_SHIFT_PX, _MAX_SHIFT_PX + 1)
    (dx, dy), fit = _fitted(evidence, shift, [(dx, dy) for dx in reach for dy in reach])
    yield FittedChange("shift", {"dx_px": float(dx), "dy_px": float(dy)}, fit, 6)
    by_px = half * _STARTS
    starts = [(0, 0, 0, 0), *((0, 0, s, 0) for s in by_px), *((0, 0, 0, t) for t in by_px)]
    (dx, dy, s, t), fit = _fitted(evidence, [*shift, zoom, turn], starts)
    back = complex(1 - s / half, t / half)  # from the candidate to the baseline, about the centre
    parameters = {
        "magnification": 1 / abs(back),
        "turned_deg": float(np.degrees(np.angle(back))),
        "dx_px": float(dx),
        "dy_px": float(dy),
    }
    if max(abs(s), abs(t)) > _ACCURACY_PX:
        yield FittedChange("view", parameters, fit, 8)
    (dx, dy, cubic_px), fit = _fitted(evidence, [*shift, cubic], [(0, 0, c) for c in by_px])
    # twice as much or more in the corners; next to a larger shift it is the parallax of a moved camera
    if abs(cubic_px) > max(_ACCURACY_PX, float(np.hypot(dx, dy))) / 2:
        yield FittedChange("distortion", {"outwards_px_at_half_width": float(cubic_px)}, fit, 7)


def _fitted(
    evidence: Evidence, fields: Sequence[NDArray[np.float64]], starts: Sequence[Sequence[float]]
) -> tuple[NDArray[np.float64], Fit]:
    """Amplitudes of fields of displacement (2, y, x) px, and the fit that they leave.

    The fit goes from the best start along the slopes of the moved picture (Gauss and Newton). Its chi-square is
    infinite where free borders explain as much without a displacement.
    """
    base, fields_px = evidence.baseline, np.array(fields)
    every = max(1, min(base.shape[:2]) // _COARSE_PX)  # starts are compared on coarse pixels
    total, goal = (_coarse(p.sum(axis=-1), every)[..., None] for p in (base, evidence.candidate))
    coarse_px = np.array([[_coarse(part, every) / every for part in field] for field in fields])
    size = np.maximum(total, 1e-3 * total.mean())

    def by(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.tensordot(sizes, fields_px, 1)

    def cost(start: NDArray[np.float64]) -> float:
        start_picture = moved(total, np.tensordot(start, coarse_px, 1))
        return float(np.minimum(np.abs((goal - start_picture) / size), _MAX_START_ERROR).sum())

    sizes = min((np.array(start, float) for start in starts), key=cost)
    # light that enters the picture at its border is unknown
    width = min(_MAX_BORDER_PX, max(1, int(np.ceil(np.abs(by(sizes)).max()))))
    borders = [base * (distance < width)[..., None] for distance in _distances(evidence).values()]
    best, fit = sizes, Fit(np.zeros(0), np.inf)
    for _ in range(_STEPS):
        picture = moved(base, by(sizes))
        step_fit = evidence.fit(borders, picture - base)
        if step_fit.chi2 >= fit.chi2:
            break
        best, fit = sizes, step_fit
        slopes = [
            (moved(base, by(sizes + step)) - moved(base, by(sizes - step))) / (2 * _SLOPE_PX)
            for step in _SLOPE_PX * np.eye(len(sizes))
        ]
        step = evidence.fit([*slopes, *borders], picture - base).amplitudes[: len(sizes)]
        if np.abs(step).max() < _ACCURACY_PX / 10:
            break
        sizes = sizes + np.clip(step, -1, 1)
    unchanged, bordered = evidence.fit([]).chi2, evidence.fit(borders).chi2
    if unchanged - bordered > _MOST_BY_BORDERS * (unchanged - fit.chi2):
        fit = Fit(fit.amplitudes, np.inf)
    return best, fit


def _coarse(picture: NDArray[np.float64], every: int) -> NDArray[np.float64]:
    """(y, x) means of ``every`` x ``every`` pixels."""
    height, width = (size // every for size in picture.shape)
    return picture[: height * every, : width * every].reshape(height, every, width, every).mean(axis=(1, 3))


def _curvature(picture: NDArray) -> NDArray[np.float64]:
    """Sum of second differences along rows and columns."""
    kernel = np.array([1.0, -2.0, 1.0])
    return convolve1d(picture, kernel, 0, mode="nearest") + convolve1d(picture, kernel, 1, mode="nearest")


def _filter(evidence: Evidence) -> FittedChange:
    """Another pixel filter, by its first two even moments."""
    once = _curvature(evidence.baseline)
    fit = evidence.fit([once, _curvature(once)])
    blur = 2 * float(fit.amplitudes[0])
    return FittedChange("pixel-filter", {"added_variance_px2": blur}, fit, 2)


def _border(evidence: Evidence) -> Iterator[FittedChange]:
    """Factors at the four sides of the picture, one to three pixels wide.

    Where sides meet, either their changes add up or the corner has their mean: that of a border all around.
    """
    distances = _distances(evidence)
    for ring, shared in product(range(1, _WIDEST_RING_PX + 1), (False, True)):
        inside = {name: distance < ring for name, distance in distances.items()}
        sides = np.maximum(np.sum(list(inside.values()), axis=0), 1) if shared else np.ones(evidence.cell.shape)
        shapes = [(mask / sides)[..., None] for mask in inside.values()]
        fit = evidence.fit([evidence.baseline * shape for shape in shapes])
        factors = {f"{name}_factor": 1 + float(a) for name, a in zip(inside, fit.amplitudes, strict=True)}
        factor = 1 + np.tensordot(fit.amplitudes, shapes, 1)
        yield FittedChange("border", {"width_px": ring, **factors}, fit, 5, applied=partial(np.multiply, factor))


def rectangle(evidence: Evidence) -> FittedChange | None:
    """Description of an unknown cause: another factor in a rectangle of sharp borders.

    It may reach to the picture's sides, as a half or a quadrant does, and all light may have a factor, too.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.

    Returns
    -------
    FittedChange or None
        The description with the least chi-square and cost of its parameters; None without light, or for a border.
    """
    base = evidence.baseline
    level, total = base.sum(axis=-1), (evidence.candidate - base).sum(axis=-1)
    weight = np.where(level > 0, (evidence.cell >= 0) + _AT_EDGES * evidence.pixels, 0.0)
    used = weight > 0
    if not used.any():
        return None
    relative = np.divide(total, level, out=np.zeros_like(total), where=used)
    off = relative[used] - np.median(relative[used])
    limit = _CUT * robust_sigma(off)
    relative[used] = np.clip(off, -limit, limit)
    changes = []
    for top, bottom, left, right in _rectangles(weight, relative):
        inside = np.zeros((*level.shape, 1))
        inside[top:bottom, left:right] = 1.0
        (height, width), size = level.shape, (bottom - top, right - left)
        if min(size) <= _WIDEST_RING_PX:  # `border` has a name
            continue
        borders = (top > 0) + (bottom < height) + (left > 0) + (right < width)
        parts = [f"columns {left} to {right - 1}"] * (size[1] < width)
        parts += [f"rows {top} to {bottom - 1}"] * (size[0] < height)
        for templates in ([base * inside], [base * inside, base]):
            fit = evidence.fit(templates)
            factor, outside = 1 + float(fit.amplitudes.sum()), 1 + float(fit.amplitudes[1:].sum())
            text = f"a step along straight borders, a factor {factor:.3g} in {' and '.join(parts)}"
            text += f", {outside:.3g} elsewhere" if len(templates) > 1 else ""
            changes.append(FittedChange(UNKNOWN, {"description": text}, fit, borders + len(templates)))
    return min(changes, key=lambda change: change.chi2 + np.log(evidence.numbers) * change.free, default=None)


def _rectangles(weight: NDArray[np.float64], values: NDArray[np.float64]) -> Iterator[tuple[int, int, int, int]]:
    """Rectangles of one to four inner borders, whose means differ most from the rest.

    weight : (y, x) weight of each pixel. values : (y, x) their values. A rectangle is its first row, one after the
    last one, first column, and one after the last one.
    """
    height, width = weight.shape
    sums = np.zeros((2, height + 1, width + 1))
    sums[:, 1:, 1:] = np.stack([weight, weight * values]).cumsum(axis=1).cumsum(axis=2)
    rows, columns = (np.unique(np.linspace(0, n, _PARTS + 1).astype(int)) for n in (height, width))
    (tops, bottoms), (lefts, rights) = (np.array([*combinations(axis, 2)]).T for axis in (rows, columns))
    gain = _gain(sums, tops[:, None], bottoms[:, None], lefts, rights)
    borders = ((tops > 0).astype(int) + (bottoms < height))[:, None] + (lefts > 0) + (rights < width)
    for count in (1, 2, 3, 4):
        first, second = np.unravel_index(int(np.where(borders == count, gain, -1.0).argmax()), gain.shape)
        sides = [int(n) for n in (tops[first], bottoms[first], lefts[second], rights[second])]
        for side in [n for n, outermost in enumerate((0, height, 0, width)) if sides[n] != outermost] * 2:
            low, high = ((0, sides[1]), (sides[0], height), (0, sides[3]), (sides[2], width))[side]
            trials = np.tile(sides, (high - low - 1, 1))
            trials[:, side] = range(low + 1, high)
            sides[side] = low + 1 + int(_gain(sums, *trials.T).argmax())
        yield sides[0], sides[1], sides[2], sides[3]


def _gain(sums: NDArray[np.float64], top: NDArray, bottom: NDArray, left: NDArray, right: NDArray) -> NDArray:
    """Sum of squares that the means of rectangles and of the rest explain.

    sums : (2, y, x) weight of the pixels, and weighted sum of their values, above and to the left of each corner.
    """
    inside = sums[:, bottom, right] - sums[:, top, right] - sums[:, bottom, left] + sums[:, top, left]
    outside = sums[:, -1, -1].reshape(2, *[1] * (inside.ndim - 1)) - inside
    return np.asarray(sum(part[1] ** 2 / np.maximum(part[0], 1.0) for part in (inside, outside)))


def _distances(evidence: Evidence) -> dict[str, NDArray[np.int64]]:
    """(y, x) distance from each side of the picture, px."""
    height, width = evidence.baseline.shape[:2]
    rows, columns = np.indices((height, width))
    return {"left": columns, "right": width - 1 - columns, "top": rows, "bottom": height - 1 - rows}
