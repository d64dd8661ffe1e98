"""Faces that rays around a pixel meet first, and light on them, in double precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates, maximum_filter, minimum_filter

from .form_factor import point_to_polygon
from .seen_lamps import part_of_lamps

__all__ = ["MARGIN_PX", "RAYS_ACROSS", "FaceLight", "faces_around", "light_around"]

#: Pixels around a corner whose faces are computed, px: the square, the shift and the blur.
MARGIN_PX = 13

#: Rays across a pixel, odd so that one is at its centre. An edge along the rows is then known to 0.06 px.
RAYS_ACROSS = 9

#: Distance across a pixel of points at which the light of the lamps is computed, as a part of 1: three a pixel.
_LIGHT_ACROSS = 3

#: Smallest scatter of the part of the lamps that a face sees, for a shadow on it.
_LEAST_SHADOW = 0.02

#: Smallest scatter of the form factor to another face: a smaller one is as a polynomial.
_LEAST_NEAR_LIGHT = 0.01

#: Distance of a plane at which a point lies in it, mm: its normal is rounded.
_IN_PLANE_MM = 0.5

#: Distance towards the camera at which light is computed, as a part of the way: else a face would shade itself.
_OFF_THE_FACE = 1e-5


@dataclass(frozen=True, eq=False)
class FaceLight:
    """Light on a face around a corner that is no polynomial."""

    #: Number of the face.
    face: int
    #: (n, n) the light at each ray; beyond the rim of the face, as at its nearest point.
    shape: NDArray[np.float64]
    #: Whether it multiplies the polynomial of the face's brightness; otherwise it has one level.
    is_factor: bool


def faces_around(scene: Scene, camera: Camera, middle: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the flat face that each ray around a pixel meets first.

    Parameters
    ----------
    scene
        Model of the scene.
    camera
        The camera.
    middle
        (2,) pixel u, v.

    Returns
    -------
    NDArray
        (n, n) numbers from 1; 0 for none.
    """
    pixels = 2 * MARGIN_PX + 1
    first = middle - MARGIN_PX - 0.5
    # by rays at the pixels' corners: pixels in which an edge may be; only there are all rays traced
    across = np.arange(-1, pixels + 2)
    coarse = _first_met(scene, camera, middle, *np.meshgrid(first[0] + across, first[1] + across))[0]
    is_mixed = maximum_filter(coarse, 4, origin=-1) != minimum_filter(coarse, 4, origin=-1)
    rays = (np.arange(RAYS_ACROSS) + 0.5) / RAYS_ACROSS
    row, column = np.nonzero(is_mixed[:pixels, :pixels])
    number = np.repeat(np.repeat(coarse[1:-2, 1:-2], RAYS_ACROSS, axis=0), RAYS_ACROSS, axis=1)
    u = first[0] + column[:, None, None] + rays
    v = first[1] + row[:, None, None] + rays[:, None]
    blocks = number.reshape(pixels, RAYS_ACROSS, pixels, RAYS_ACROSS).swapaxes(1, 2)
    blocks[row, column] = _first_met(scene, camera, middle, *np.broadcast_arrays(u, v))[0]
    return number


