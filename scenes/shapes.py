"""Triangle meshes of the shapes in a scene file: quads, quads with a hole, boxes, spheres, mesh files.

A mesh is (vertices (n, 3), faces (m, 3)), faces counter-clockwise seen from the lit side.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
import trimesh
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

__all__ = [
    "Mesh",
    "box_mesh",
    "file_mesh",
    "file_uv",
    "joined",
    "moved_on_floor",
    "plate_mesh",
    "quad_mesh",
    "ring_mesh",
    "sphere_mesh",
    "turned_about_vertical",
    "vector_area",
]

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]

#: Largest distance of a hole's corners from the plane of their quad, relative to the quad's size.
PLANE_TOLERANCE = 1e-4

#: Times that an icosahedron's faces are divided for a sphere: 20,480 triangles, edges of a thirtieth of the radius.
_SPHERE_DIVISIONS = 5

#: Vertices this near to the lowest one stand on the floor, mm.
STANDING_MM = 1e-3


def quad_mesh(corners: ArrayLike) -> Mesh:
    """A quad (4, 3), split into 1-2-3 and 1-3-4; the split matters if the corners are not in one plane."""
    return np.asarray(corners, float), np.array([[0, 1, 2], [0, 2, 3]], np.int64)


def vector_area(corners: ArrayLike) -> NDArray[np.float64]:
    """(3,) area times unit normal of a closed polygon (n, 3), exact for plane polygons."""
    polygon = np.asarray(corners, float)
    return 0.5 * np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)


def ring_mesh(outer: ArrayLike, hole: ArrayLike) -> Mesh:
    """A convex polygon (n, 3) with a convex hole (m, 3) strictly inside it and in its plane: n + m triangles.

    The edges of both polygons are sorted by direction, as in a Minkowski sum. An outer edge then forms a triangle
    with the hole's vertex nearest to its line, and an edge of the hole with the outer vertex farthest beyond its
    line. No triangle overlaps the hole or leaves the outer polygon; together they tile the ring. No vertices are
    added, so neighbouring surfaces meet the ring without cracks.

    Raises ValueError if a polygon is not convex, or the hole is not in the plane or not inside.
    """
    outer, hole = np.asarray(outer, float), np.asarray(hole, float)
    normal = vector_area(outer)
    first = outer[1] - outer[0]
    if not (normal.any() and first.any()):
        raise ValueError("the quad has no area")
    axes = np.stack([first, np.cross(normal, first)])
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    height = (np.concatenate([outer, hole]) - outer[0]) @ (normal / np.linalg.norm(normal))
    if np.abs(height).max() > PLANE_TOLERANCE * np.ptp(outer, axis=0).max():
        raise ValueError("the hole and the quad are not in one plane")
    if vector_area(hole) @ normal < 0:
        hole = hole[::-1]
    around, inside = outer @ axes.T, hole @ axes.T
    edges_around = np.roll(around, -1, axis=0) - around
    edges_inside = np.roll(inside, -1, axis=0) - inside
    for edges in (edges_around, edges_inside):
        if _cross(edges, np.roll(edges, -1, axis=0)).min() <= 0:
            raise ValueError("the hole or the quad is not convex")
    if _cross(edges_around[:, None], inside - around[:, None]).min() <= 0:
        raise ValueError("the hole is not inside the quad")

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


def plate_mesh(outer: ArrayLike, holes: Sequence[ArrayLike]) -> Mesh:
    """A convex polygon (n, 3) with several convex holes, divided between them by straight lines along their edges.

    Raises ValueError as ``ring_mesh`` does, and where no such line has all holes on one side or the other.
    """
    if len(holes) == 1:
        return ring_mesh(outer, holes[0])
    outer, inside = np.asarray(outer, float), [np.asarray(hole, float) for hole in holes]
    edges = np.concatenate([np.roll(hole, -1, axis=0) - hole for hole in inside])
    axes = np.cross(vector_area(outer), edges)
    gaps = []
    for axis in axes / np.linalg.norm(axes, axis=1, keepdims=True):
        reach = sorted((float((hole @ axis).min()), float((hole @ axis).max())) for hole in inside)
        ends = np.maximum.accumulate([end for _, end in reach])
        gaps += [(start - end, (start + end) / 2, axis) for end, (start, _) in zip(ends[:-1], reach[1:], strict=True)]
    gap, place, axis = max(gaps, key=itemgetter(0))
    if gap <= 0:
        raise ValueError("no straight line parts the holes")
    parts = []
    for sign in (1.0, -1.0):
        own = [hole for hole in inside if sign * (hole[0] @ axis - place) > 0]
        parts.append(plate_mesh(_beyond(outer, sign * (outer @ axis - place)), own))
    return joined(parts)


def _beyond(polygon: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part (m, 3) of a convex polygon (n, 3) where a linear function, (n,) at its corners, is positive."""
    kept = []
    for index, (here, there) in enumerate(zip(distance, np.roll(distance, -1), strict=True)):
        first, second = polygon[index], polygon[(index + 1) % len(polygon)]
        if here > 0:
            kept.append(first)
        if here * there < 0:
            kept.append(first + here / (here - there) * (second - first))
    return np.array(kept)


