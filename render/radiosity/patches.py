"""The scene's surfaces divided into patches for the radiosity solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..visibility import Tracer, normal_and_material

__all__ = ["Patches", "build_patches", "patch_of", "patch_points"]

#: Triangles whose edges are all shorter than this part of a patch's largest edge form patches in groups.
_SMALL = 0.5


@dataclass(frozen=True, eq=False)
class Patches:
    """Large triangles divided into equal patches, and groups of small neighbouring triangles of one flat face.

    A lamp that does not reflect has none. Of p patches: area : (p,) mm^2. centre : (p, 3) mm. normal : (p, 3) mean.
    facet, material, surface : (p,) indices. Of n pieces, one for a patch of a large triangle, several for a group:
    patch : (n,), ascending. triangle : (n,) index of the parent. uv : (n, 2) barycentric coordinates of the centroid
    there. corners : (n, 3, 3) mm.
    """

    area: NDArray[np.float64]
    centre: NDArray[np.float64]
    normal: NDArray[np.float64]
    facet: NDArray[np.int64]
    material: NDArray[np.int64]
    surface: NDArray[np.int64]
    patch: NDArray[np.int64]
    triangle: NDArray[np.int64]
    uv: NDArray[np.float64]
    corners: NDArray[np.float64]
    packed_divisions: mi.Float
    packed_first: mi.UInt32

    def __len__(self) -> int:
        return len(self.area)


def build_patches(tracer: Tracer, edge_mm: float, finer: int = 1) -> Patches:
    """Divide large triangles into patches with edges up to ``edge_mm``, and each of these patches into finer^2.

    Groups of small triangles are about as large as a patch, and not divided further.
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
    one = triangle[np.searchsorted(patch, np.arange(len(area)))]
    return Patches(
        area=area,
        centre=_sums(pieces[:, None] * corners.mean(axis=1), patch) / area[:, None],
        normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        facet=tracer.facet[one],
        material=tracer.material[one],
        surface=tracer.surface[one],
        patch=patch,
        triangle=triangle,
        uv=uv,
        corners=corners,
        packed_divisions=device_array(mi.Float, divisions),
        packed_first=device_array(mi.UInt32, first),
    )


def _groups(tracer: Tracer, small: NDArray[np.bool_], edge_mm: float) -> NDArray[np.int64]:
    """(t,) the group of each triangle, -1 for none: small ones of one face within a cube of ``edge_mm``."""
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
    """(k, 3, 2) barycentric coordinates of the corners of patches ``local`` (k,) of triangles divided so many times."""
    different, which = np.unique(divisions, return_inverse=True)
    tables = [_division(int(n)) for n in different]
    start = np.cumsum([0, *map(len, tables)])
    return np.concatenate([*tables, np.empty((0, 3, 2))])[start[which] + local]


def _division(n: int) -> NDArray[np.float64]:
    """(n^2, 3, 2) those of all patches of one triangle.

    In the order of ``patch_of``: row by row, each row with one cell (two patches) fewer.
    """
    i, j, upper = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), [0, 1], indexing="ij"))
    keep = i + j + upper < n
    i, j, upper = i[keep], j[keep], upper[keep]
    order = np.argsort(_local_index(i, j, upper, n))
    i, j, upper = i[order], j[order], upper[order]
    grid = np.stack([np.stack([i + upper, j + upper], -1), np.stack([i + 1, j], -1), np.stack([i, j + 1], -1)], 1)
    return grid / n


def _areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(cross, axis=1)


def _sums(values: NDArray[np.float64], patch: NDArray[np.int64]) -> NDArray[np.float64]:
    """(p, 3) sums over the pieces (n, 3) of each patch."""
    return np.stack([np.bincount(patch, column) for column in values.T], axis=1)


def _local_index(i: Any, j: Any, upper: Any, n: Any) -> Any:
    """Index of sub-triangle (i, j, upper) in its parent: row i has 2 (n - i) - 1 patches."""
    return i * (2 * n - i) + 2 * j + upper


def patch_of(patches: Patches, triangle: mi.UInt32, uv: mi.Point2f, active: mi.Bool) -> mi.UInt32:
    """The patch at a hit, from the triangle's index and barycentric coordinates."""
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
    """A function of patches and two numbers in [0, 1): a point uniform over each patch, and the normal there."""
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
