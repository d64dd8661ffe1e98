"""Shares of pixels covered by a few flat faces in a pinhole image: exact areas.

From one point a face's depth and sides are linear functions of a ray's slopes. With the ray e + t d, e the eye, the
plane n . p = c is met at 1 / t = n . d / (c - n . e). The ray passes inside a side a . p > b where (a + (a . e - b) n /
(c - n . e)) . d > 0. The face with the greatest 1 / t is visible.

So straight lines divide a pixel into cells that each show one face: the edges of faces, and the lines in which faces
intersect. The pixel is cut into horizontal strips at the heights at which lines meet each other or the pixel's sides.
Within a strip the lines do not cross, so they bound trapezoids, with an area of height times middle width. Which face a
trapezoid shows follows from the depths and sides in its middle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.progress import checkpoint
from numpy.typing import NDArray

from .flat_faces import FlatFaces

__all__ = ["polygon_coverage"]

#: Numbers of lines that separate classes of pixels; the pixels of a class are computed at once.
_LINE_CLASSES = (1, 2, 3, 4, 6, 9, 14)
#: Numbers of faces that may be visible in a pixel, separating classes in the same way.
_FACE_CLASSES = (2, 3, 4, 6, 9)

#: Largest number of cells times faces of one computation, which limits memory.
_MOST_CELLS = 2**17

#: Part of a pixel by which its borders are moved out in bounds, for the curvature of distorted lines.
_MARGIN = 0.01

#: Faces that reach through each other by less than this only touch, mm.
_TOUCHING_MM = 1e-4

#: Decimals of a share: a smaller covered area counts as none.
_DECIMALS = 6


def polygon_coverage(faces: FlatFaces, cameras: Sequence[Camera], pixels: NDArray[np.int64]) -> NDArray[np.float32]:
    """Share of pixels in which each face is the nearest.

    Within a pixel distortion is taken as linear. Pixels that show one face, by bounds of the functions over all
    cameras, need no areas.

    Parameters
    ----------
    faces
        The f faces; both sides count.
    cameras
        c cameras of one image size.
    pixels
        (n,) pixels, counted along the rows.

    Returns
    -------
    NDArray
        (c, n, f) float32 shares, 0 to 1.
    """
    checkpoint()
    lines = _lines_of(faces)
    functions = np.array([_functions(faces.planes, camera) for camera in cameras])
    zero = np.array([lines.zero(camera, rows[:, 0]) for camera, rows in zip(cameras, functions, strict=True)])
    lens_of = [(c.focal_length_px, *c.principal_point_px, c.k1, c.lens, c.further_distortion) for c in cameras]
    lenses = {lens: _corners(camera, pixels) for lens, camera in zip(lens_of, cameras, strict=True)}
    middle, half = _box(np.concatenate([*lenses.values()]))
    candidates, alone = _candidates(functions, middle, half)
    coverage = np.empty((len(cameras), len(pixels), len(faces.planes)), np.float32)
    coverage[:] = alone
    mixed = np.flatnonzero(candidates.any(axis=1) & ~alone.any(axis=1))
    candidates = candidates[mixed]
    checkpoint()
    low, high = _bounds(zero, middle[:, mixed], half[:, mixed])
    crossed = ((low < 0) & (high > 0)).T & (candidates.astype(np.float32) @ lines.faces.T > 0)
    lens_frames = {lens: _frames(corners[:, mixed]) for lens, corners in lenses.items()}
    frames = np.array([lens_frames[lens] for lens in lens_of])
    for members, most_lines, most_faces in _classes(crossed.sum(axis=1), candidates.sum(axis=1), len(cameras)):
        checkpoint()
        cut, of = _first(crossed[members], most_lines)
        cuts = np.where(of[..., None], zero[:, cut], [0.0, 0.0, 1.0])
        columns, of = _first(candidates[members], most_faces)
        near = np.where(of[..., None, None], functions[:, columns], [0.0, 0.0, -1.0])
        pixel_frames = frames[:, members]
        near = near.reshape(*near.shape[:2], -1, 3) @ pixel_frames
        count = len(cameras) * len(members)
        shares = _shares((cuts @ pixel_frames).reshape(count, most_lines, 3), near.reshape(count, most_faces, 5, 3))
        coverage[:, mixed[members, None], columns] = shares.reshape(len(cameras), *columns.shape)
    checkpoint()
    return coverage


def _classes(
    lines: NDArray[np.int64], faces: NDArray[np.int64], cameras: int
) -> Iterator[tuple[NDArray[np.int64], int, int]]:
    """Pixels to be computed together, with the largest numbers of lines and faces among them.

    `lines` and `faces` (n,) are the numbers of each pixel. Memory is limited for `cameras` that see each pixel.
    """
    kinds = np.stack([np.searchsorted(_LINE_CLASSES, lines), np.searchsorted(_FACE_CLASSES, faces)])
    for kind in np.unique(kinds, axis=1).T:
        members = np.flatnonzero((kinds == kind[:, None]).all(axis=0))
        most_lines, most_faces = int(lines[members].max()), int(faces[members].max())
        cells = (1 + 2 * most_lines + most_lines * (most_lines - 1) // 2) * (most_lines + 1)
        at_once = max(1, _MOST_CELLS // (cells * most_faces * cameras))
        for start in range(0, len(members), at_once):
            yield members[start : start + at_once], most_lines, most_faces


def _first(marked: NDArray[np.bool_], most: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(n, most) columns marked in each row, followed by others, and whether each is marked."""
    columns = np.argsort(~marked, axis=1, kind="stable")[:, :most]
    return columns, np.take_along_axis(marked, columns, axis=1)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines at which the visible face may change.

    These are e edges, p intersections of faces and f horizons of faces.
    """

    #: (e, 2, 3) ends of the edges, mm.
    ends: NDArray[np.float64]
    #: (p, 2) faces that intersect.
    pairs: NDArray[np.int64]
    #: (e + p + f, f) 1 for the faces to which each line belongs; the horizons are last.
    faces: NDArray[np.float32]

    def zero(self, camera: Camera, depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """(e + p + f, 3) coefficients of (x, y, 1) that are zero on each line.

        `depth` (f, 3) are the coefficients of 1 / t of the faces.
        """
        first, last = np.moveaxis(self.ends - camera.position_mm, 1, 0)
        crossings = depth[self.pairs[:, 0]] - depth[self.pairs[:, 1]]
        return np.concatenate([np.cross(first, last) @ camera.rotation.T, crossings, depth])


@lru_cache(maxsize=4)
def _lines_of(faces: FlatFaces) -> _Lines:
    """Lines of these faces, common edges once; kept for the last few scenes."""
    count = len(faces.outlines)
    ends: dict[tuple[bytes, ...], NDArray[np.float64]] = {}
    owners: dict[tuple[bytes, ...], list[int]] = {}
    for index, outline in enumerate(faces.outlines):
        for edge in np.stack([outline, np.roll(outline, -1, axis=0)], axis=1):
            key = tuple(sorted(end.tobytes() for end in edge))
            ends[key] = edge
            owners.setdefault(key, []).append(index)
    through = np.array(
        [
            [np.ptp(np.sign(_beyond(outline @ plane[:3] - plane[3]))) == 2 for outline in faces.outlines]
            for plane in faces.planes[:, 0]
        ]
    )
    pairs = np.array([(i, j) for i, j in combinations(range(count), 2) if through[i, j] and through[j, i]], int)
    belongs = [np.isin(np.arange(count), members) for members in (*owners.values(), *pairs)]
    return _Lines(np.array([*ends.values()]), pairs.reshape(-1, 2), np.array([*belongs, *np.eye(count)], np.float32))


def _beyond(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights above a plane, with those of touching points set to zero."""
    return np.where(np.abs(heights) > _TOUCHING_MM, heights, 0.0)


