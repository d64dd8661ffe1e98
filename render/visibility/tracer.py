"""The scene's triangles prepared for ray tracing: nearest hits, shadow rays and camera rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene

from ..device import device_array, dr, mi
from .balls import NearestOnBall
from .faces_and_tree import FacesAndTree, build_accelerator
from .flat_faces import FlatFaces, NearestFace

__all__ = [
    "RAY_OFFSET_MM",
    "Hit",
    "Tracer",
    "build_tracer",
    "facets",
    "intersect",
    "normal_and_material",
    "pixel_rays",
    "visible",
]

#: Distance above a surface at which rays start, mm: a hundred times the rounding error of positions in the box.
RAY_OFFSET_MM = 0.01

#: Largest angle between the normals of one flat face, degrees.
_FLAT_DEG = 2.0

#: Largest number of flat faces of one surface; a curved surface is divided into at most this many.
_MOST_FACES = 48


@dataclass(frozen=True, eq=False)
class Tracer:
    """A scene prepared for ray tracing: t triangles, grouped into f flat faces."""

    #: The scene itself, for reflectances, lamps and media.
    scene: Scene
    #: Intersects rays: by the compiled kernel, by Mitsuba's tree, or by both, see `build_accelerator`.
    accelerator: mi.Scene | FlatFaces | FacesAndTree
    #: Names of the materials, in the order of their indices.
    material_names: tuple[str, ...]
    #: (t, 3, 3) corners of all triangles, mm; the lamps' triangles last.
    vertices: np.ndarray
    #: (t, 3) unit normals, towards the lit side.
    normals: np.ndarray
    #: (t,) index into `scene.surfaces`; the number of surfaces for triangles of lamps.
    surface: np.ndarray
    #: (t,) index into `material_names`; for lamps their number plus the index of the lamp.
    material: np.ndarray
    #: (t,) index of the flat face, see `facets`.
    facet: np.ndarray
    #: (f,) index into `scene.surfaces` of each flat face; the lamps' faces are last and have the number of surfaces.
    facet_surface: np.ndarray
    #: (2 t) normal and material of each triangle in two 64-bit words, which reduces the number of gathers.
    packed_triangles: mi.UInt64
    #: (2 n) the same of the n faces of `FlatFaces`; None for another accelerator.
    packed_faces: mi.UInt64 | None
    #: (t,) `facet` on the device.
    packed_facet: mi.UInt32

    @property
    def reflectors(self) -> int:
        """Number of materials that may reflect, counted by index.

        All materials; with the lamps if the reflectance of any of them is above 0.
        """
        lamps = self.scene.lamps
        return len(self.material_names) + len(lamps) * any(lamp.reflects for lamp in lamps)

    def lamp_triangles(self, index: int = 0) -> np.ndarray:
        """Triangles of one lamp.

        Parameters
        ----------
        index
            Index of the lamp among the scene's lamps.

        Returns
        -------
        NDArray
            (k, 3, 3) corners, mm.
        """
        return self.vertices[self.material == len(self.material_names) + index]


@dataclass
class Hit:
    """The nearest hit of each lane's ray.

    Back sides are black: in a box of closed blocks no light reaches them.
    """

    #: Whether the ray hits anything.
    valid: mi.Bool
    #: Whether it hits the lit side.
    front: mi.Bool
    #: Whether it hits the lit side of a surface that may reflect, or of a lamp if a lamp reflects.
    reflecting: mi.Bool
    #: Whether it hits the emitting side of a lamp.
    on_lamp: mi.Bool
    #: Index of the triangle; arbitrary without a hit.
    triangle: mi.UInt32
    #: Barycentric coordinates of the second and the third corner.
    uv: mi.Point2f
    #: Distance from the ray's origin in lengths of its direction (mm for a unit direction); infinite without a hit.
    distance: mi.Float
    #: Point of the hit, mm.
    position: mi.Point3f
    #: Unit normal, towards the lit side.
    normal: mi.Vector3f
    #: Index of the material, as in `Tracer.material`.
    material: mi.UInt32


def build_tracer(scene: Scene) -> Tracer:
    """Prepare a scene for ray tracing, with all its triangles in one list.

    A few flat faces and opaque balls are intersected in the compiled kernel. Meshes, and everything on a GPU, are
    intersected by Mitsuba (Embree, OptiX).

    Parameters
    ----------
    scene
        Surfaces, lamps and materials.

    Returns
    -------
    Tracer
        The prepared scene.
    """
    names = tuple(scene.materials)
    parts = [(s, i, names.index(s.material)) for i, s in enumerate(scene.surfaces)]
    parts += [(lamp.surface, len(scene.surfaces), len(names) + i) for i, lamp in enumerate(scene.lamps)]
    vertices = np.concatenate([s.vertices_mm[s.faces] for s, _, _ in parts])
    surface = np.concatenate([np.full(len(s.faces), i) for s, i, _ in parts])
    material = np.concatenate([np.full(len(s.faces), m) for s, _, m in parts])
    normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    owner = surface + np.maximum(material - len(names), 0)  # no face has two lamps
    facet, facet_surface = facets(normals, owner)
    balls = {index: s for index, s in enumerate(scene.surfaces) if scene.meets_sphere(s)}
    accelerator = build_accelerator(vertices, facet, owner, balls)
    packed_faces = None
    if isinstance(accelerator, FlatFaces):
        first = accelerator.triangles.numpy()[::2]
        packed_faces = _packed(normals[first], material[first])
    return Tracer(
        scene=scene,
        accelerator=accelerator,
        material_names=names,
        vertices=vertices,
        normals=normals,
        surface=surface,
        material=material,
        facet=facet,
        facet_surface=np.minimum(facet_surface, len(scene.surfaces)),
        packed_triangles=_packed(normals, material),
        packed_faces=packed_faces,
        packed_facet=device_array(mi.UInt32, facet),
    )


def _packed(normals: np.ndarray, material: np.ndarray) -> mi.UInt64:
    """(2 n) words of n normals (single precision) and materials: x, y; then z, material."""
    table = np.empty((len(normals), 4), "<u4")
    table[:, :3] = normals.astype("<f4").view("<u4")
    table[:, 3] = material
    return device_array(mi.UInt64, table.view("<u8").ravel())


def facets(normals: np.ndarray, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group each surface's triangles into flat faces.

    A face is a set of triangles whose normals are within an angle of the normal of its first triangle. The angle is 2
    degrees. On a curved surface it is widened in steps of 1.5 until there are at most `_MOST_FACES` faces, which are
    then only nearly flat.

    Parameters
    ----------
    normals
        (t, 3) unit normals.
    surface
        (t,) index of each triangle's surface.

    Returns
    -------
    tuple[NDArray, NDArray]
        (t,) face of each triangle, numbered surface by surface, and (f,) surface of each face.
    """
    facet = np.full(len(normals), -1)
    owners: list[int] = []
    for index in np.unique(surface):
        triangles = np.flatnonzero(surface == index)
        angle = _FLAT_DEG
        while (faces := _grouped(normals[triangles], angle)) is None:
            angle *= 1.5
        facet[triangles] = len(owners) + faces
        owners += [int(index)] * (int(faces.max()) + 1)
    return facet, np.array(owners)


