"""The scene's triangles for rays, with the properties of each."""

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

#: Distance above a surface at which rays start: a hundred times the rounding error of positions in the box.
RAY_OFFSET_MM = 0.01

#: Normals within this angle are of one flat face, degrees.
_FLAT_DEG = 2.0

#: Faces of one surface.
_MOST_FACES = 48


@dataclass(frozen=True, eq=False)
class Tracer:
    """A scene prepared for ray tracing.

    vertices : (t, 3, 3) mm, all triangles, the lamps' last. normals : (t, 3). surface : (t,) index into
    ``scene.surfaces``; len(surfaces) for the lamps. material : (t,) index into ``material_names``; for lamps
    len(material_names) and the lamp's index. facet : (t,) index of the flat face, see ``facets``. facet_surface :
    (f,) the surface of each face, the lamps' last. accelerator : what rays are asked of. packed_triangles : normal
    and material of each triangle in two 64-bit words, which reduces the number of gathers. packed_faces : the same of
    the faces of ``FlatFaces``, otherwise None.
    """

    scene: Scene
    accelerator: mi.Scene | FlatFaces | FacesAndTree
    material_names: tuple[str, ...]
    vertices: np.ndarray
    normals: np.ndarray
    surface: np.ndarray
    material: np.ndarray
    facet: np.ndarray
    facet_surface: np.ndarray
    packed_triangles: mi.UInt64
    packed_faces: mi.UInt64 | None
    packed_facet: mi.UInt32

    @property
    def reflectors(self) -> int:
        """How many materials reflect, by index: all of them, and the lamps, if a reflectance of one is above 0."""
        lamps = self.scene.lamps
        return len(self.material_names) + len(lamps) * any(lamp.reflects for lamp in lamps)

    def lamp_triangles(self, index: int = 0) -> np.ndarray:
        """(k, 3, 3) vertices of one lamp's triangles, mm."""
        return self.vertices[self.material == len(self.material_names) + index]


@dataclass
class Hit:
    """The nearest hit of each lane's ray: triangle, position, material, and normal (towards the lit side).

    front : the ray hits the lit side. Back sides are black: in a box of closed blocks no light reaches them.
    reflecting : the lit side of a surface that reflects; of a lamp, if a reflectance is above 0. on_lamp : the
    emitting side of a lamp. distance : mm. uv : barycentric coordinates.
    """

    valid: mi.Bool
    front: mi.Bool
    reflecting: mi.Bool
    on_lamp: mi.Bool
    triangle: mi.UInt32
    uv: mi.Point2f
    distance: mi.Float
    position: mi.Point3f
    normal: mi.Vector3f
    material: mi.UInt32


def build_tracer(scene: Scene) -> Tracer:
    """The tracer of a scene, with all triangles in one mesh.

    Few flat faces and opaque balls are intersected in the compiled kernel; meshes, and everything on GPUs, by Mitsuba
    (Embree, OptiX).
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
    words = np.empty((len(normals), 4), "<u4")
    words[:, :3] = normals.astype("<f4").view("<u4")
    words[:, 3] = material
    return device_array(mi.UInt64, words.view("<u8").ravel())


def facets(normals: np.ndarray, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group each surface's triangles into faces: normals within an angle of a face's first triangle.

    The angle is 2 degrees; on a curved surface it is widened until there are at most ``_MOST_FACES`` faces, which are
    then only nearly flat. normals : (t, 3) unit vectors. surface : (t,). Returns the face of each triangle (t,),
    numbered by first appearance, and the surface of each face (f,).
    """
    facet = np.full(len(normals), -1)
    owners: list[int] = []
    for index in np.unique(surface):
        own = np.flatnonzero(surface == index)
        angle = _FLAT_DEG
        while (found := _grouped(normals[own], angle)) is None:
            angle *= 1.5
        facet[own] = len(owners) + found
        owners += [int(index)] * (int(found.max()) + 1)
    return facet, np.array(owners)


def _grouped(normals: np.ndarray, angle_deg: float) -> np.ndarray | None:
    """(t,) the face of each triangle of one surface, None for more than ``_MOST_FACES``."""
    face = np.full(len(normals), -1)
    for number in range(_MOST_FACES):
        free = np.flatnonzero(face < 0)
        if not len(free):
            return face
        face[free[normals[free] @ normals[free[0]] > np.cos(np.radians(angle_deg))]] = number
    return None if (face < 0).any() else face