def _corners(camera: Camera, pixels: NDArray[np.int64]) -> NDArray[np.float64]:
    """(4, n, 2) slopes of the pixels' corners: upper left, upper right, lower left, lower right."""
    rows, columns = np.divmod(pixels, camera.width_px)
    down, right = np.array([[-0.5, -0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, 0.5]])[..., None]
    return camera.slopes(columns + right, rows + down)


def _box(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, n) centres of the pixels and half their sizes, in homogeneous coordinates."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = np.vstack([(low + high).T / 2, np.ones(len(low))])
    return middle, np.vstack([(high - low).T * (0.5 + _MARGIN), np.zeros(len(low))])


def _frames(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3, 3) matrices from (u, v, 1), 0 to 1 within each pixel, to the slopes (x, y, 1)."""
    frames = np.zeros((corners.shape[1], 3, 3))
    frames[:, 2, 2] = 1.0
    frames[:, :2, 0] = (corners[1] - corners[0] + corners[3] - corners[2]) / 2
    frames[:, :2, 1] = (corners[2] - corners[0] + corners[3] - corners[1]) / 2
    frames[:, :2, 2] = corners.mean(axis=0) - (frames[:, :2, 0] + frames[:, :2, 1]) / 2
    return frames


def _functions(planes: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(f, 5, 3) coefficients of (x, y, 1): 1 / t, and the four sides, positive inside."""
    eye = camera.position_mm
    heights = planes[..., :3] @ eye - planes[..., 3]
    away = np.where(np.abs(heights[:, :1]) > 0, -heights[:, :1], np.inf)  # in its own plane no face is seen
    depth = planes[:, 0, :3] / away
    sides = planes[:, 1:, :3] + heights[:, 1:, None] * depth[:, None]
    return np.concatenate([depth[:, None], sides], axis=1) @ camera.rotation.T


