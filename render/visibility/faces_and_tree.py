"""What rays are asked of: flat faces in the kernel, a tree of many triangles, or, where balls and meshes are among
walls, faces and balls in the kernel and the meshes in a tree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .balls import Balls, NearestOnBall, build_balls
from .flat_faces import FlatFaces, flat_faces

__all__ = ["FacesAndTree", "build_accelerator", "in_a_tree"]

#: Beside a tree, more flat faces than this do not pay.
_MOST_BESIDE = 32

#: Surfaces in a tree that have a bounding box of their own; more of them share one.
_MOST_BOXES = 4

#: Every ray tries all balls; where there are more than this they stay triangles in the tree.
_MOST_BALLS = 16

#: Bounding boxes reach so much further than their corners, mm.
_MARGIN_MM = 0.1


@dataclass(frozen=True, eq=False)
class FacesAndTree:
    """Rays against flat faces and balls first; only those that reach a box about the other triangles are asked of the
    tree. balls, tree : None where there are none.

    boxes : the lower and upper corners, in numbers of one lane. of_faces, of_tree : the scene's triangle of each one of
    the faces' and of the tree's.
    """

    faces: FlatFaces
    balls: Balls | None
    tree: mi.Scene | None
    boxes: tuple[tuple[mi.Point3f, mi.Point3f], ...]
    of_faces: mi.UInt32
    of_tree: mi.UInt32

    def ray_intersect_preliminary(
        self, ray: mi.Ray3f, coherent: bool = False, active: mi.Bool | bool = True
    ) -> NearestOnBall:
        """The nearest triangle of each lane's ray; on a ball, that which stands for the place met, at its middle."""
        flat = self.faces.ray_intersect_preliminary(ray, coherent, active)
        distance, uv = dr.select(active, dr.minimum(ray.maxt, flat.t), -1.0), flat.prim_uv
        triangle = dr.gather(mi.UInt32, self.of_faces, flat.prim_index, flat.valid)
        valid, on_ball, normal = flat.valid, mi.Bool(False), mi.Vector3f(0)
        if self.balls is not None:
            distance, ball = self.balls.met(ray, distance)
            on_ball = ball < len(self.balls.spheres)
            there, normal = self.balls.at(ray(distance), ball, on_ball)
            triangle, uv = dr.select(on_ball, there, triangle), dr.select(on_ball, mi.Point2f(1 / 3), uv)
            valid = valid | on_ball
        if self.tree is not None:
            shorter = mi.Ray3f(ray.o, ray.d)
            shorter.maxt = distance
            asked = self._reached(shorter) & active
            found = self.tree.ray_intersect_preliminary(shorter, coherent=coherent, active=asked)
            met = found.is_valid() & asked
            distance, uv = dr.select(met, found.t, distance), dr.select(met, found.prim_uv, uv)
            triangle = dr.select(met, dr.gather(mi.UInt32, self.of_tree, found.prim_index, met), triangle)
            valid, on_ball = valid | met, on_ball & ~met
        return NearestOnBall(dr.select(valid, distance, dr.inf), triangle, uv, valid, on_ball, normal)

    def ray_test(self, ray: mi.Ray3f, active: mi.Bool | bool = True, enclosed: bool = False) -> mi.Bool:
        """Whether anything is met before the ray's end; ``enclosed`` as for ``FlatFaces``."""
        blocked = self.faces.ray_test(ray, active, enclosed)
        if self.balls is not None:
            _, ball = self.balls.met(ray, ray.maxt)
            blocked |= (ball < len(self.balls.spheres)) & active
        if self.tree is None:
            return blocked
        asked = self._reached(ray) & active & ~blocked
        return blocked | (self.tree.ray_test(ray, active=asked) & asked)

    def _reached(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether a ray passes a box before its end."""
        slowness = dr.rcp(ray.d)
        found = mi.Bool(False)
        for low, high in self.boxes:
            one, other = (low - ray.o) * slowness, (high - ray.o) * slowness
            enter, leave = dr.max(dr.minimum(one, other)), dr.min(dr.maximum(one, other))
            found |= (enter <= leave) & (leave >= 0) & (enter <= ray.maxt)
        return found


def build_accelerator(
    vertices: NDArray[np.float64],
    facet: NDArray[np.int64],
    surface: NDArray[np.int64],
    balls: Mapping[int, Surface],
) -> mi.Scene | FlatFaces | FacesAndTree:
    """What rays are asked of. vertices : (t, 3, 3) mm. facet, surface : (t,) of each triangle. balls : the opaque ones,
    by their index among surfaces.
    """
    if mi.variant().startswith("cuda"):
        return in_a_tree(vertices)
    faces = flat_faces(vertices, facet)
    if faces is not None:
        return faces
    sizes = np.bincount(surface)
    few = np.isin(surface, np.flatnonzero(sizes <= _MOST_BESIDE))
    faces = flat_faces(vertices[few], facet[few], vertices.reshape(-1, 3)) if few.any() else None
    if faces is None or len(faces.outlines) > _MOST_BESIDE:
        return in_a_tree(vertices)
    if len(balls) > _MOST_BALLS:
        balls = {}
    many = ~few & ~np.isin(surface, list(balls))
    others = np.unique(surface[many])
    groups = [] if not len(others) else [[one] for one in others] if len(others) <= _MOST_BOXES else [others]
    corners = [vertices[np.isin(surface, group)].reshape(-1, 3) for group in groups]
    return FacesAndTree(
        faces,
        build_balls({int(np.argmax(surface == index)): b for index, b in balls.items()}) if balls else None,
        in_a_tree(vertices[many]) if many.any() else None,
        tuple((_point(c.min(axis=0) - _MARGIN_MM), _point(c.max(axis=0) + _MARGIN_MM)) for c in corners),
        device_array(mi.UInt32, np.flatnonzero(few)),
        device_array(mi.UInt32, np.flatnonzero(many)),
    )


def _point(values: NDArray[np.float64]) -> mi.Point3f:
    return mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in values))


def in_a_tree(vertices: NDArray[np.float64]) -> mi.Scene:
    """Triangles (t, 3, 3) in Embree's tree, or OptiX's on a GPU."""
    mesh = mi.Mesh("scene", 3 * len(vertices), len(vertices))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = device_array(mi.Float, vertices)
    parameters["faces"] = device_array(mi.UInt32, np.arange(3 * len(vertices)))
    parameters.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})
