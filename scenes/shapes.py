"""Triangle meshes of the shapes in a scene file: quads, holes, boxes, spheres, mesh files.

A mesh is (vertices (n, 3), faces (m, 3)), faces counter-clockwise seen from the lit side.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import require_regular_file
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "Mesh",
    "box_mesh",
    "file_mesh",
    "file_uv",
    "front_uv",
    "joined",
    "moved_on_floor",
    "plate_mesh",
    "quad_mesh",
    "ring_mesh",
    "sphere_mesh",
    "turned_about_vertical",
    "vector_area",
]

#: Vertices (n, 3) and faces (m, 3), indices of vertices.
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]

#: Largest distance of a hole's corners from the plane of their quad, relative to the quad's size: 0.05 mm in 550 mm.
PLANE_TOLERANCE = 1e-4

#: Number of divisions of an icosahedron's faces for a sphere: 20,480 triangles, edges of a thirtieth of the radius.
_SPHERE_DIVISIONS = 5

#: Lines of an OBJ file that select a material.
#: Last line of the header of a PLY file, without which its reader never ends in some versions.
_PLY_END = b"end_header"
#: Hint at a mesh file that cannot be read.
_DAMAGED_HINT = "The file is damaged or truncated: export it again."

_MATERIAL_LINE = re.compile(rb"^[ \t]*(?:usemtl|mtllib)\b[^\n]*\n", re.MULTILINE)

#: Height above the lowest vertex, mm, below which a vertex stands on the floor: rounding of rotations.
STANDING_MM = 1e-3


def quad_mesh(corners: ArrayLike) -> Mesh:
    """Mesh of a quad, split into the triangles 1-2-3 and 1-3-4.

    The split matters if the corners are not in one plane.

    Parameters
    ----------
    corners
        (4, 3) corners, counter-clockwise from the lit side.

    Returns
    -------
    Mesh
        The four corners and two triangles.
    """
    return np.asarray(corners, float), np.array([[0, 1, 2], [0, 2, 3]], np.int64)


def vector_area(corners: ArrayLike) -> NDArray[np.float64]:
    """Area times unit normal of a closed polygon, exact for plane polygons.

    Parameters
    ----------
    corners
        (n, 3) corners in order.

    Returns
    -------
    NDArray
        (3,) vector area, in the squared unit of the corners.
    """
    polygon = np.asarray(corners, float)
    return 0.5 * np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)


def ring_mesh(outer: ArrayLike, hole: ArrayLike) -> Mesh:
    """Mesh of a convex polygon with a convex hole strictly inside it and in its plane.

    The edges of both polygons are sorted by direction, as in a Minkowski sum. An outer edge then forms a triangle
    with the hole's vertex nearest to its line, and an edge of the hole with the outer vertex farthest beyond its
    line. No triangle overlaps the hole or leaves the outer polygon; together they tile the ring. No vertices are
    added, so neighbouring surfaces meet the ring without cracks.

    Parameters
    ----------
    outer
        (n, 3) corners, counter-clockwise from the lit side.
    hole
        (m, 3) corners of the hole, in either direction.

    Returns
    -------
    Mesh
        The corners of both polygons and n + m triangles.

    Raises
    ------
    ValueError
        If a polygon is not convex or has no area, or the hole is not in the plane or not inside.
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
    """Mesh of a convex polygon with several convex holes.

    Straight lines along edges of holes divide the polygon until each part has one hole. The line with the widest gap
    between holes is taken first.

    Parameters
    ----------
    outer
        (n, 3) corners, counter-clockwise from the lit side.
    holes
        (m, 3) corners each; at least one hole.

    Returns
    -------
    Mesh
        The rings around the holes.

    Raises
    ------
    ValueError
        If a hole does not fit as in ``ring_mesh``, or no straight line along an edge separates the holes.
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
    gap, position, axis = max(gaps, key=itemgetter(0))
    if gap <= 0:
        raise ValueError("no straight line separates the holes")
    parts = []
    for sign in (1.0, -1.0):
        holes_of_part = [hole for hole in inside if sign * (hole[0] @ axis - position) > 0]
        parts.append(plate_mesh(_beyond(outer, sign * (outer @ axis - position)), holes_of_part))
    return joined(parts)


def _beyond(polygon: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 3) part of a convex polygon (n, 3) on one side of a line.

    ``distance`` (n,) is the signed distance of its corners from the line; the positive side is returned.
    """
    corners = []
    for index, (start, end) in enumerate(zip(distance, np.roll(distance, -1), strict=True)):
        first, second = polygon[index], polygon[(index + 1) % len(polygon)]
        if start > 0:
            corners.append(first)
        if start * end < 0:
            corners.append(first + start / (start - end) * (second - first))
    return np.array(corners)


