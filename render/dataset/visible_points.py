"""Visible points: depth, position, normal and surface at pixel centres, and shadows.

The ray's triangle is found by the kernel, in single precision. Its point is then computed in double precision from the
triangle's plane, or from the sphere of a ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from ..device import SobolPoints, device_array, dr, mi
from ..image import NOTHING
from ..radiosity import MixedSurface, build_lamp_samplers, build_mixtures, lamp_point
from ..visibility import RAY_OFFSET_MM, build_tracer, intersect, pixel_rays, visible

__all__ = ["VisiblePoints", "mixed_pixels", "shadow_fraction", "visible_points"]

#: Rays of a pixel towards each lamp.
SHADOW_SAMPLES = 64

#: Rays along each edge of a pixel, over whose points the shares of a texture are averaged.
TEXTURE_RAYS = 16


@dataclass(frozen=True, eq=False)
class VisiblePoints:
    """Points on the rays through pixel centres; NaN or NOTHING where they meet no lit side."""

    #: (y, x, 3) point, mm.
    position_mm: NDArray[np.float64]
    #: (y, x, 3) unit normal, towards the lit side.
    normal: NDArray[np.float64]
    #: (y, x) distance from the camera's centre along its axis, mm.
    depth_mm: NDArray[np.float64]
    #: (y, x) index of the surface; the number of surfaces for lamps, NOTHING for none.
    surface: NDArray[np.int16]


def visible_points(scene: Scene, camera: Camera) -> VisiblePoints:
    """Points that the rays through the pixel centres of a camera meet.

    Parameters
    ----------
    scene
        The scene.
    camera
        The camera.

    Returns
    -------
    VisiblePoints
        The points.
    """
    tracer = build_tracer(scene)
    shape = camera.height_px, camera.width_px
    rows, columns = np.indices(shape)
    directions = camera.directions(columns, rows).reshape(-1, 3)
    pixel = dr.arange(mi.UInt32, len(directions))
    hit = intersect(tracer, pixel_rays(camera, pixel)(mi.Float(0.5), mi.Float(0.5)), coherent=True)
    dr.eval(hit.front, hit.triangle)  # together: one kernel
    front, triangle = np.array(hit.front), np.array(hit.triangle)
    triangle = np.where(front, triangle, 0)
    normal = tracer.normals[triangle]
    corner = tracer.vertices[triangle, 0]
    surface = tracer.surface[triangle]
    eye = camera.position_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.sum((corner - eye) * normal, axis=1) / np.sum(directions * normal, axis=1)
    for index, item in enumerate(scene.surfaces):
        if scene.meets_sphere(item):
            on = front & (surface == index)
            centre, radius = item.sphere_mm
            along = directions[on] @ (centre - eye)
            root = along**2 - np.sum((centre - eye) ** 2) + radius**2
            distance[on] = along - np.sqrt(np.maximum(root, 0.0))
            normal[on] = (eye + distance[on, None] * directions[on] - centre) / radius
    position = eye + distance[:, None] * directions
    depth = (position - eye) @ camera.rotation[2]
    hidden = ~front
    position[hidden], normal[hidden], depth[hidden] = np.nan, np.nan, np.nan
    surface = np.where(front, surface, NOTHING).astype(np.int16)
    return VisiblePoints(
        position.reshape(*shape, 3), normal.reshape(*shape, 3), depth.reshape(shape), surface.reshape(shape)
    )


def shadow_fraction(scene: Scene, camera: Camera, seed: int, samples: int = SHADOW_SAMPLES) -> NDArray[np.float32]:
    """Share of each lamp's light that other surfaces keep from the surfaces in each pixel.

    Points of the pixel and of the lamp are sampled together; the share is that of the blocked form factor in the sum
    over all of them. It is exactly 0 in full light and exactly 1 in full shadow.

    Parameters
    ----------
    scene
        The scene.
    camera
        The camera.
    seed
        Seed of the random numbers.
    samples
        Samples of a pixel.

    Returns
    -------
    NDArray
        (lamp, y, x) share, 0 to 1; NaN where no surface seen faces the lamp.
    """
    tracer = build_tracer(scene)
    count = camera.width_px * camera.height_px
    pixel = device_array(mi.UInt32, np.arange(count))
    rays = pixel_rays(camera, pixel)
    shares = []
    for index, lamp in enumerate(build_lamp_samplers(tracer)):
        points = SobolPoints(4, samples, pixel, (seed ^ 0x51AD) + 6007 * index)

        def body(i: mi.UInt32, blocked: mi.Float, total: mi.Float, lamp=lamp, points=points) -> tuple:  # type: ignore
            hit = intersect(tracer, rays(points.point(i, 0), points.point(i, 1)), coherent=True)
            surface = hit.front & ~hit.on_lamp
            origin = hit.position + hit.normal * RAY_OFFSET_MM
            weight, offset, _ = lamp_point(lamp, origin, hit.normal, points.point(i, 2), points.point(i, 3), surface)
            free = visible(tracer, origin, origin + offset, surface & (weight > 0), enclosed=True)
            return i + 1, blocked + dr.select(free, 0, weight), total + weight

        last = dr.opaque(mi.UInt32, samples)
        start = (dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count), dr.zeros(mi.Float, count))
        _, blocked, total = dr.while_loop(start, lambda i, *_: i < last, body)  # noqa: B023
        dr.eval(blocked, total)
        light, dark = np.array(total), np.array(blocked)
        shares.append(np.divide(dark, light, out=np.full(count, np.nan, np.float32), where=light > 0))
    return np.stack(shares).reshape(-1, camera.height_px, camera.width_px)


def mixed_pixels(scene: Scene, camera: Camera) -> dict[int, NDArray[np.float64]]:
    """Mean shares of the materials of mixed surfaces in the pixels of a camera.

    Each pixel has a grid of rays. A pixel without a point of a surface has the surface's mean shares.

    Parameters
    ----------
    scene
        Scene of ``mixed_scenes``.
    camera
        The camera.

    Returns
    -------
    dict
        (y, x, k) mean share of each material of a surface, by the index of the mixed surface.
    """
    tracer = build_tracer(scene)
    mixtures = build_mixtures(tracer)
    if mixtures is None:
        return {}
    mixed = {number: s for number, s in enumerate(scene.surfaces) if isinstance(s, MixedSurface)}
    count, lanes = len(tracer.material_names), camera.width_px * camera.height_px
    of_triangle = device_array(mi.UInt32, tracer.surface)
    rays = pixel_rays(camera, dr.arange(mi.UInt32, lanes))
    columns = {n: [tracer.material_names.index(part) for part in s.parts] for n, s in mixed.items()}

    def body(i: mi.UInt32, sums: list[list[mi.Float]]) -> tuple:
        u, v = (mi.Float(i % TEXTURE_RAYS) + 0.5) / TEXTURE_RAYS, (mi.Float(i // TEXTURE_RAYS) + 0.5) / TEXTURE_RAYS
        hit = intersect(tracer, rays(u, v), coherent=True)
        surface = dr.gather(mi.UInt32, of_triangle, hit.triangle, hit.reflecting)
        shares = mixtures.shares(hit, count, hit.reflecting)
        more = []
        for (number, indices), old in zip(columns.items(), sums, strict=True):
            on = hit.reflecting & (surface == number)
            new = [mi.Float(1), *(shares[m] for m in indices)]
            more.append([a + dr.select(on, b, 0) for a, b in zip(old, new, strict=True)])
        return i + 1, more

    last = dr.opaque(mi.UInt32, TEXTURE_RAYS**2)
    zeros = [[dr.zeros(mi.Float, lanes) for _ in range(1 + len(indices))] for indices in columns.values()]
    _, sums = dr.while_loop((dr.zeros(mi.UInt32, lanes), zeros), lambda i, *_: i < last, body)
    dr.eval(sums)
    result = {}
    for (number, surface), (hits, *parts) in zip(mixed.items(), sums, strict=True):
        points = np.array(hits, np.float64)[:, None]
        total = np.stack([np.array(part, np.float64) for part in parts], axis=-1)
        means = np.broadcast_to(surface.shares.mean(axis=(0, 1)), total.shape)
        shares = np.divide(total, points, out=means.copy(), where=points > 0)
        result[number] = shares.reshape(camera.height_px, camera.width_px, -1)
    return result
