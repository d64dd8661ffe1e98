"""Intersection of rays with flat faces and balls in the kernel, and with meshes in a tree.

A scene of a few flat faces needs no tree, and one of meshes alone is a tree. Where both occur, faces and balls are
tried first, and the tree by those rays only that reach a box around a mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .balls import Balls, NearestOnBall, build_balls
from .flat_faces import FlatFaces, flat_faces

__all__ = ["FacesAndTree", "build_accelerator", "triangle_tree"]

#: Largest number of flat faces tried in the kernel together with a tree; with more of them the tree alone is faster.
_MOST_WITH_TREE = 32

#: Largest number of surfaces in a tree with one bounding box each; more of them share one box.
_MOST_BOXES = 4

#: Largest number of balls tried in the kernel, by every ray; more of them stay triangles in the tree.
_MOST_BALLS = 16

#: Distance by which bounding boxes are enlarged, mm.
_MARGIN_MM = 0.1


@dataclass(frozen=True, eq=False)
class FacesAndTree:
    """Flat faces and balls in the kernel, and a tree for the other triangles.

    Rays try faces and balls first. Only those that then reach a box around the other triangles are traced through the
    tree.
    """

    #: The flat faces.
    faces: FlatFaces
    #: The balls; None where there are none.
    balls: Balls | None
    #: The other triangles; None where there are none.
    tree: mi.Scene | None
    #: Lower and upper corners of the boxes around them, mm, in numbers of one lane.
    boxes: tuple[tuple[mi.Point3f, mi.Point3f], ...]
    #: For each triangle of `faces`, its index in the scene.
    face_triangles: mi.UInt32
    #: For each triangle of `tree`, its index in the scene.
    tree_triangles: mi.UInt32

    def ray_intersect_preliminary(
        self, ray: mi.Ray3f, coherent: bool = False, active: mi.Bool | bool = True
    ) -> NearestOnBall:
        """Nearest triangle of each lane's ray, in the form of Mitsuba's method of this name.

        Parameters
        ----------
        ray
            One ray per lane.
        coherent
            Whether neighbouring lanes have similar rays.
        active
            Lanes whose rays are traced.

        Returns
        -------
        NearestOnBall
            On a ball, the triangle that stands for the point, with the coordinates of its centre.
        """
        flat = self.faces.ray_intersect_preliminary(ray, coherent, active)
        distance, uv = dr.select(active, dr.minimum(ray.maxt, flat.t), -1.0), flat.prim_uv
        triangle = dr.gather(mi.UInt32, self.face_triangles, flat.prim_index, flat.valid)
        valid, on_ball, normal = flat.valid, mi.Bool(False), mi.Vector3f(0)
        if self.balls is not None:
            distance, ball = self.balls.first_hit(ray, distance)
            on_ball = ball < len(self.balls.spheres)
            ball_triangle, normal = self.balls.surface_at(ray(distance), ball, on_ball)
            triangle, uv = dr.select(on_ball, ball_triangle, triangle), dr.select(on_ball, mi.Point2f(1 / 3), uv)
            valid = valid | on_ball
        if self.tree is not None:
            shorter = mi.Ray3f(ray.o, ray.d)
            shorter.maxt = distance
            searched = self._meets_box(shorter) & active
            in_tree = self.tree.ray_intersect_preliminary(shorter, coherent=coherent, active=searched)
            nearer = in_tree.is_valid() & searched
            distance, uv = dr.select(nearer, in_tree.t, distance), dr.select(nearer, in_tree.prim_uv, uv)
            triangle = dr.select(
                nearer, dr.gather(mi.UInt32, self.tree_triangles, in_tree.prim_index, nearer), triangle
            )
            valid, on_ball = valid | nearer, on_ball & ~nearer
        return NearestOnBall(dr.select(valid, distance, dr.inf), triangle, uv, valid, on_ball, normal)

    def ray_test(self, ray: mi.Ray3f, active: mi.Bool | bool = True, enclosed: bool = False) -> mi.Bool:
        """Whether a ray hits anything before its end.

        Parameters
        ----------
        ray
            One ray per lane.
        active
            Lanes whose rays are traced.
        enclosed
            Whether both ends lie within the scene's convex hull, see `FlatFaces.ray_test`.

        Returns
        -------
        Bool
            True for a hit.
        """
        blocked = self.faces.ray_test(ray, active, enclosed)
        if self.balls is not None:
            _, ball = self.balls.first_hit(ray, ray.maxt)
            blocked |= (ball < len(self.balls.spheres)) & active
        if self.tree is None:
            return blocked
        searched = self._meets_box(ray) & active & ~blocked
        return blocked | (self.tree.ray_test(ray, active=searched) & searched)

    def _meets_box(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether a ray passes a box before its end, by the slab method."""
        slowness = dr.rcp(ray.d)
        met = mi.Bool(False)
        for low, high in self.boxes:
            first, second = (low - ray.o) * slowness, (high - ray.o) * slowness
            enter, leave = dr.max(dr.minimum(first, second)), dr.min(dr.maximum(first, second))
            met |= (enter <= leave) & (leave >= 0) & (enter <= ray.maxt)
        return met