def box_mesh(center_mm: ArrayLike, size_mm: ArrayLike, yaw_deg: float) -> Mesh:
    """A block with outward faces (8 vertices, 12 faces), turned about +y through its centre, right-handed."""
    shape = trimesh.creation.box(extents=np.asarray(size_mm, float))
    turned = Rotation.from_euler("y", yaw_deg, degrees=True).apply(np.asarray(shape.vertices, float))
    return turned + np.asarray(center_mm, float), np.asarray(shape.faces, np.int64)


def sphere_mesh(center_mm: ArrayLike, radius_mm: float) -> Mesh:
    """A sphere lit from outside: 20,480 triangles of its area, whose distances from the centre are right to 0.02 %."""
    shape = trimesh.creation.icosphere(_SPHERE_DIVISIONS)
    scale = radius_mm * np.sqrt(4 * np.pi / shape.area)
    return scale * np.asarray(shape.vertices) + np.asarray(center_mm, float), np.asarray(shape.faces, np.int64)


def turned_about_vertical(vertices_mm: ArrayLike, yaw_deg: float) -> NDArray[np.float64]:
    """Vertices turned about +y, right-handed, through the mean of the footprint's corners.

    Parameters
    ----------
    vertices_mm
        (n, 3) vertices, mm.
    yaw_deg
        Angle, degrees.

    Returns
    -------
    NDArray
        (n, 3) turned vertices, mm.
    """
    vertices = np.asarray(vertices_mm, float)
    height = vertices[:, 1]
    footprint = np.unique(vertices[height < height.min() + STANDING_MM], axis=0)
    centre = footprint.mean(axis=0)
    return Rotation.from_euler("y", yaw_deg, degrees=True).apply(vertices - centre) + centre


def moved_on_floor(vertices_mm: ArrayLike, dx_mm: float, dz_mm: float, yaw_deg: float) -> NDArray[np.float64]:
    """Vertices of a block turned about the vertical, then shifted along the floor.

    Parameters
    ----------
    vertices_mm
        (n, 3) vertices, mm.
    dx_mm, dz_mm
        Shift along x and z, mm.
    yaw_deg
        Angle about +y, right-handed, through the mean of the footprint's corners, degrees.

    Returns
    -------
    NDArray
        (n, 3) vertices of the moved block, mm.
    """
    return turned_about_vertical(vertices_mm, yaw_deg) + np.array([dx_mm, 0.0, dz_mm])


def file_mesh(path: Path, unit_mm: float) -> Mesh:
    """The triangles of an OBJ, PLY or STL file, whose unit is ``unit_mm`` millimetres.

    Raises InputError for a file that cannot be read or holds no triangles.
    """
    mesh = _loaded(path)
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    if faces.ndim != 2 or faces.shape[0] == 0 or faces.shape[1] != 3:
        raise InputError(path, "no triangles", "a mesh with at least one triangle")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(path, "a face with a missing vertex", "indices of the file's vertices")
    return vertices * unit_mm, faces


def file_uv(path: Path) -> NDArray[np.float64] | None:
    """(n, 2) finite texture coordinates of the vertices of ``file_mesh``, v upwards; None where the file has none."""
    found = getattr(_loaded(path).visual, "uv", None)
    if found is None:
        return None
    uv = np.asarray(found, float)[:, :2]
    return uv if np.isfinite(uv).all() else None


def _loaded(path: Path) -> trimesh.Trimesh:
    expected = "a readable mesh: .obj, .ply or .stl"
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("obj", "ply", "stl"):
        raise InputError(path, f"a file of kind '{kind}'", expected)
    require_regular_file(path, expected)
    try:
        with open(path, "rb") as stream:
            # skip_materials: reflectances come from the scene file, and no other file may be opened
            return trimesh.load_mesh(stream, file_type=kind, process=False, skip_materials=True)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None
    except Exception as error:  # the mesh parsers raise exceptions of any type on damaged input
        raise InputError(path, f"{type(error).__name__}: {error}", expected) from None


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one; their vertices stay separate."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