def box_mesh(center_mm: ArrayLike, size_mm: ArrayLike, yaw_deg: float) -> Mesh:
    """Mesh of a block with outward faces.

    Parameters
    ----------
    center_mm
        (3,) centre, mm.
    size_mm
        (3,) edges along x, y and z before the turn, mm.
    yaw_deg
        Angle about +y through the centre, right-handed, degrees.

    Returns
    -------
    Mesh
        8 vertices, mm, and 12 triangles.
    """
    import trimesh  # slow to import
    from scipy.spatial.transform import Rotation

    shape = trimesh.creation.box(extents=np.asarray(size_mm, float))
    turned = Rotation.from_euler("y", yaw_deg, degrees=True).apply(np.asarray(shape.vertices, float))
    return turned + np.asarray(center_mm, float), np.asarray(shape.faces, np.int64)


def sphere_mesh(center_mm: ArrayLike, radius_mm: float) -> Mesh:
    """Mesh of a sphere with outward faces and the sphere's area.

    Parameters
    ----------
    center_mm
        (3,) centre, mm.
    radius_mm
        Radius, mm.

    Returns
    -------
    Mesh
        20,480 triangles. The distances of their points from the centre are within 0.02 % of the radius.
    """
    import trimesh  # slow to import

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
    from scipy.spatial.transform import Rotation  # slow to import

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
    """Triangles of a mesh file.

    Parameters
    ----------
    path
        An OBJ, PLY or STL file. Its vertices are not merged.
    unit_mm
        Unit of its coordinates, mm.

    Returns
    -------
    Mesh
        Vertices (n, 3), mm, and faces (m, 3).

    Raises
    ------
    InputError
        If the file cannot be read, or has no triangles, faces without vertices, or coordinates that are not finite.
    """
    mesh = _loaded(path)
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    if faces.ndim != 2 or faces.shape[0] == 0 or faces.shape[1] != 3:
        raise InputError(path, "no triangles", "a mesh with at least one triangle")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(path, "a face with a missing vertex", "indices of the file's vertices")
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise InputError(path, f"vertex {first + 1} at {tuple(vertices[first].tolist())}", "finite coordinates")
    return vertices * unit_mm, faces


def file_uv(path: Path) -> NDArray[np.float64] | None:
    """Texture coordinates of a mesh file.

    Parameters
    ----------
    path
        An OBJ, PLY or STL file.

    Returns
    -------
    NDArray or None
        (n, 2) coordinates of the vertices of ``file_mesh``, v upwards; None if the file has none, or not finite ones.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    values = getattr(_loaded(path).visual, "uv", None)
    if values is None:
        return None
    uv = np.asarray(values, float)[:, :2]
    return uv if np.isfinite(uv).all() else None


def front_uv(directions: ArrayLike) -> NDArray[np.float64]:
    """Texture coordinates of a round body.

    The image is on the front half, and mirrored on the back half. The map is equal in area (Lambert 1772). The front is
    towards -z, up is +y.

    Parameters
    ----------
    directions
        (n, 3) vectors from the centre, other than 0.

    Returns
    -------
    NDArray
        (n, 2) coordinates, u along the image's columns and v along its rows, in the circle within the image.
    """
    x, y, z = (np.asarray(directions, float) / np.linalg.norm(directions, axis=1, keepdims=True)).T
    scale = 0.5 / np.sqrt(1 + np.abs(z))
    return np.stack([0.5 - scale * x, 0.5 - scale * y], axis=1)


def _loaded(path: Path) -> trimesh.Trimesh:
    """Mesh of a file; InputError if it cannot be read."""
    import trimesh  # slow to import

    expected = "a readable mesh: .obj, .ply or .stl"
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("obj", "ply", "stl"):
        raise InputError(path, f"a file of kind '{kind}'", expected)
    require_regular_file(path, expected)
    try:
        content = path.read_bytes()
        if kind == "ply" and _PLY_END not in content:
            raise InputError(path, "a header without its end", expected, _DAMAGED_HINT)
        if kind == "obj":  # time grows with the square of the materials, and reflectances come from the scene file
            content = _MATERIAL_LINE.sub(b"", content)
        # skip_materials: no other file may be opened
        return trimesh.load_mesh(BytesIO(content), file_type=kind, process=False, skip_materials=True)
    except InputError:
        raise
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None
    except Exception as error:  # the mesh parsers raise exceptions of any type on damaged input
        raise InputError(path, f"a file that cannot be read as a mesh ({error})", expected, _DAMAGED_HINT) from None


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one.

    Parameters
    ----------
    meshes
        At least one mesh.

    Returns
    -------
    Mesh
        All vertices and faces in order; vertices stay separate.
    """
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) cross product of plane vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