def _first_met(
    scene: Scene, camera: Camera, middle: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Number of the flat face that each ray (u, v) meets first, 0 for none.

    Then (n, 3) where, and (k, 4) planes of the faces: the normal n and n . p, rounded.
    """
    direction = camera.directions(u.ravel(), v.ravel())
    nearest, number = np.full(len(direction), np.inf), np.zeros(len(direction), np.int64)
    flat: dict[tuple[float, ...], int] = {}
    for surface in scene.all_surfaces:
        for face in surface.faces:
            corners = surface.vertices_mm[face]
            if not _may_be_seen(camera, corners, middle):
                continue
            a, b, c = corners
            normal = np.cross(b - a, c - a)
            length = float(np.linalg.norm(normal))
            if length == 0:
                continue
            key = (*(normal / length).round(3), round(float(a @ normal) / length, 1))
            from_a = camera.position_mm - a
            turned = np.cross(from_a, b - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = direction @ np.cross(c - a, b - a)
                first, second = direction @ np.cross(c - a, from_a) / slope, direction @ turned / slope
                distance = float((c - a) @ turned) / slope
            hit = (first >= -1e-9) & (second >= -1e-9) & (first + second <= 1 + 1e-9) & (distance > 1e-6)
            nearer = hit & (distance < nearest)
            nearest[nearer] = distance[nearer]
            number[nearer] = flat.setdefault(key, len(flat) + 1)
    travelled = np.where(number > 0, nearest, 0.0) * (1 - _OFF_THE_FACE)
    planes = np.array([*flat]).reshape(-1, 4)
    return number.reshape(u.shape), camera.position_mm + travelled[:, None] * direction, planes


def _may_be_seen(camera: Camera, triangle_mm: NDArray[np.float64], middle: NDArray[np.int64]) -> bool:
    """Whether the image of a triangle may reach the rays around a pixel."""
    image = camera.project(triangle_mm)
    if not np.isfinite(image).all():
        return True  # partly behind the camera
    reach = MARGIN_PX + 2
    return bool(np.all(image.max(axis=0) > middle - reach) and np.all(image.min(axis=0) < middle + reach))


def light_around(
    scene: Scene, camera: Camera, middle: NDArray[np.int64], corner_mm: NDArray[np.float64]
) -> list[FaceLight]:
    """Half shadows on the faces around a corner, and light of the faces on each other.

    Parameters
    ----------
    scene, camera, middle
        As of `faces_around`.
    corner_mm
        (3,) corner in the box, mm.

    Returns
    -------
    list of FaceLight
        Those that vary by more than a polynomial would.
    """
    size = (2 * MARGIN_PX + 1) * _LIGHT_ACROSS
    at = (np.arange(size) + 0.5) / _LIGHT_ACROSS - MARGIN_PX - 0.5
    u, v = np.meshgrid(middle[0] + at, middle[1] + at)
    number, positions, planes = _first_met(scene, camera, middle, u, v)
    positions = positions.reshape(*number.shape, 3)
    rays = (np.arange(size * RAYS_ACROSS // _LIGHT_ACROSS) + 0.5) * _LIGHT_ACROSS / RAYS_ACROSS - 0.5
    grid = np.meshgrid(rays, rays, indexing="ij")
    lights = []
    for face in np.unique(number[number > 0]):
        of_face = number == face
        points, plane = positions[of_face], planes[face - 1]
        shapes = [(part_of_lamps(scene, points), True, _LEAST_SHADOW)]
        if abs(corner_mm @ plane[:3] - plane[3]) < _IN_PLANE_MM:
            plane = plane * np.sign(camera.position_mm @ plane[:3] - plane[3])
            shapes += [(light, False, _LEAST_NEAR_LIGHT) for light in _near_light(scene, corner_mm, plane, points)]
        nearest = tuple(distance_transform_edt(~of_face, return_distances=False, return_indices=True))
        for values, is_factor, least in shapes:
            if np.std(values) > least:
                light = np.zeros(number.shape)
                light[of_face] = values
                at_rays = map_coordinates(light[nearest], grid, order=1, mode="nearest")
                lights.append(FaceLight(int(face), np.asarray(at_rays, np.float64), is_factor))
    return lights


def _near_light(
    scene: Scene, corner_mm: NDArray[np.float64], plane: NDArray[np.float64], points: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """(n,) form factors from points of a plane to each face that meets it at a corner.

    The plane is (n, n . p), and all of the face is in front of it. So the floor has those of a block's faces; the floor
    lies on both sides of the block's.
    """
    factors: dict[tuple[float, ...], NDArray[np.float64]] = {}
    for corners in np.concatenate([surface.vertices_mm[surface.faces] for surface in scene.surfaces]):
        a, b, c = corners
        normal = np.cross(b - a, c - a)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
        height = corners @ plane[:3] - plane[3]
        is_at_corner = abs((corner_mm - a) @ normal) < _IN_PLANE_MM
        if is_at_corner and height.min() > -_IN_PLANE_MM and height.max() > _IN_PLANE_MM:
            factor = np.where((points - a) @ normal > 0, point_to_polygon(points, plane[:3], corners), 0.0)
            key = tuple(normal.round(3))
            factors[key] = factors.get(key, 0.0) + factor
    return [*factors.values()]
