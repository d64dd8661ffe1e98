"""A rough picture of a known scene: the surface seen by each pixel, the lamp's light on it, and what is reflected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

__all__ = ["Sight", "distance_to_surfaces", "radiance_over_lamp", "see"]

_LAMP_SAMPLES = 3

#: Surfaces of more triangles take too long and are left out: they send back and block little light.
_MOST_TRIANGLES = 200

_PATHS, _REFLECTIONS = 16, 9
_OFFSET_MM = 0.01


@dataclass(frozen=True, eq=False)
class Sight:
    """By pixel (y, x) of every ``step``-th row and column.

    surface : index into the scene's surfaces, their number for the lamp, -1 for nothing. place_mm : (y, x, 3).
    normal : (y, x, 3) towards the camera.
    direct : irradiance by a lamp of radiance 1, shadows left out, sr.
    """

    step: int
    surface: NDArray[np.int64]
    place_mm: NDArray[np.float64]
    normal: NDArray[np.float64]
    direct: NDArray[np.float64]


def _hits(
    origin: NDArray[np.float64], direction: NDArray[np.float64], triangle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) distance along rays (n, 3) to a triangle (3, 3), inf where they miss (Moeller and Trumbore 1997).

    origin : (3,) or (n, 3).
    """
    a, b, c = triangle
    p = np.cross(direction, c - a)
    determinant = p @ (b - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.sum(p * (origin - a), axis=-1) / determinant
        q = np.cross(origin - a, b - a)
        v = np.sum(direction * q, axis=-1) / determinant
        t = q @ (c - a) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & np.isfinite(t)
    return np.where(hit, t, np.inf)


def _rays(camera: Camera, step: int) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """(n, 3) directions of every step-th pixel."""
    v, u = np.mgrid[0 : camera.height_px : step, 0 : camera.width_px : step]
    return np.nan_to_num(camera.directions(u.ravel(), v.ravel())), (u.shape[0], u.shape[1])


def see(scene: Scene, camera: Camera, most_px: int = 128) -> Sight:
    """The sight of a scene on a grid of at most ``most_px`` rows and columns."""
    step = max(1, -(-max(camera.height_px, camera.width_px) // most_px))
    direction, shape = _rays(camera, step)
    origin = np.asarray(camera.position_mm, float)
    nearest = np.full(len(direction), np.inf)
    surface = np.full(len(direction), -1)
    normal = np.zeros_like(direction)
    for index, part in enumerate(scene.all_surfaces):
        for face in part.faces:
            triangle = part.vertices_mm[face]
            distance = _hits(origin, direction, triangle)
            closer = distance < nearest
            nearest[closer], surface[closer] = distance[closer], min(index, len(scene.surfaces))
            across = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
            normal[closer] = across / np.linalg.norm(across)
    place = origin + np.where(np.isfinite(nearest), nearest, 0.0)[:, None] * direction
    normal *= -np.sign(np.sum(normal * direction, axis=1, keepdims=True))
    direct = _direct(scene, place, normal)
    return Sight(
        step,
        surface.reshape(shape),
        place.reshape(*shape, 3),
        normal.reshape(*shape, 3),
        direct.reshape(shape),
    )


def _direct(scene: Scene, place: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    lamp = scene.lamp.surface
    total = np.zeros(len(place))
    inner = (np.arange(_LAMP_SAMPLES) + 0.5) / _LAMP_SAMPLES
    for face in lamp.faces:
        a, b, c = lamp.vertices_mm[face]
        across = np.cross(b - a, c - a)
        area = 0.5 * float(np.linalg.norm(across))
        facing = across / (2 * area)
        for s in inner:
            for t in inner:
                root = np.sqrt(s)
                source = (1 - root) * a + root * (1 - t) * b + root * t * c
                way = source - place
                square = np.maximum(np.sum(way**2, axis=1), 1e-6)
                cosines = np.maximum(np.sum(way * normal, axis=1), 0) * np.abs(way @ facing)
                total += area / _LAMP_SAMPLES**2 * cosines / square**2
    return total


def distance_to_surfaces(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) mm from points (n, 3) to the nearest triangle of scene or lamps."""
    nearest = np.full(len(points), np.inf)
    for part in scene.all_surfaces:
        for face in part.faces:
            nearest = np.minimum(nearest, _to_triangle(points, part.vertices_mm[face]))
    return nearest


def _to_triangle(points: NDArray[np.float64], triangle: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    height = (points - a) @ normal
    foot = points - height[:, None] * normal
    inside = np.ones(len(points), bool)
    rim = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= np.cross(edge, foot - start) @ normal >= -1e-9
        share = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-12), 0, 1)
        rim = np.minimum(rim, np.linalg.norm(points - start - share[:, None] * edge, axis=1))
    return np.where(inside, np.abs(height), rim)


def radiance_over_lamp(
    scene: Scene,
    place_mm: NDArray[np.float64],
    normal: NDArray[np.float64],
    surface: NDArray[np.int64],
    reflectance: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(n, band) radiance of points over the lamp's, to about 2 % in the mean of some hundred points.

    place_mm, normal : (n, 3), normal towards the lit side. surface : (n,) index into the scene's surfaces.
    reflectance : (surface, band). Lambertian surfaces; one lamp, which reflects nothing.
    """
    draw = np.random.default_rng(0)
    parts = [
        (index, part.vertices_mm[part.faces])
        for index, part in enumerate((*scene.surfaces, scene.lamp.surface))
        if len(part.faces) <= _MOST_TRIANGLES
    ]
    triangles = np.concatenate([faces for _, faces in parts])
    owner = np.repeat([index for index, _ in parts], [len(faces) for _, faces in parts])
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    path = np.repeat(np.arange(len(place_mm)), _PATHS)
    position, facing, on = place_mm[path], normal[path], surface[path]
    weight = reflectance[on] / _PATHS
    total = np.zeros((len(place_mm), reflectance.shape[1]))
    for _ in range(_REFLECTIONS):
        start = position + _OFFSET_MM * facing
        light = _light_of_lamp(scene.lamp.surface.vertices_mm[scene.lamp.surface.faces], triangles, start, facing, draw)
        np.add.at(total, path, weight * light[:, None] / np.pi)
        direction = _cosine(facing, draw)
        nearest, triangle = np.full(len(start), np.inf), np.zeros(len(start), int)
        for index, one in enumerate(triangles):
            distance = _hits(start, direction, one)
            closer = distance < nearest
            nearest[closer], triangle[closer] = distance[closer], index
        goes_on = np.isfinite(nearest) & (owner[triangle] < len(scene.surfaces))
        position = (start + np.where(goes_on, nearest, 0.0)[:, None] * direction)[goes_on]
        facing = across[triangle[goes_on]]
        facing = facing * -np.sign(np.sum(facing * direction[goes_on], axis=1, keepdims=True))
        path, on = path[goes_on], owner[triangle[goes_on]]
        weight = weight[goes_on] * reflectance[on]
    return total


def _light_of_lamp(
    lamp: NDArray[np.float64],
    triangles: NDArray[np.float64],
    start: NDArray[np.float64],
    facing: NDArray[np.float64],
    draw: np.random.Generator,
) -> NDArray[np.float64]:
    """(n,) irradiance by a lamp of radiance 1, estimated with one shadow ray each, sr."""
    across = np.cross(lamp[:, 1] - lamp[:, 0], lamp[:, 2] - lamp[:, 0])
    areas = 0.5 * np.linalg.norm(across, axis=1)
    chosen = draw.choice(len(lamp), len(start), p=areas / areas.sum())
    u, v = draw.random((2, len(start)))
    root = np.sqrt(u)[:, None]
    a, b, c = lamp[chosen].transpose(1, 0, 2)
    way = (1 - root) * a + root * (1 - v[:, None]) * b + root * v[:, None] * c - start
    square = np.sum(way**2, axis=1)
    normal = across[chosen] / (2 * areas[chosen])[:, None]
    cosines = np.maximum(np.sum(way * facing, axis=1), 0) * np.maximum(-np.sum(way * normal, axis=1), 0)
    free = np.ones(len(start), bool)
    for one in triangles:
        free &= ~(_hits(start, way, one) < 1 - 1e-6)
    return np.where(free, areas.sum() * cosines / square**2, 0.0)


def _cosine(facing: NDArray[np.float64], draw: np.random.Generator) -> NDArray[np.float64]:
    """(n, 3) unit directions about the normals, by the cosine law: a point on a sphere plus the normal."""
    point = draw.standard_normal(facing.shape)
    found = facing + (1 - 1e-9) * point / np.linalg.norm(point, axis=1, keepdims=True)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True), np.float64)