def intersect(tracer: Tracer, ray: mi.Ray3f, active: mi.Bool | bool = True, coherent: bool = False) -> Hit:
    """Nearest hit of each lane's ray."""
    found = tracer.accelerator.ray_intersect_preliminary(ray, coherent=coherent, active=active)
    valid = found.is_valid() & active
    if isinstance(found, NearestFace):
        normal, material = _unpacked(tracer.packed_faces, found.face, valid)
    else:
        normal, material = normal_and_material(tracer, found.prim_index, valid)
        if isinstance(found, NearestOnBall):
            normal = dr.select(found.on_ball, found.normal, normal)
    front = valid & (dr.dot(normal, ray.d) < 0)
    return Hit(
        valid=valid,
        front=front,
        reflecting=front & (material < tracer.reflectors),
        on_lamp=front & (material >= len(tracer.material_names)),
        triangle=found.prim_index,
        uv=found.prim_uv,
        distance=found.t,
        position=ray(found.t),
        normal=normal,
        material=material,
    )


def normal_and_material(
    tracer: Tracer, triangle: mi.UInt32, active: mi.Bool | bool = True
) -> tuple[mi.Vector3f, mi.UInt32]:
    """Unit normal, towards the lit side, and material of each lane's triangle."""
    return _unpacked(tracer.packed_triangles, triangle, active)


def _unpacked(packed: mi.UInt64, index: mi.UInt32, active: mi.Bool | bool) -> tuple[mi.Vector3f, mi.UInt32]:
    first = dr.gather(mi.UInt64, packed, 2 * index, active)
    second = dr.gather(mi.UInt64, packed, 2 * index + 1, active)
    x, y, z = (dr.reinterpret_array(mi.Float, mi.UInt32(word)) for word in (first, first >> 32, second))
    return mi.Vector3f(x, y, z), mi.UInt32(second >> 32)


def visible(tracer: Tracer, origin: mi.Point3f, target: mi.Point3f, active: mi.Bool, enclosed: bool = False) -> mi.Bool:
    """Whether the segment between two points is unoccluded (both ends excluded).

    enclosed : both points lie within the scene's convex hull, as all points of its surfaces do. It saves time.
    """
    ray = mi.Ray3f(origin, target - origin)
    ray.maxt = 1 - 1e-4
    if isinstance(tracer.accelerator, FlatFaces | FacesAndTree):
        return active & ~tracer.accelerator.ray_test(ray, active, enclosed)
    return active & ~tracer.accelerator.ray_test(ray, active=active)


def pixel_rays(camera: Camera, pixel: mi.UInt32) -> Callable[[mi.Float, mi.Float], mi.Ray3f]:
    """Camera rays, distortion inverted, through one pixel per lane; pixels are counted along the rows.

    Returns a function of the position in the pixel, 0 to 1 along its row and its column.
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
    """Slopes x and y of camera rays against the camera's axis, by the position in the pixel as in ``pixel_rays``.

    Undistorted positions are the distorted ones times s with s + q s^3 = 1, q = k1 r^2, solved by Newton's method:
    several steps once for the pixel's centre, then one step for each position.
    """
    f, k1 = dr.opaque(mi.Float, camera.focal_length_px), dr.opaque(mi.Float, camera.k1)
    centre_x, centre_y = (dr.opaque(mi.Float, float(centre)) for centre in camera.principal_point_px)
    column, row = mi.Float(pixel % camera.width_px), mi.Float(pixel // camera.width_px)
    if camera.further_distortion is not None:
        # within a pixel it is taken for even
        centres = np.stack([column.numpy(), row.numpy()], axis=-1).astype(float)
        column, row = (device_array(mi.Float, c) for c in camera.undisplaced(centres).T)
    left = (column - 0.5 - centre_x) / f
    top = (row - 0.5 - centre_y) / f
    pitch = 1 / f

    def place(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
        x, y = dr.fma(u, pitch, left), dr.fma(v, pitch, top)
        return x, y, k1 * (x * x + y * y)

    def newton(scale: mi.Float, q: mi.Float) -> mi.Float:
        bent = q * scale * scale
        return scale - (scale + bent * scale - 1) / (1 + 3 * bent)

    *_, q_centre = place(mi.Float(0.5), mi.Float(0.5))
    scale_centre = mi.Float(1)
    for _ in range(4):  # single precision for |k1| r^2 < 0.3 (0.1 for barrel distortion)
        scale_centre = newton(scale_centre, q_centre)
    slope = -(scale_centre**3) / (1 + 3 * q_centre * scale_centre**2)

    def positions(u: mi.Float, v: mi.Float) -> tuple[mi.Float, mi.Float]:
        x, y, q = place(u, v)
        scale = newton(scale_centre + slope * (q - q_centre), q)
        return x * scale, y * scale

    return positions
