"""A scene's surfaces divided into patches for the radiosity solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..visibility import Tracer, normal_and_material

__all__ = ["Patches", "build_patches", "patch_of", "patch_points"]

#: Triangles with all edges shorter than this part of a patch's largest edge form patches in groups.
_SMALL = 0.5


@dataclass(frozen=True, eq=False)
class Patches:
    """Large triangles divided into p equal patches, and groups of small triangles of one face.

    The patches consist of n pieces: one for a patch of a large triangle, several for a group. A lamp that does not
    reflect has no patches.
    """

    #: (p,) area, mm^2.
    area: NDArray[np.float64]
    #: (p, 3) centroid, mm.
    centre: NDArray[np.float64]
    #: (p, 3) mean unit normal.
    normal: NDArray[np.float64]
    #: (p,) index of the flat face.
    facet: NDArray[np.int64]
    #: (p,) index of the material.
    material: NDArray[np.int64]
    #: (p,) index of the surface.
    surface: NDArray[np.int64]
    #: (n,) patch of each piece, ascending.
    patch: NDArray[np.int64]
    #: (n,) triangle of the scene that contains each piece.
    triangle: NDArray[np.int64]
    #: (n, 2) barycentric coordinates of the piece's centroid in this triangle.
    uv: NDArray[np.float64]
    #: (n, 3, 3) corners of the pieces, mm.
    corners: NDArray[np.float64]
    #: (t,) divisions of each edge of the scene's triangles, on the device.
    packed_divisions: mi.Float
    #: (t,) first patch of each of the scene's triangles, on the device.
    packed_first: mi.UInt32

    def __len__(self) -> int:
        return len(self.area)


def build_patches(tracer: Tracer, edge_mm: float, finer: int = 1) -> Patches:
    """Divide a scene's reflecting triangles into patches.

    Edges of large triangles are divided equally, so that parts are at most `edge_mm` long; each resulting patch is
    divided once more into finer^2. Small triangles of one flat face are grouped by cubes of `edge_mm`; groups are not
    divided further.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    edge_mm
        Largest edge of a patch, mm.
    finer
        Further divisions of each edge of a patch.

    Returns
    -------
    Patches
        The patches.
    """
    sides = np.linalg.norm(tracer.vertices - np.roll(tracer.vertices, 1, axis=1), axis=2).max(axis=1)
    reflecting = tracer.material < tracer.reflectors
    group = _groups(tracer, reflecting & (sides < _SMALL * edge_mm), edge_mm)
    divisions = np.maximum(1, np.ceil(sides / edge_mm)).astype(int) * finer
    divisions[~reflecting | (group >= 0)] = 1
    alone = np.flatnonzero(reflecting & (group < 0))
    counts = divisions[alone] ** 2
    total, first = int(counts.sum()), np.zeros(len(sides), int)
    first[alone] = np.cumsum(counts) - counts
    owner = np.repeat(alone, counts)
    weights = _weights(divisions[owner], np.arange(total) - first[owner])
    base, along = tracer.vertices[owner, :1], tracer.vertices[owner, 1:] - tracer.vertices[owner, :1]
    parts = [(np.arange(total), owner, weights.mean(axis=1), base + weights @ along)]
    grouped = np.argsort(np.where(group < 0, len(group), group), kind="stable")[: np.count_nonzero(group >= 0)]
    first[grouped] = total + group[grouped]
    if len(grouped):
        thirds = np.full((len(grouped), 2), 1 / 3)
        parts.append((first[grouped], grouped, thirds, tracer.vertices[grouped]))
    patch, triangle, uv, corners = (np.concatenate(each) for each in zip(*parts, strict=True))
    pieces = _areas(corners)
    area: NDArray[np.float64] = np.bincount(patch, pieces).astype(float)
    normal = _sums(pieces[:, None] * tracer.normals[triangle], patch)
    first_triangle = triangle[np.searchsorted(patch, np.arange(len(area)))]
    return Patches(
        area=area,
        centre=_sums(pieces[:, None] * corners.mean(axis=1), patch) / area[:, None],
        normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        facet=tracer.facet[first_triangle],
        material=tracer.material[first_triangle],
        surface=tracer.surface[first_triangle],
        patch=patch,
        triangle=triangle,
        uv=uv,
        corners=corners,
        packed_divisions=device_array(mi.Float, divisions),
        packed_first=device_array(mi.UInt32, first),
    )


def _groups(tracer: Tracer, small: NDArray[np.bool_], edge_mm: float) -> NDArray[np.int64]:
    """(t,) group of each triangle, -1 for none.

    A group has the small triangles of one face within a cube of `edge_mm`.
    """
    group = np.full(len(small), -1)
    if not small.any():
        return group
    cell = np.floor(tracer.vertices[small].mean(axis=1) / edge_mm).astype(int)
    keys = np.column_stack([tracer.facet[small], cell])
    _, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    several = count > 1
    number = np.where(several, np.cumsum(several) - 1, -1)
    group[small] = number[which.ravel()]
    return group


def _weights(divisions: NDArray[np.int64], local: NDArray[np.int64]) -> NDArray[np.float64]:
    """(k, 3, 2) barycentric coordinates of the corners of patches.

    `local` (k,) are the indices of the patches in their triangles, and `divisions` (k,) those of the triangles' edges.
    """
    numbers, which = np.unique(divisions, return_inverse=True)
    tables = [_division(int(n)) for n in numbers]
    start = np.cumsum([0, *map(len, tables)])
    return np.concatenate([*tables, np.empty((0, 3, 2))])[start[which] + local]


def _division(n: int) -> NDArray[np.float64]:
    """(n^2, 3, 2) barycentric coordinates of the corners of all patches of one triangle.

    In the order of `patch_of`: row by row, each row with one cell (two patches) fewer.
    """
    i, j, upper = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), [0, 1], indexing="ij"))
    inside = i + j + upper < n
    i, j, upper = i[inside], j[inside], upper[inside]
    order = np.argsort(_local_index(i, j, upper, n))
    i, j, upper = i[order], j[order], upper[order]
    grid = np.stack([np.stack([i + upper, j + upper], -1), np.stack([i + 1, j], -1), np.stack([i, j + 1], -1)], 1)
    return grid / n


def _areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) areas of triangles (n, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(cross, axis=1)


def _sums(values: NDArray[np.float64], patch: NDArray[np.int64]) -> NDArray[np.float64]:
    """(p, 3) sums over the pieces (n, 3) of each patch."""
    return np.stack([np.bincount(patch, column) for column in values.T], axis=1)


def _local_index(i: Any, j: Any, upper: Any, n: Any) -> Any:
    """Index of sub-triangle (i, j, upper) in its parent: row i has 2 (n - i) - 1 patches."""
    return i * (2 * n - i) + 2 * j + upper


def patch_of(patches: Patches, triangle: mi.UInt32, uv: mi.Point2f, active: mi.Bool) -> mi.UInt32:
    """Patch at hits.

    Parameters
    ----------
    patches
        The patches.
    triangle
        Index of the triangle that is hit.
    uv
        Barycentric coordinates there.
    active
        Lanes that are evaluated.

    Returns
    -------
    UInt32
        Index of the patch.
    """
    n = dr.gather(mi.Float, patches.packed_divisions, triangle, active)
    first = dr.gather(mi.UInt32, patches.packed_first, triangle, active)
    x, y = uv.x * n, uv.y * n
    i = dr.clip(dr.floor(x), 0, n - 1)
    j = dr.clip(dr.floor(y), 0, n - 1 - i)
    upper = dr.select((x - i + y - j > 1) & (i + j < n - 1), mi.Float(1), mi.Float(0))
    return first + mi.UInt32(_local_index(i, j, upper, n))


def patch_points(
    tracer: Tracer, patches: Patches
) -> Callable[[mi.UInt32, mi.Float, mi.Float], tuple[mi.Point3f, mi.Vector3f]]:
    """Function that samples points of patches.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    patches
        The patches.

    Returns
    -------
    Callable
        Function of patches and two numbers in [0, 1). It returns points uniform over the patches, mm, and the unit
        normals there.
    """
    start = np.searchsorted(patches.patch, np.arange(len(patches) + 1))
    share = _areas(patches.corners) / patches.area[patches.patch]
    total = np.cumsum(share)
    low = total - share - (total - share)[start[:-1]][patches.patch]
    corners = device_array(mi.Float, patches.corners)
    triangle = device_array(mi.UInt32, patches.triangle)
    starts = device_array(mi.UInt32, start)
    lows, shares = device_array(mi.Float, low), device_array(mi.Float, share)
    steps = int(np.diff(start).max() - 1).bit_length()

    def points(patch: mi.UInt32, u: mi.Float, v: mi.Float) -> tuple[mi.Point3f, mi.Vector3f]:
        piece, end = dr.gather(mi.UInt32, starts, patch), dr.gather(mi.UInt32, starts, patch + 1)
        for _ in range(steps):  # the last piece that begins at or below u
            middle = (piece + end) // 2
            above = dr.gather(mi.Float, lows, middle) > u
            piece, end = dr.select(above, piece, middle), dr.select(above, middle, end)
        if steps:
            u = dr.clip((u - dr.gather(mi.Float, lows, piece)) / dr.gather(mi.Float, shares, piece), 0, 1)
        a, b, c = (dr.gather(mi.Point3f, corners, piece * 3 + k) for k in range(3))
        root = dr.sqrt(u)
        normal, _ = normal_and_material(tracer, dr.gather(mi.UInt32, triangle, piece))
        return a + (b - a) * (root * (1 - v)) + (c - a) * (root * v), normal

    return points
