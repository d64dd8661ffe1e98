"""Rays against balls inside the compiled kernel, by the sphere that a ball's triangles stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..device import device_array, dr, mi
from .flat_faces import Nearest

__all__ = ["Ball", "NearestOnBall", "build_ball"]

#: Cells along each axis of the map from directions to triangles: each has a third of the edge of a ball's triangles.
_CELLS = 256


@dataclass(frozen=True, eq=False)
class NearestOnBall(Nearest):
    """on_ball : whether a ball is met; normal is then its own, not its triangle's."""

    on_ball: mi.Bool
    normal: mi.Vector3f


@dataclass(frozen=True, eq=False)
class Ball:
    """An opaque ball, met from outside only: rays that start within it, as from points of its triangles, leave it.

    centre, radius : mm, of one lane. triangles : of the scene, that nearest to each cell of the octahedral map.
    """

    centre: mi.Point3f
    radius: mi.Float
    triangles: mi.UInt32

    def met(self, ray: mi.Ray3f) -> tuple[mi.Float, mi.Bool]:
        """Distance to where a ray enters, in lengths of its direction, and whether it does, ahead of its start."""
        from_centre = ray.o - self.centre
        slowness = dr.rcp(dr.squared_norm(ray.d))
        nearest = -dr.dot(from_centre, ray.d) * slowness
        # by how far the ray passes the centre: far away the difference of two squares would lose digits
        depth = dr.fma(self.radius, self.radius, -dr.squared_norm(from_centre + nearest * ray.d))
        t = nearest - dr.sqrt(dr.maximum(depth, 0) * slowness)
        return t, (depth > 0) & (t > 0)

    def at(self, position: mi.Point3f, met: mi.Bool) -> tuple[mi.UInt32, mi.Vector3f]:
        """The triangle that stands for a position on it, and its normal there."""
        normal = dr.normalize(position - self.centre)
        column, row = (mi.UInt32(dr.clip(_CELLS * axis, 0, _CELLS - 1)) for axis in _folded(normal))
        return dr.gather(mi.UInt32, self.triangles, row * _CELLS + column, met), normal


def _folded(direction: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """The octahedral map of a direction on the unit square (Cigolle et al., "A Survey of Efficient Representations for
    Independent Unit Vectors", Journal of Computer Graphics Techniques 3(2), 2014)."""
    size = dr.rcp(dr.abs(direction.x) + dr.abs(direction.y) + dr.abs(direction.z))
    u, v = direction.x * size, direction.y * size
    below = direction.z < 0
    along_u, along_v = dr.mulsign(1 - dr.abs(v), u), dr.mulsign(1 - dr.abs(u), v)
    return dr.fma(dr.select(below, along_u, u), 0.5, 0.5), dr.fma(dr.select(below, along_v, v), 0.5, 0.5)


def _cell_directions() -> NDArray[np.float64]:
    """(cells^2, 3) along the middles of the map's cells, row by row."""
    across = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
    v, u = (axis.ravel() for axis in np.meshgrid(across, across, indexing="ij"))
    z = 1 - np.abs(u) - np.abs(v)
    beyond = np.maximum(-z, 0)
    found = np.column_stack([u - np.copysign(beyond, u), v - np.copysign(beyond, v), z])
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def build_ball(surface: Surface, first: int) -> Ball:
    """A ball of the scene. first : the number of its first triangle."""
    centre, radius = surface.sphere_mm
    middles = surface.vertices_mm[surface.faces].mean(axis=1) - centre
    _, nearest = KDTree(middles).query(radius * _cell_directions())
    return Ball(
        mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in centre)),
        dr.opaque(mi.Float, radius),
        device_array(mi.UInt32, first + nearest),
    )
