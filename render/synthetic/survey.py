"""Simulated survey: visible points of the box and their measured image positions."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..visibility import Tracer, build_tracer, visible

__all__ = ["survey", "visible_points"]

#: Smallest distance of measurable points from the image's edge, px.
_MARGIN_PX = 1.5

#: Smallest cosine between surface normal and line of sight of measurable points.
_SMALLEST_COSINE = 0.1


def visible_points(scene: Scene, camera: Camera, count: int, generator: np.random.Generator) -> NDArray[np.float64]:
    """Points of the box that are visible to the camera and inside its image.

    Up to half of them are corners, the others random points on surfaces.

    Parameters
    ----------
    scene
        The box.
    camera
        The camera.
    count
        Number of points.
    generator
        Random numbers.

    Returns
    -------
    NDArray
        (count, 3) mm, rounded to 0.01 mm.

    Raises
    ------
    InputError
        If there are too few such points.
    """
    tracer = build_tracer(scene)
    corners = np.unique(scene.corners_mm.round(2), axis=0)
    corners = generator.permutation(corners[_is_visible(tracer, camera, corners)])[: (count + 1) // 2]
    groups, missing = [corners], count - len(corners)
    for _ in range(20):
        points, normals = _random_points(tracer, 8 * count, generator)
        sight = camera.position_mm - points
        cosine = np.einsum("ij,ij->i", sight, normals) / np.linalg.norm(sight, axis=1)
        points = points[cosine > _SMALLEST_COSINE]
        groups.append(points[_is_visible(tracer, camera, points)][:missing])
        missing -= len(groups[-1])
        if not missing:
            return generator.permutation(np.concatenate(groups))
    raise InputError(
        f"scene {scene.name}",
        f"{count - missing} points visible to the camera",
        f"{count}",
        "Does the camera look into the box?",
    )


def survey(
    scene: Scene, camera: Camera, count: int, sigma_px: float, generator: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and their measured image positions: projection plus Gaussian errors.

    Parameters
    ----------
    scene, camera, count
        As ``visible_points``.
    sigma_px
        Standard deviation of the errors, px.
    generator
        Random numbers.

    Returns
    -------
    points : NDArray
        (count, 3) mm.
    image : NDArray
        (count, 2) px.
    """
    points = visible_points(scene, camera, count, generator)
    return points, camera.project(points) + sigma_px * generator.standard_normal((count, 2))


def _random_points(
    tracer: Tracer, count: int, generator: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Uniform points (count, 3) over all surfaces but the lamp, to 0.01 mm, and their normals."""
    of_scene = tracer.surface < len(tracer.scene.surfaces)
    triangles, normals = tracer.vertices[of_scene], tracer.normals[of_scene]
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    triangle = generator.choice(len(areas), count, p=areas / areas.sum())
    barycentric = generator.random((count, 2))
    barycentric = np.where(barycentric.sum(axis=1, keepdims=True) > 1, 1 - barycentric, barycentric)
    points = triangles[triangle, 0] + np.einsum("ij,ijk->ik", barycentric, edges[triangle])
    return points.round(2), normals[triangle]


def _is_visible(tracer: Tracer, camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) True where a point is inside the image and not occluded."""
    if not len(points):
        return np.zeros(0, bool)
    image = camera.project(points)
    size = np.array([camera.width_px, camera.height_px])
    inside = np.all((image > _MARGIN_PX - 0.5) & (image < size - 0.5 - _MARGIN_PX), axis=1)
    origin = mi.Point3f(*(device_array(mi.Float, np.full(len(points), float(x))) for x in camera.position_mm))
    target = mi.Point3f(*(device_array(mi.Float, points[:, i]) for i in range(3)))
    free = np.array(visible(tracer, origin, target, dr.full(mi.Bool, True, len(points))))
    return inside & free
