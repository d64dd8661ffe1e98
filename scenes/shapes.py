"""Triangle meshes from what a scene file may hold: quads, quads with a hole, boxes, mesh files.

Every function returns (vertices (n, 3), faces (m, 3)), faces counter-clockwise seen from the lit side.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from .errors import InputError

__all__ = ["Mesh", "box_mesh", "file_mesh", "joined", "quad_mesh", "ring_mesh", "vector_area"]

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]

#: How far from the plane of a quad its hole's corners may lie, as a share of the quad's size.
PLANE_TOLERANCE = 1e-4


def quad_mesh(corners: ArrayLike) -> Mesh:
    """A quad (4, 3), split 1-2-3 and 1-3-4: the diagonal matters where the corners are not in one plane."""
    return np.asarray(corners, float), np.array([[0, 1, 2], [0, 2, 3]], np.int64)


def vector_area(corners: ArrayLike) -> NDArray[np.float64]:
    """(3,) area times unit normal of a closed polygon (n, 3), exact for plane polygons."""
    polygon = np.asarray(corners, float)
    return 0.5 * np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)


def ring_mesh(outer: ArrayLike, hole: ArrayLike) -> Mesh:
    """A convex polygon (n, 3) with a convex hole (m, 3) strictly inside it and in its plane: n + m triangles.

    The edges of both polygons are taken in the order of their direction, as in a Minkowski sum. So an outer
    edge meets the hole's vertex nearest to its line and a hole's edge the outer vertex farthest beyond its
    line: no triangle reaches into the hole or out of the outer polygon, and together they tile the ring.
    The ring has the corners as they are given and no others, so it meets its neighbours without a crack.

    Raises ValueError where a polygon is not convex, or the hole is not in the plane or not inside.
    """
    outer, hole = np.asarray(outer, float), np.asarray(hole, float)
    normal = vector_area(outer)
    first = outer[1] - outer[0]
    if not (normal.any() and first.any()):
        raise ValueError("what is around the hole has no area")
    axes = np.stack([first, np.cross(normal, first)])
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    height = (np.concatenate([outer, hole]) - outer[0]) @ (normal / np.linalg.norm(normal))
    if np.abs(height).max() > PLANE_TOLERANCE * np.ptp(outer, axis=0).max():
        raise ValueError("the hole and what is around it are not in one plane")
    if vector_area(hole) @ normal < 0:
        hole = hole[::-1]
    around, inside = outer @ axes.T, hole @ axes.T
    edges_around = np.roll(around, -1, axis=0) - around
    edges_inside = np.roll(inside, -1, axis=0) - inside
    for edges in (edges_around, edges_inside):
        if _cross(edges, np.roll(edges, -1, axis=0)).min() <= 0:
            raise ValueError("the hole or what is around it is not convex")
    if _cross(edges_around[:, None], inside - around[:, None]).min() <= 0:
        raise ValueError("the hole is not inside")

    n, m = len(outer), len(hole)
    edges = np.concatenate([edges_around, edges_inside])
    order = np.argsort(np.arctan2(edges[:, 1], edges[:, 0]), kind="stable")
    i, j = int(order[order < n][0]), int(order[order >= n][0]) - n
    faces = []
    for edge in order:
        if edge < n:
            faces.append((i, (i + 1) % n, n + j))
            i = (i + 1) % n
        else:
            faces.append((i, n + (j + 1) % m, n + j))
            j = (j + 1) % m
    return np.concatenate([outer, hole]), np.array(faces, np.int64)


def box_mesh(center_mm: ArrayLike, size_mm: ArrayLike, yaw_deg: float) -> Mesh:
    """A block lit from outside (8 vertices, 12 faces), turned about +y through its centre, right-handed."""
    shape = trimesh.creation.box(extents=np.asarray(size_mm, float))
    turned = Rotation.from_euler("y", yaw_deg, degrees=True).apply(np.asarray(shape.vertices, float))
    return turned + np.asarray(center_mm, float), np.asarray(shape.faces, np.int64)


def file_mesh(path: Path, unit_mm: float) -> Mesh:
    """The triangles of an OBJ, PLY or STL file, whose unit is ``unit_mm`` millimetres.

    Raises InputError for a file that cannot be read or holds no triangles.
    """
    expected = "a readable mesh: .obj, .ply or .stl"
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("obj", "ply", "stl"):
        raise InputError(path, f"a file of kind '{kind}'", expected)
    try:
        with open(path, "rb") as stream:
            # skip_materials: colours come from the scene file, and no further file is to be opened
            mesh = trimesh.load_mesh(stream, file_type=kind, process=False, skip_materials=True)
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None
    except Exception as error:  # the mesh parsers raise whatever their input makes them stumble over
        raise InputError(path, f"{type(error).__name__}: {error}", expected) from None
    if faces.ndim != 2 or faces.shape[0] == 0 or faces.shape[1] != 3:
        raise InputError(path, "no triangles", "a mesh with at least one triangle")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(path, "a face with a vertex that is not there", "indices of the file's vertices")
    return vertices * unit_mm, faces


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one; their vertices stay separate."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
