"""How bright the surfaces of a known scene must be by the lamp, with interreflection: a rough path tracer."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes import Scene
from numpy.typing import NDArray

from .sight import hits

__all__ = ["radiance_over_lamp"]

#: Surfaces of more triangles take too long and are left out: they send back and block little light.
_MOST_TRIANGLES = 200

_PATHS, _REFLECTIONS = 16, 9
_OFFSET_MM = 0.01


def radiance_over_lamp(
    scene: Scene,
    place_mm: NDArray[np.float64],
    normal: NDArray[np.float64],
    surface: NDArray[np.int64],
    reflectance: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(n, band) radiance of points over the lamp's, to about 2 % in the mean of some hundred points.

    place_mm, normal : (n, 3), normal towards the lit side. surface : (n,) index into the scene's surfaces.
    reflectance : (surface, band). Lambertian surfaces; a lamp that reflects nothing.
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
        light = _direct(
            scene.lamp.surface.vertices_mm[scene.lamp.surface.faces], triangles, start, facing, draw
        )
        np.add.at(total, path, weight * light[:, None] / np.pi)
        direction = _cosine(facing, draw)
        nearest, triangle = np.full(len(start), np.inf), np.zeros(len(start), int)
        for index, one in enumerate(triangles):
            distance = hits(start, direction, one)
            closer = distance < nearest
            nearest[closer], triangle[closer] = distance[closer], index
        goes_on = np.isfinite(nearest) & (owner[triangle] < len(scene.surfaces))
        position = (start + np.where(goes_on, nearest, 0.0)[:, None] * direction)[goes_on]
        facing = across[triangle[goes_on]]
        facing = facing * -np.sign(np.sum(facing * direction[goes_on], axis=1, keepdims=True))
        path, on = path[goes_on], owner[triangle[goes_on]]
        weight = weight[goes_on] * reflectance[on]
    return total


def _direct(
    lamp: NDArray[np.float64], triangles: NDArray[np.float64], start: NDArray[np.float64],
    facing: NDArray[np.float64], draw: np.random.Generator,
) -> NDArray[np.float64]:  # fmt: skip
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
        free &= ~(hits(start, way, one) < 1 - 1e-6)
    return np.where(free, areas.sum() * cosines / square**2, 0.0)


def _cosine(facing: NDArray[np.float64], draw: np.random.Generator) -> NDArray[np.float64]:
    """(n, 3) unit directions about the normals, by the cosine law: a point on a sphere plus the normal."""
    point = draw.standard_normal(facing.shape)
    found = facing + (1 - 1e-9) * point / np.linalg.norm(point, axis=1, keepdims=True)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True), np.float64)