def build_accelerator(
    vertices: NDArray[np.float64],
    facet: NDArray[np.int64],
    surface: NDArray[np.int64],
    balls: Mapping[int, Surface],
) -> mi.Scene | FlatFaces | FacesAndTree:
    """Accelerator for the triangles of a scene.

    On a GPU always a tree (OptiX). Otherwise `FlatFaces` if all triangles form few flat faces; a tree if no or too many
    surfaces are of few triangles; else `FacesAndTree`.

    Parameters
    ----------
    vertices
        (t, 3, 3) corners, mm.
    facet
        (t,) flat face of each triangle.
    surface
        (t,) surface of each triangle, each lamp counted as one.
    balls
        Opaque balls, by their index among surfaces.

    Returns
    -------
    Scene | FlatFaces | FacesAndTree
        The accelerator.
    """
    if mi.variant().startswith("cuda"):
        return triangle_tree(vertices)
    faces = flat_faces(vertices, facet)
    if faces is not None:
        return faces
    sizes = np.bincount(surface)
    few = np.isin(surface, np.flatnonzero(sizes <= _MOST_WITH_TREE))
    faces = flat_faces(vertices[few], facet[few], vertices.reshape(-1, 3)) if few.any() else None
    if faces is None or len(faces.outlines) > _MOST_WITH_TREE:
        return triangle_tree(vertices)
    if len(balls) > _MOST_BALLS:
        balls = {}
    many = ~few & ~np.isin(surface, list(balls))
    others = np.unique(surface[many])
    groups = [] if not len(others) else [[index] for index in others] if len(others) <= _MOST_BOXES else [others]
    corners = [vertices[np.isin(surface, group)].reshape(-1, 3) for group in groups]
    return FacesAndTree(
        faces,
        build_balls({int(np.argmax(surface == index)): b for index, b in balls.items()}) if balls else None,
        triangle_tree(vertices[many]) if many.any() else None,
        tuple((_point(c.min(axis=0) - _MARGIN_MM), _point(c.max(axis=0) + _MARGIN_MM)) for c in corners),
        device_array(mi.UInt32, np.flatnonzero(few)),
        device_array(mi.UInt32, np.flatnonzero(many)),
    )


def _point(values: NDArray[np.float64]) -> mi.Point3f:
    """A point in numbers of one lane, which are data of the kernel, not literals in it."""
    return mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in values))


def triangle_tree(vertices: NDArray[np.float64]) -> mi.Scene:
    """Triangles in Embree's tree, or in OptiX's on a GPU.

    Parameters
    ----------
    vertices
        (t, 3, 3) corners, mm.

    Returns
    -------
    Scene
        A Mitsuba scene of one mesh, for intersections only.
    """
    mesh = mi.Mesh("scene", 3 * len(vertices), len(vertices))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = device_array(mi.Float, vertices)
    parameters["faces"] = device_array(mi.UInt32, np.arange(3 * len(vertices)))
    parameters.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})