def _grouped(normals: np.ndarray, angle_deg: float) -> np.ndarray | None:
    """(t,) face of each triangle of one surface; None if there are more than `_MOST_FACES`."""
    face = np.full(len(normals), -1)
    for number in range(_MOST_FACES):
        free = np.flatnonzero(face < 0)
        if not len(free):
            return face
        face[free[normals[free] @ normals[free[0]] > np.cos(np.radians(angle_deg))]] = number
    return None if (face < 0).any() else face


def intersect(tracer: Tracer, ray: mi.Ray3f, active: mi.Bool | bool = True, coherent: bool = False) -> Hit:
    """Nearest hit of each lane's ray.

    Parameters
    ----------
    tracer
        The prepared scene.
    ray
        One ray per lane; hits beyond its `maxt` do not count.
    active
        Lanes whose rays are traced; other lanes have no hit.
    coherent
        Whether neighbouring lanes have similar rays, which Embree traces faster.

    Returns
    -------
    Hit
        The hits; their normals on balls are those of the sphere.
    """
    preliminary = tracer.accelerator.ray_intersect_preliminary(ray, coherent=coherent, active=active)
    valid = preliminary.is_valid() & active
    if isinstance(preliminary, NearestFace):
        normal, material = _unpacked(tracer.packed_faces, preliminary.face, valid)
    else:
        normal, material = normal_and_material(tracer, preliminary.prim_index, valid)
        if isinstance(preliminary, NearestOnBall):
            normal = dr.select(preliminary.on_ball, preliminary.normal, normal)
    front = valid & (dr.dot(normal, ray.d) < 0)
    return Hit(
        valid=valid,
        front=front,
        reflecting=front & (material < tracer.reflectors),
        on_lamp=front & (material >= len(tracer.material_names)),
        triangle=preliminary.prim_index,
        uv=preliminary.prim_uv,
        distance=preliminary.t,
        position=ray(preliminary.t),
        normal=normal,
        material=material,
    )


