"""What rays are asked of: flat faces in the kernel, a tree of many triangles, or both, where a mesh is among walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .flat_faces import FlatFaces, Nearest, flat_faces

__all__ = ["FacesAndTree", "build_accelerator", "in_a_tree"]

#: Beside a tree, more flat faces than this do not pay.
_MOST_BESIDE = 32

#: Surfaces in a tree that have a bounding box of their own; more of them share one.
_MOST_BOXES = 4

#: Bounding boxes reach so much further than their corners, mm.
_MARGIN_MM = 0.1


@dataclass(frozen=True, eq=False)
class FacesAndTree:
    """Rays against flat faces first; only those that reach a box about the other triangles are asked of the tree.

    boxes : the lower and upper corners, in numbers of one lane. of_faces, of_tree : the scene's triangle of each one of
    the faces' and of the tree's.
    """

    faces: FlatFaces
    tree: mi.Scene
    boxes: tuple[tuple[mi.Point3f, mi.Point3f], ...]
    of_faces: mi.UInt32
    of_tree: mi.UInt32

    def ray_intersect_preliminary(
        self, ray: mi.Ray3f, coherent: bool = False, active: mi.Bool | bool = True
    ) -> Nearest:
        """The nearest triangle of each lane's ray."""
        flat = self.faces.ray_intersect_preliminary(ray, coherent, active)
        shorter = mi.Ray3f(ray.o, ray.d)
        shorter.maxt = dr.minimum(ray.maxt, flat.t)
        asked = self._reached(shorter) & active
        curved = self.tree.ray_intersect_preliminary(shorter, coherent=coherent, active=asked)
        met = curved.is_valid() & asked
        return Nearest(
            dr.select(met, curved.t, flat.t),
            dr.select(
                met,
                dr.gather(mi.UInt32, self.of_tree, curved.prim_index, met),
                dr.gather(mi.UInt32, self.of_faces, flat.prim_index, flat.valid),
            ),
            dr.select(met, curved.prim_uv, flat.prim_uv),
            flat.valid | met,
        )

    def ray_test(self, ray: mi.Ray3f, active: mi.Bool | bool = True, enclosed: bool = False) -> mi.Bool:
        """Whether anything is met before the ray's end; ``enclosed`` as for ``FlatFaces``."""
        blocked = self.faces.ray_test(ray, active, enclosed)
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
    vertices: NDArray[np.float64], facet: NDArray[np.int64], surface: NDArray[np.int64]
) -> mi.Scene | FlatFaces | FacesAndTree:
    """What rays are asked of. vertices : (t, 3, 3) mm. facet, surface : (t,) of each triangle."""
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
    others = np.unique(surface[~few])
    groups = [[one] for one in others] if len(others) <= _MOST_BOXES else [others]
    corners = [vertices[np.isin(surface, group)].reshape(-1, 3) for group in groups]
    return FacesAndTree(
        faces,
        in_a_tree(vertices[~few]),
        tuple((_point(c.min(axis=0) - _MARGIN_MM), _point(c.max(axis=0) + _MARGIN_MM)) for c in corners),
        device_array(mi.UInt32, np.flatnonzero(few)),
        device_array(mi.UInt32, np.flatnonzero(~few)),
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