def _bounds(
    functions: NDArray[np.float64], middle: NDArray[np.float64], half: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(f, n) least and greatest values of linear functions in boxes, over all cameras.

    `functions` (c, f, 3) are coefficients of (x, y, 1), and the boxes have centres and half sizes as of `_box`.
    """
    low, high = functions.min(axis=0), functions.max(axis=0)
    mean, apart = (low + high) / 2, (high - low) / 2
    value = mean @ middle
    spread = np.abs(mean) @ half + apart @ (np.abs(middle) + half)
    return value - spread, value + spread


def _candidates(
    functions: NDArray[np.float64], middle: NDArray[np.float64], half: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n, f) faces that some camera may see in each pixel, and those that fill it.

    A face fills a pixel if every camera sees it alone there. A face is no candidate if another one covers the whole
    pixel in front of it for every camera.
    """
    by_kind = functions.swapaxes(1, 2).reshape(len(functions), -1, 3)
    shape = 5, functions.shape[1], middle.shape[1]
    low, high = (each.reshape(shape) for each in _bounds(by_kind, middle, half))
    touching, covering = (high > 0).all(axis=0), (low > 0).all(axis=0)
    wall = np.where(covering, low[0], -np.inf).max(axis=0)
    candidates = touching & (high[0] >= wall)
    return candidates.T, (covering & candidates & (candidates.sum(axis=0) == 1)).T


def _shares(lines: NDArray[np.float64], faces: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, k) parts of unit squares that show each face.

    `lines` (n, l, 3) are coefficients of (u, v, 1), zero where the visible face may change. `faces` (n, k, 5, 3) are
    those of 1 / t and of the sides.
    """
    area, u, v = _trapezoids(lines)
    if lines.shape[1] == 1:  # each side of the line sees one face: that of its largest trapezoid
        largest = area.argmax(axis=1)[:, None]
        u, v = (np.take_along_axis(np.broadcast_to(x, area.shape), largest, axis=1) for x in (u, v))
        area = area.sum(axis=1, keepdims=True)
    count, k = faces.shape[:2]
    area, u, v = (np.broadcast_to(x, area.shape).reshape(count, -1) for x in (area, u, v))
    values = faces.reshape(count, 5 * k, 3) @ np.stack([u, v, np.ones_like(u)], axis=1)
    depth, sides = np.split(values.reshape(count, k, 5, -1), [1], axis=2)
    depth = np.where((sides > 0).all(axis=2), depth[:, :, 0], 0.0)
    visible = (depth > 0) & (depth.argmax(axis=1)[:, None] == np.arange(k)[:, None])
    return np.round(np.sum(area[:, None] * visible, axis=2), _DECIMALS)


def _trapezoids(lines: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """Areas (n, strip, cell) of the cells of unit squares, and u and v at their centres.

    `lines` (n, l, 3) are coefficients of (u, v, 1), zero on the line.
    """
    a, b, c = np.moveaxis(lines, -1, 0)
    i, j = np.triu_indices(lines.shape[1], 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        meeting = (a[:, j] * c[:, i] - a[:, i] * c[:, j]) / (a[:, i] * b[:, j] - a[:, j] * b[:, i])
        heights = _within(np.concatenate([-c / b, -(a + c) / b, meeting], axis=1))
        top, bottom = heights[:, :-1], heights[:, 1:]
        v = ((top + bottom) / 2)[..., None]
        crossings = _within(-(b[:, None] * v + c[:, None]) / a[:, None])
    u = (crossings[..., :-1] + crossings[..., 1:]) / 2
    return np.diff(crossings, axis=-1) * (bottom - top)[..., None], u, v


def _within(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """0, the values between 0 and 1 in rising order, and 1, along the last axis.

    Values outside become 0 or 1, which gives cells without area.
    """
    inside = np.clip(np.nan_to_num(values, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    ends = np.broadcast_to([0.0, 1.0], (*inside.shape[:-1], 2))
    return np.sort(np.concatenate([ends[..., :1], inside, ends[..., 1:]], axis=-1), axis=-1)