def normal_and_material(
    tracer: Tracer, triangle: mi.UInt32, active: mi.Bool | bool = True
) -> tuple[mi.Vector3f, mi.UInt32]:
    """Normal and material of each lane's triangle.

    Parameters
    ----------
    tracer
        The prepared scene.
    triangle
        Index of a triangle per lane.
    active
        Lanes that are read.

    Returns
    -------
    tuple[Vector3f, UInt32]
        Unit normal, towards the lit side, and index of the material; zeros in other lanes.
    """
    return _unpacked(tracer.packed_triangles, triangle, active)


def _unpacked(packed: mi.UInt64, index: mi.UInt32, active: mi.Bool | bool) -> tuple[mi.Vector3f, mi.UInt32]:
    """Normal and material from the two words of an entry of `_packed`."""
    first = dr.gather(mi.UInt64, packed, 2 * index, active)
    second = dr.gather(mi.UInt64, packed, 2 * index + 1, active)
    x, y, z = (dr.reinterpret_array(mi.Float, mi.UInt32(word)) for word in (first, first >> 32, second))
    return mi.Vector3f(x, y, z), mi.UInt32(second >> 32)


def visible(tracer: Tracer, origin: mi.Point3f, target: mi.Point3f, active: mi.Bool, enclosed: bool = False) -> mi.Bool:
    """Whether the segment between two points is unoccluded; both ends are excluded.

    Parameters
    ----------
    tracer
        The prepared scene.
    origin
        Start of each lane's segment, mm.
    target
        End of each lane's segment, mm; the last 1e-4 of the length is not tested.
    active
        Lanes that are tested; False in others.
    enclosed
        Whether both points lie within the scene's convex hull, as all points of its surfaces do. Faces on the hull are
        then left out, which saves time.

    Returns
    -------
    Bool
        True where nothing is in between.
    """
    ray = mi.Ray3f(origin, target - origin)
    ray.maxt = 1 - 1e-4
    if isinstance(tracer.accelerator, FlatFaces | FacesAndTree):
        return active & ~tracer.accelerator.ray_test(ray, active, enclosed)
    return active & ~tracer.accelerator.ray_test(ray, active=active)


def pixel_rays(camera: Camera, pixel: mi.UInt32) -> Callable[[mi.Float, mi.Float], mi.Ray3f]:
    """Camera rays through one pixel per lane, with the lens distortion inverted.

    Parameters
    ----------
    camera
        Pose, lens and resolution.
    pixel
        Index of each lane's pixel, counted along the rows.

    Returns
    -------
    Callable
        Function of the position (u, v) in the pixel, 0 to 1 along its row and its column, that returns the rays (unit
        directions).
    """
    axes = [[dr.opaque(mi.Float, float(value)) for value in row] for row in camera.rotation]
    origin = mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in camera.position_mm))
    positions = _undistorted_positions(camera, pixel)

    def rays(u: mi.Float, v: mi.Float) -> mi.Ray3f:
        x, y = positions(u, v)
        direction = mi.Vector3f(*(x * axes[0][i] + y * axes[1][i] + axes[2][i] for i in range(3)))
        return mi.Ray3f(origin, dr.normalize(direction))

    return rays


