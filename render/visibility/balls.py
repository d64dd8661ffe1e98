"""Rays against balls inside the compiled kernel.

A ball is intersected as the sphere that its triangles stand for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..device import device_array, dr, mi
from .flat_faces import Nearest

__all__ = ["Balls", "NearestOnBall", "build_balls"]

#: Cells along each axis of the map from directions to triangles: a cell has about a third of the edge of a ball's
#: triangles.
_CELLS = 256


@dataclass(frozen=True, eq=False)
class NearestOnBall(Nearest):
    """The nearest triangle of each lane's ray, which may stand for a point of a ball."""

    #: Whether the ray hits a ball.
    on_ball: mi.Bool
    #: Unit normal of the ball there (not of its triangle); arbitrary otherwise.
    normal: mi.Vector3f


@dataclass(frozen=True, eq=False)
class Balls:
    """Opaque balls, hit from outside only.

    Rays that start within a ball, as from points of its triangles, leave it without a hit.
    """

    #: Centre and radius of each of the n balls, mm, in numbers of one lane.
    spheres: tuple[tuple[mi.Point3f, mi.Float], ...]
    #: (3 n) the centres in one array.
    centres: mi.Float
    #: (n cells^2) for each ball the triangle, among the scene's, nearest to each cell of the octahedral map.
    triangles: mi.UInt32

    def first_hit(self, ray: mi.Ray3f, end: mi.Float) -> tuple[mi.Float, mi.UInt32]:
        """First ball that a ray enters before its end.

        With c the vector from the centre to the origin, the ray passes the centre at t0 = -c . d / |d|^2 and enters the
        sphere at t0 - sqrt((r^2 - |c + t0 d|^2) / |d|^2).

        Parameters
        ----------
        ray
            One ray per lane.
        end
            Distance of its end, in lengths of its direction.

        Returns
        -------
        tuple[Float, UInt32]
            Distance in lengths of the direction, and index of the ball; `end` and the number of balls without a hit.
        """
        which = mi.UInt32(len(self.spheres))
        slowness = dr.rcp(dr.squared_norm(ray.d))
        for index, (centre, radius) in enumerate(self.spheres):
            from_centre = ray.o - centre
            nearest = -dr.dot(from_centre, ray.d) * slowness
            # by how far the ray passes the centre: far away the difference of two squares would lose digits
            depth = dr.fma(radius, radius, -dr.squared_norm(from_centre + nearest * ray.d))
            t = nearest - dr.sqrt(dr.maximum(depth, 0) * slowness)
            met = (depth > 0) & (t > 0) & (t < end)
            end, which = dr.select(met, t, end), dr.select(met, index, which)
        return end, which

    def surface_at(self, position: mi.Point3f, which: mi.UInt32, met: mi.Bool) -> tuple[mi.UInt32, mi.Vector3f]:
        """Triangle that stands for a position on a ball, and the ball's normal there.

        Parameters
        ----------
        position
            Point on the sphere, mm.
        which
            Index of the ball.
        met
            Lanes that hit a ball.

        Returns
        -------
        tuple[UInt32, Vector3f]
            Index of the triangle in the scene, and the unit normal outwards.
        """
        normal = dr.normalize(position - dr.gather(mi.Point3f, self.centres, which, met))
        column, row = (mi.UInt32(dr.clip(_CELLS * axis, 0, _CELLS - 1)) for axis in _folded(normal))
        return dr.gather(mi.UInt32, self.triangles, (which * _CELLS + row) * _CELLS + column, met), normal


def _folded(direction: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """Octahedral map of a direction to the unit square.

    Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", Journal of Computer Graphics
    Techniques 3(2), 2014.
    """
    size = dr.rcp(dr.abs(direction.x) + dr.abs(direction.y) + dr.abs(direction.z))
    u, v = direction.x * size, direction.y * size
    below = direction.z < 0
    along_u, along_v = dr.mulsign(1 - dr.abs(v), u), dr.mulsign(1 - dr.abs(u), v)
    return dr.fma(dr.select(below, along_u, u), 0.5, 0.5), dr.fma(dr.select(below, along_v, v), 0.5, 0.5)


def _cell_directions() -> NDArray[np.float64]:
    """(cells^2, 3) unit vectors to the centres of the map's cells: the inverse of `_folded`."""
    across = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
    v, u = (axis.ravel() for axis in np.meshgrid(across, across, indexing="ij"))
    z = 1 - np.abs(u) - np.abs(v)
    beyond = np.maximum(-z, 0)
    directions = np.column_stack([u - np.copysign(beyond, u), v - np.copysign(beyond, v), z])
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def build_balls(surfaces: Mapping[int, Surface]) -> Balls:
    """Spheres and maps to triangles of balls.

    Parameters
    ----------
    surfaces
        The balls, by the index of their first triangle in the scene.

    Returns
    -------
    Balls
        The balls in the same order.
    """
    spheres, triangles = [surface.sphere_mm for surface in surfaces.values()], []
    for (first, surface), (centre, radius) in zip(surfaces.items(), spheres, strict=True):
        middles = surface.vertices_mm[surface.faces].mean(axis=1) - centre
        triangles.append(first + KDTree(middles).query(radius * _cell_directions())[1])
    return Balls(
        tuple(
            (mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in centre)), dr.opaque(mi.Float, radius))
            for centre, radius in spheres
        ),
        device_array(mi.Float, [centre for centre, _ in spheres]),
        device_array(mi.UInt32, triangles),
    )
