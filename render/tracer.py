"""The scene as one triangle mesh under Embree (or OptiX), with what each triangle is packed beside it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene

from . import variant as _variant  # noqa: F401  (activates a variant)

__all__ = ["RAY_OFFSET_MM", "Hit", "Tracer", "build_tracer", "camera_ray", "facets", "intersect", "visible"]

#: Rays leave surfaces this far above them: a hundred times the rounding of positions at box size.
RAY_OFFSET_MM = 0.01


@dataclass(frozen=True, eq=False)
class Tracer:
    """A scene ready for rays.

    vertices : (t, 3, 3) mm, all triangles, the lamp's last. normals : (t, 3). surface : (t,) index into
    ``scene.surfaces``, the lamp's triangles carry len(surfaces). material : (t,) index into
    ``material_names``, the lamp's carry len(material_names). facet : (t,) index of the flat face it belongs
    to; facet_surface : (f,) the surface of each face, the lamp's face comes last.
    """

    scene: Scene
    mitsuba_scene: mi.Scene
    material_names: tuple[str, ...]
    vertices: np.ndarray
    normals: np.ndarray
    surface: np.ndarray
    material: np.ndarray
    facet: np.ndarray
    facet_surface: np.ndarray
    packed_normals: mi.Float
    packed_surface: mi.UInt32
    packed_material: mi.UInt32
    packed_facet: mi.UInt32

    @property
    def lamp_triangles(self) -> np.ndarray:
        """(k, 3, 3) vertices of the lamp's triangles, mm."""
        return self.vertices[self.surface == len(self.scene.surfaces)]


@dataclass
class Hit:
    """A lane's nearest hit: the triangle, where on it, and its normal, towards the lit side.

    front : the ray meets the lit side. Backs are black: in a box of closed blocks no light reaches them.
    """

    valid: mi.Bool
    front: mi.Bool
    triangle: mi.UInt32
    uv: mi.Point2f
    distance: mi.Float
    position: mi.Point3f
    normal: mi.Vector3f


def build_tracer(scene: Scene) -> Tracer:
    """Load all triangles of a scene into one mesh."""
    names = tuple(scene.materials)
    parts = [(s, i, names.index(s.material)) for i, s in enumerate(scene.surfaces)]
    parts.append((scene.lamp.surface, len(scene.surfaces), len(names)))
    vertices = np.concatenate([s.vertices_mm[s.faces] for s, _, _ in parts])
    surface = np.concatenate([np.full(len(s.faces), i) for s, i, _ in parts])
    material = np.concatenate([np.full(len(s.faces), m) for s, _, m in parts])
    normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facet, facet_surface = facets(normals, surface)
    mesh = mi.Mesh("scene", 3 * len(vertices), len(vertices))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(np.arange(3 * len(vertices), dtype=np.uint32))
    parameters.update()
    return Tracer(
        scene=scene,
        mitsuba_scene=mi.load_dict({"type": "scene", "mesh": mesh}),
        material_names=names,
        vertices=vertices,
        normals=normals,
        surface=surface,
        material=material,
        facet=facet,
        facet_surface=facet_surface,
        packed_normals=mi.Float(normals.astype(np.float32).ravel()),
        packed_surface=mi.UInt32(surface.astype(np.uint32)),
        packed_material=mi.UInt32(material.astype(np.uint32)),
        packed_facet=mi.UInt32(facet.astype(np.uint32)),
    )


def facets(normals: np.ndarray, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group each surface's triangles into flat faces: normals within 2 degrees of a face's first triangle.

    normals : (t, 3) unit vectors. surface : (t,). Returns the face of each triangle (t,), numbered by first
    appearance, and the surface of each face (f,).
    """
    facet = np.full(len(normals), -1)
    owners: list[int] = []
    for index in range(len(normals)):
        if facet[index] < 0:
            same = (
                (surface == surface[index])
                & (normals @ normals[index] > np.cos(np.radians(2.0)))
                & (facet < 0)
            )
            facet[same] = len(owners)
            owners.append(int(surface[index]))
    return facet, np.array(owners)


def intersect(tracer: Tracer, ray: mi.Ray3f, active: mi.Bool | bool = True, coherent: bool = False) -> Hit:
    """Nearest hit of each lane's ray."""
    found = tracer.mitsuba_scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
    valid = found.is_valid() & active
    normal = dr.gather(mi.Vector3f, tracer.packed_normals, found.prim_index, valid)
    return Hit(
        valid=valid,
        front=valid & (dr.dot(normal, ray.d) < 0),
        triangle=found.prim_index,
        uv=found.prim_uv,
        distance=found.t,
        position=ray(found.t),
        normal=normal,
    )


def visible(tracer: Tracer, origin: mi.Point3f, target: mi.Point3f, active: mi.Bool) -> mi.Bool:
    """Whether the segment between two points is free (both ends excluded)."""
    offset = target - origin
    distance = dr.norm(offset)
    ray = mi.Ray3f(origin, offset / distance)
    ray.maxt = distance * (1 - 1e-4)
    return active & ~tracer.mitsuba_scene.ray_test(ray, active=active)


def camera_ray(camera: Camera, u: mi.Float, v: mi.Float) -> mi.Ray3f:
    """Rays through image positions (px) of the calibrated camera, distortion inverted."""
    f, k1 = dr.opaque(mi.Float, camera.focal_length_px), dr.opaque(mi.Float, camera.k1)
    x = (u - dr.opaque(mi.Float, camera.principal_point_px[0])) / f
    y = (v - dr.opaque(mi.Float, camera.principal_point_px[1])) / f
    radius = dr.sqrt(x * x + y * y)
    r = mi.Float(radius)
    for _ in range(4):  # Newton: quadratic convergence, 4 steps reach single precision for |k1| r^2 < 0.3
        r = r - (r * (1 + k1 * r * r) - radius) / (1 + 3 * k1 * r * r)
    scale = dr.select(radius > 0, r / radius, 1.0)
    x, y = x * scale, y * scale
    rows = [[dr.opaque(mi.Float, float(value)) for value in row] for row in camera.rotation]
    direction = mi.Vector3f(*(x * rows[0][i] + y * rows[1][i] + rows[2][i] for i in range(3)))
    origin = mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in camera.position_mm))
    return mi.Ray3f(origin, dr.normalize(direction))