def _undistorted_positions(
    camera: Camera, pixel: mi.UInt32
) -> Callable[[mi.Float, mi.Float], tuple[mi.Float, mi.Float]]:
    """Slopes x and y of camera rays to the camera's axis, by the position in the pixel.

    Distorted slopes d and undistorted slopes u of the radial model are related by d = u (1 + k1 |u|^2). With u = s d
    this is s + q s^3 = 1, q = k1 |d|^2, which Newton's method solves: four steps once for the pixel's centre, then one
    step per position from the tangent there, ds/dq = -s^3 / (1 + 3 q s^2). Further distortion is taken as constant
    within a pixel. A lens of more terms has a table instead.
    """
    if not camera.lens.one_term:
        return _tabulated_positions(camera, pixel)
    f, k1 = dr.opaque(mi.Float, camera.focal_length_px), dr.opaque(mi.Float, camera.k1)
    centre_x, centre_y = (dr.opaque(mi.Float, float(centre)) for centre in camera.principal_point_px)
    width = dr.opaque(mi.UInt32, camera.width_px)  # one kernel serves pictures of all sizes
    line = pixel // width
    column, row = mi.Float(pixel - line * width), mi.Float(line)
    if camera.further_distortion is not None:
        # within a pixel it is taken for even
        centres = np.stack([column.numpy(), row.numpy()], axis=-1).astype(float)
        column, row = (device_array(mi.Float, c) for c in camera.undisplaced(centres).T)
    start_x = (column - 0.5 - centre_x) / f
    start_y = (row - 0.5 - centre_y) / f
    pitch = 1 / f

    def distorted(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
        x, y = dr.fma(u, pitch, start_x), dr.fma(v, pitch, start_y)
        return x, y, k1 * (x * x + y * y)

    def newton(scale: mi.Float, q: mi.Float) -> mi.Float:
        bent = q * scale * scale
        return scale - (scale + bent * scale - 1) / (1 + 3 * bent)

    *_, q_centre = distorted(mi.Float(0.5), mi.Float(0.5))
    scale_centre = mi.Float(1)
    for _ in range(4):  # single precision for |k1| r^2 < 0.3 (0.1 for barrel distortion)
        scale_centre = newton(scale_centre, q_centre)
    slope = -(scale_centre**3) / (1 + 3 * q_centre * scale_centre**2)

    def positions(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
        x, y, q = distorted(u, v)
        scale = newton(scale_centre + slope * (q - q_centre), q)
        return x * scale, y * scale

    return positions


def _tabulated_positions(camera: Camera, pixel: mi.UInt32) -> Callable[[mi.Float, mi.Float], tuple[mi.Float, mi.Float]]:
    """Slopes of camera rays by the position in the pixel, from a Taylor series of each pixel."""
    series = [dr.gather(mi.Float, device_array(mi.Float, values), pixel) for values in _slope_series(camera)]

    def positions(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
        right, down = u - 0.5, v - 0.5
        x, y = (
            s + right * (along + right * bend + down * cross) + down * (across + down * curve)
            for s, along, across, bend, cross, curve in (series[:6], series[6:])
        )
        return x, y

    return positions


def _slope_series(camera: Camera) -> np.ndarray:
    """Taylor coefficients (12, pixels) of slopes about the pixels' centres.

    They are those of 1, u, v, u^2, u v, v^2 for x, then for y. They come from the slopes at the centre, at the middles
    of the sides and at two corners.
    """
    row, column = np.indices((camera.height_px, camera.width_px)).reshape(2, -1)
    right = np.array([0.0, 0.5, -0.5, 0.0, 0.0, 0.5, -0.5])[:, None]
    down = np.array([0.0, 0.0, 0.0, 0.5, -0.5, 0.5, -0.5])[:, None]
    centre, east, west, south, north, forward, back = camera.slopes(column + right, row + down)
    along, across = east - west, south - north
    bend, curve = 2 * (east + west - 2 * centre), 2 * (south + north - 2 * centre)
    cross = 2 * (forward + back - 2 * centre) - bend - curve
    series = np.stack([centre, along, across, bend, cross, curve])
    return np.moveaxis(series, -1, 0).reshape(12, -1)
