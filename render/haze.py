"""Light in the air: the mean radiance at points of the room, from all directions."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from .final_gather import LightField
from .lamp import lamp_point
from .patches import patch_of
from .sampling import SobolPoints
from .tracer import intersect, visible

__all__ = ["mean_radiance"]


def mean_radiance(
    light: LightField, radiance: NDArray, points_mm: NDArray, samples: int = 512, seed: int = 0
) -> NDArray[np.float64]:
    """(m, w) radiance averaged over all directions at points (m, 3), over the lamp's own radiance.

    radiance : (p, w) of the patches, over the lamp's. The lamp itself is sampled by area, with its pattern.
    """
    tracer, count, bands = light.tracer, len(points_mm), radiance.shape[1]
    table = mi.Float(radiance.astype(np.float32).ravel())
    x, y, z = (mi.Float(points_mm[:, i].astype(np.float32)) for i in range(3))
    point = mi.Point3f(x, y, z)
    random = SobolPoints(4, samples, dr.arange(mi.UInt32, count), seed)
    surfaces = len(tracer.scene.surfaces)

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        direction = mi.warp.square_to_uniform_sphere(mi.Point2f(random.point(i, 0), random.point(i, 1)))
        hit = intersect(tracer, mi.Ray3f(point, direction))
        lit = hit.front & (dr.gather(mi.UInt32, tracer.packed_surface, hit.triangle, hit.front) < surfaces)
        patch = patch_of(light.patches, hit.triangle, hit.uv, lit)
        seen = [dr.gather(mi.Float, table, patch * bands + k, lit) for k in range(bands)]
        # a receiver turned towards the lamp's point: its form factor times pi is the solid angle's share of radiance
        _, way, _ = lamp_point(
            light.lamp, point, -light.lamp.normal, random.point(i, 2), random.point(i, 3), mi.Bool(True)
        )
        facing = dr.normalize(way)
        weight, way, _ = lamp_point(
            light.lamp, point, facing, random.point(i, 2), random.point(i, 3), mi.Bool(True)
        )
        free = visible(tracer, point, point + way, weight > 0)
        from_lamp = dr.select(free, weight / 4, 0)
        return i + 1, [s + value + from_lamp for s, value in zip(sums, seen, strict=True)]

    total = dr.opaque(mi.UInt32, samples)
    start = (dr.zeros(mi.UInt32, count), [dr.zeros(mi.Float, count) for _ in range(bands)])
    _, sums = dr.while_loop(start, lambda i, _: i < total, body)
    dr.eval(sums)
    return np.stack([np.array(s) for s in sums], axis=1).astype(float) / samples
