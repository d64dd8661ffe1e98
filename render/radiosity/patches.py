"""The scene's surfaces divided into small triangles (patches) for the radiosity solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..device import dr, mi
from ..visibility import Tracer

__all__ = ["Patches", "build_patches", "patch_of", "patch_points"]


@dataclass(frozen=True, eq=False)
class Patches:
    """Every triangle divided into divisions^2 equal patches; a lamp that does not reflect has none.

    triangle : (p,) index of the parent. uv : (p, 2) barycentric coordinates of the centroid there. area : (p,) mm^2.
    material, surface : (p,) indices. corners : (p, 3, 3) mm.
    """

    triangle: np.ndarray
    uv: np.ndarray
    area: np.ndarray
    material: np.ndarray
    surface: np.ndarray
    corners: np.ndarray
    packed_divisions: mi.Float
    packed_first: mi.UInt32

    @property
    def centre(self) -> np.ndarray:
        """(p, 3) centroids, mm."""
        return self.corners.mean(axis=1)

    def __len__(self) -> int:
        return len(self.triangle)


def build_patches(tracer: Tracer, edge_mm: float, finer: int = 1) -> Patches:
    """Divide all triangles into patches with edges up to ``edge_mm``, and each of these patches into finer^2."""
    divisions, first, parts = [], [], []
    total = 0
    for index, (a, b, c) in enumerate(tracer.vertices):
        first.append(total)
        if tracer.material[index] >= tracer.reflectors:
            divisions.append(1)
            continue
        n = max(
            1,
            int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c)) / edge_mm)),
        )
        n *= finer
        divisions.append(n)
        i, j, upper = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), [0, 1], indexing="ij"))
        keep = i + j + upper < n
        i, j, upper = i[keep], j[keep], upper[keep]
        # in the order of patch_of: row by row, each row with one cell (two patches) fewer
        order = np.argsort(_local_index(i, j, upper, n))
        i, j, upper = i[order], j[order], upper[order]
        grid = np.stack(
            [np.stack([i + upper, j + upper], -1), np.stack([i + 1, j], -1), np.stack([i, j + 1], -1)], 1
        )
        weights = grid / n
        corners = a + weights[..., :1] * (b - a) + weights[..., 1:] * (c - a)
        parts.append((np.full(len(i), index), corners, weights.mean(axis=1)))
        total += len(i)
    triangle = np.concatenate([p[0] for p in parts])
    corners = np.concatenate([p[1] for p in parts])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Patches(
        triangle=triangle,
        uv=np.concatenate([p[2] for p in parts]),
        area=0.5 * np.linalg.norm(cross, axis=1),
        material=tracer.material[triangle],
        surface=tracer.surface[triangle],
        corners=corners,
        packed_divisions=mi.Float(np.array(divisions, np.float32)),
        packed_first=mi.UInt32(np.array(first, np.uint32)),
    )


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


def patch_points(corners: mi.Float, index: mi.UInt32, u: mi.Float, v: mi.Float) -> mi.Point3f:
    """A point uniform over each patch ``index``. corners : those of Patches, flattened. u, v : in [0, 1)."""
    a, b, c = (dr.gather(mi.Point3f, corners, index * 3 + k) for k in range(3))
    root = dr.sqrt(u)
    return a + (b - a) * (root * (1 - v)) + (c - a) * (root * v)
