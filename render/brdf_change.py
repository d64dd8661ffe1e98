"""What a paint's angular reflection adds to a picture beyond Lambert's: rough-diffuse and glossy paints.

Exact at the surface that the camera sees: direct light and light from the patches meet the changed
reflection there. At the reflection before, the lamp's own light does; all other counts as reflected diffusely
with the changed albedo.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from .final_gather import LightField
from .lamp import lamp_pattern, lamp_point
from .patches import patch_of
from .sampling import SobolPoints
from .tracer import RAY_OFFSET_MM, intersect, pixel_rays, visible

__all__ = ["Coat", "changed_reflection", "fresnel"]

Albedo = Callable[[mi.Float], tuple[mi.Float, mi.Float]]
Base = Callable[[mi.Vector3f, mi.Vector3f], mi.Float]


class Coat:
    """A specular coat: scale times Fresnel's reflectance (index 1.5) with a GGX lobe of the given alpha.

    Smith's separable masking; visible normals are sampled after Heitz, JCGT 7(4), 2018.
    """

    def __init__(self, scale: float, alpha: float) -> None:
        self.scale = dr.opaque(mi.Float, scale)
        self.alpha = dr.opaque(mi.Float, max(alpha, 1e-3))

    def value(self, incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        """Reflection function, 1/sr, in the surface's frame (z is the normal)."""
        half = dr.normalize(incoming + outgoing)
        both = self._masking(incoming) * self._masking(outgoing)
        below = 4 * incoming.z * outgoing.z
        value = self.scale * fresnel(dr.dot(incoming, half)) * self._density(half) * both / below
        return dr.select((incoming.z > 1e-6) & (outgoing.z > 1e-6), value, 0)

    def sample(self, outgoing: mi.Vector3f, u: mi.Float, v: mi.Float) -> mi.Vector3f:
        """A direction of incoming light, by the normals visible from ``outgoing``."""
        a = self.alpha
        stretched = dr.normalize(mi.Vector3f(a * outgoing.x, a * outgoing.y, outgoing.z))
        frame = mi.Frame3f(stretched)
        radius, angle = dr.sqrt(u), 2 * np.pi * v
        x, y = radius * dr.cos(angle), radius * dr.sin(angle)
        # the disc's far half is squeezed to the part of the ellipsoid in sight: along the frame's axis nearest to z
        up = dr.normalize(mi.Vector3f(0, 0, 1) - stretched * stretched.z + mi.Vector3f(1e-12, 0, 0))
        side = dr.select(stretched.z > 0.99999, frame.s, dr.cross(up, stretched))
        up = dr.cross(stretched, side)
        s = 0.5 * (1 + stretched.z)
        y = (1 - s) * dr.safe_sqrt(1 - x * x) + s * y
        normal = side * x + up * y + stretched * dr.safe_sqrt(1 - x * x - y * y)
        half = dr.normalize(mi.Vector3f(a * normal.x, a * normal.y, dr.maximum(normal.z, 1e-6)))
        return 2 * dr.dot(outgoing, half) * half - outgoing

    def density(self, incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        """Probability per steradian of ``sample``."""
        half = dr.normalize(incoming + outgoing)
        return dr.select(
            (incoming.z > 1e-6) & (outgoing.z > 1e-6),
            self._masking(outgoing) * self._density(half) / (4 * outgoing.z),
            0,
        )

    def albedo(self, cosine: NDArray, strata: int = 96) -> NDArray[np.float64]:
        """(n,) part of the light from directions at ``cosine`` (n,) to the normal that is reflected."""
        place = (np.arange(strata) + 0.5) / strata
        c, u, v = (
            mi.Float(x.astype(np.float32).ravel())
            for x in np.meshgrid(np.asarray(cosine, float), place, place, indexing="ij")
        )
        outgoing = mi.Vector3f(dr.safe_sqrt(1 - c * c), 0, c)
        incoming = self.sample(outgoing, u, v)
        pdf = self.density(incoming, outgoing)
        part = dr.select(pdf > 0, self.value(incoming, outgoing) * incoming.z / pdf, 0)
        return np.array(part, float).reshape(-1, strata**2).mean(axis=1)

    def _density(self, half: mi.Vector3f) -> mi.Float:
        square = self.alpha * self.alpha
        cosine = half.z * half.z
        return square / (np.pi * dr.square(cosine * (square - 1) + 1))

    def _masking(self, direction: mi.Vector3f) -> mi.Float:
        cosine = dr.maximum(direction.z * direction.z, 1e-12)
        tangent = dr.maximum(1 - cosine, 0) / cosine
        return 2 / (1 + dr.sqrt(1 + self.alpha * self.alpha * tangent))


def fresnel(cosine: mi.Float, index: float = 1.5) -> mi.Float:
    """Reflectance of a dielectric for unpolarised light; below the surface as at its horizon, where the formula has a
    pole."""
    cosine = dr.maximum(cosine, 0)
    g = dr.sqrt(index * index - 1 + cosine * cosine)
    a = dr.square((g - cosine) / (g + cosine))
    b = dr.square((cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1))
    return 0.5 * a * (1 + b)


def changed_reflection(
    light: LightField, camera: Camera, radiance: NDArray, reflectances: NDArray, material: int,
    base: Base, coat: Coat | None, samples: int = 256, seed: int = 0, albedo: Albedo | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Change (w, y, x) of radiance, over the lamp's, where the camera sees paint ``material``.

    radiance : (p, w) of the patches, over the lamp's. reflectances : (material, w) of all paints. base : diffuse
    reflection over Lambert's, as a function of the directions of incoming and outgoing light in the surface's frame.
    albedo : of base (over Lambert's) and coat for light from a cosine, which ``radiance`` holds for the lamp's; where
    given, what leaves a surface towards the surfaces that the camera sees gets its true direction.
    """
    tracer, patches = light.tracer, light.patches
    bands = radiance.shape[1]
    table = mi.Float(radiance.astype(np.float32).ravel())
    rho = [dr.opaque(mi.Float, float(r)) for r in reflectances[material]]
    table_rho = mi.Float(np.asarray(reflectances).astype(np.float32).ravel())
    count = camera.width_px * camera.height_px
    lane = dr.arange(mi.UInt32, count)
    rays = pixel_rays(camera, lane)
    points = SobolPoints(8 if albedo is None else 12, samples, lane, seed)

    def seen(hit, active) -> list[mi.Float]:
        on = hit.painted & active
        patch = patch_of(patches, hit.triangle, hit.uv, on)
        return [dr.gather(mi.Float, table, patch * bands + k, on) for k in range(bands)]

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        ray = rays(points.point(i, 4), points.point(i, 5))
        hit = intersect(tracer, ray)
        mine = hit.front & (hit.material == material)
        frame = mi.Frame3f(hit.normal)
        outgoing = frame.to_local(-ray.d)
        origin = hit.position + hit.normal * RAY_OFFSET_MM
        weight, to_lamp, per_area = lamp_point(
            light.lamp, origin, hit.normal, points.point(i, 2), points.point(i, 3), mine
        )
        incoming = frame.to_local(dr.normalize(to_lamp))
        free = visible(tracer, origin, origin + to_lamp, mine & (weight > 0))
        weight = dr.select(free, weight, 0)
        change = [r * weight * (base(incoming, outgoing) - 1) for r in rho]
        gathered = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 0), points.point(i, 1)))
        far = intersect(tracer, mi.Ray3f(origin, frame.to_world(gathered)), mine)
        factor = base(gathered, outgoing) - 1
        change = [c + r * factor * b for c, r, b in zip(change, rho, seen(far, mine), strict=True)]
        if coat is not None:
            u, v = points.point(i, 6), points.point(i, 7)
            lobe, strength, near, valid = mirrored(
                coat, frame, origin, incoming, outgoing, weight, per_area, u, v, mine
            )
            change = [
                c + lobe + dr.select(valid, strength * b, 0)
                for c, b in zip(change, seen(near, valid), strict=True)
            ]
        change = [dr.select(mine, c, 0) for c in change]
        if albedo is not None:
            change = [
                c + d for c, d in zip(change, turned(i, hit, origin, frame.to_world(gathered)), strict=True)
            ]
        return i + 1, [s + c for s, c in zip(sums, change, strict=True)]

    def mirrored(coat, frame, origin, incoming, outgoing, weight, per_area, u, v, active):
        """The lamp by the coat, by both ways of sampling; and the coat's own direction with its strength."""
        pdf = coat.density(incoming, outgoing)
        share = dr.select(per_area > 0, per_area / (per_area + pdf), 0)
        lobe = weight * np.pi * coat.value(incoming, outgoing) * share
        direction = coat.sample(outgoing, u, v)
        valid = active & (direction.z > 1e-6)
        pdf = coat.density(direction, outgoing)
        strength = dr.select(pdf > 0, coat.value(direction, outgoing) * direction.z / pdf, 0)
        near = intersect(tracer, mi.Ray3f(origin, frame.to_world(direction)), valid)
        lamp_cosine = -dr.dot(frame.to_world(direction), light.lamp.normal)
        lamp_pdf = dr.square(near.distance) / (light.lamp.area * dr.maximum(lamp_cosine, 1e-6))
        glow = lamp_pattern(light.lamp, near.position, lamp_cosine)
        return (
            lobe + dr.select(near.on_lamp, strength * glow * pdf / (pdf + lamp_pdf), 0),
            strength,
            near,
            valid,
        )

    def turned(i, hit, origin, direction) -> list[mi.Float]:
        """The lamp's light by way of the paint: what leaves it this way less the mean over all ways."""
        assert albedo is not None
        far = intersect(tracer, mi.Ray3f(origin, direction), hit.painted)
        theirs = far.front & (far.material == material)
        frame = mi.Frame3f(far.normal)
        outgoing = frame.to_local(-direction)
        there = far.position + far.normal * RAY_OFFSET_MM
        weight, to_lamp, per_area = lamp_point(
            light.lamp, there, far.normal, points.point(i, 8), points.point(i, 9), theirs
        )
        incoming = frame.to_local(dr.normalize(to_lamp))
        weight = dr.select(visible(tracer, there, there + to_lamp, theirs & (weight > 0)), weight, 0)
        base_mean, coat_mean = albedo(incoming.z)
        diffuse, lobe = weight * (base(incoming, outgoing) - base_mean), -weight * coat_mean
        if coat is not None:
            u, v = points.point(i, 10), points.point(i, 11)
            lobe += mirrored(coat, frame, there, incoming, outgoing, weight, per_area, u, v, theirs)[0]
        entry = hit.material * bands
        first = [dr.gather(mi.Float, table_rho, entry + k, hit.painted) for k in range(bands)]
        return [dr.select(theirs, f * (r * diffuse + lobe), 0) for f, r in zip(first, rho, strict=True)]

    total = dr.opaque(mi.UInt32, samples)
    start = (dr.zeros(mi.UInt32, count), [dr.zeros(mi.Float, count) for _ in range(bands)])
    _, sums = dr.while_loop(start, lambda i, _: i < total, body)
    dr.eval(sums)
    return np.stack([np.array(s) for s in sums]).reshape(bands, camera.height_px, camera.width_px) / samples
