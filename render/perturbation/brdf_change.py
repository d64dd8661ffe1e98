"""Change of a picture by a non-Lambertian material, rough or glossy.

At the surface that the camera sees and at the reflection before, the changed reflection is applied to direct light and
to light from the patches. At earlier ones light is treated as diffusely reflected with the changed albedo.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..device import SobolPoints, device_array, dr, mi
from ..radiosity import LampSampler, PatchedScene, lamp_point, lamp_seen, patch_of
from ..visibility import RAY_OFFSET_MM, Hit, intersect, pixel_rays, visible
from .patch_light import PatchLight

__all__ = ["Coat", "Reflection", "changed_reflection", "fresnel", "with_reflection"]

#: Angles by which light from all directions is summed.
_COSINES = 256

Albedo: TypeAlias = "Callable[[mi.Float], tuple[mi.Float, mi.Float]]"
Sample: TypeAlias = "Callable[[SobolPoints, mi.UInt32, mi.Ray3f], list[mi.Float]]"
Base: TypeAlias = "Callable[[mi.Vector3f, mi.Vector3f], mi.Float]"


@dataclass(frozen=True, eq=False)
class Reflection:
    """A reflection in place of Lambert's.

    base : diffuse BRDF relative to Lambert's, as a function of the directions of incoming and outgoing light in the
    surface's frame. coat : a specular one above it. albedo : albedos of base (relative to Lambert's) and coat for light
    from a cosine.
    """

    base: Base
    coat: Coat | None = None
    albedo: Albedo | None = None


@dataclass
class _Arriving:
    """Light from a point of a lamp: form factor, direction in the surface's frame, density of the direction, 1/sr."""

    lamp: LampSampler
    weight: mi.Float
    incoming: mi.Vector3f
    per_area: mi.Float


class Coat:
    """A specular coat: scale times the Fresnel reflectance (index 1.5) with a GGX lobe of roughness alpha.

    Smith's separable masking; visible normals are sampled after Heitz, JCGT 7(4), 2018.
    """

    def __init__(self, scale: float, alpha: float) -> None:
        self.scale = dr.opaque(mi.Float, scale)
        self.alpha = dr.opaque(mi.Float, max(alpha, 1e-3))

    def value(self, incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        """BRDF, 1/sr, in the surface's frame (z is the normal)."""
        half = dr.normalize(incoming + outgoing)
        both = self._masking(incoming) * self._masking(outgoing)
        below = 4 * incoming.z * outgoing.z
        value = self.scale * fresnel(dr.dot(incoming, half)) * self._density(half) * both / below
        return dr.select((incoming.z > 1e-6) & (outgoing.z > 1e-6), value, 0)

    def sample(self, outgoing: mi.Vector3f, u: mi.Float, v: mi.Float) -> mi.Vector3f:
        """A sampled direction of incoming light, from the normals visible from ``outgoing``."""
        a = self.alpha
        stretched = dr.normalize(mi.Vector3f(a * outgoing.x, a * outgoing.y, outgoing.z))
        frame = mi.Frame3f(stretched)
        radius, angle = dr.sqrt(u), 2 * np.pi * v
        x, y = radius * dr.cos(angle), radius * dr.sin(angle)
        # Heitz: the disc is warped to the visible part of the ellipsoid, along the frame's axis closest to z.
        up = dr.normalize(mi.Vector3f(0, 0, 1) - stretched * stretched.z + mi.Vector3f(1e-12, 0, 0))
        side = dr.select(stretched.z > 0.99999, frame.s, dr.cross(up, stretched))
        up = dr.cross(stretched, side)
        s = 0.5 * (1 + stretched.z)
        y = (1 - s) * dr.safe_sqrt(1 - x * x) + s * y
        normal = side * x + up * y + stretched * dr.safe_sqrt(1 - x * x - y * y)
        half = dr.normalize(mi.Vector3f(a * normal.x, a * normal.y, dr.maximum(normal.z, 1e-6)))
        return 2 * dr.dot(outgoing, half) * half - outgoing

    def density(self, incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        """Probability density of ``sample``, 1/sr."""
        half = dr.normalize(incoming + outgoing)
        return dr.select(
            (incoming.z > 1e-6) & (outgoing.z > 1e-6),
            self._masking(outgoing) * self._density(half) / (4 * outgoing.z),
            0,
        )

    def albedo(self, cosine: NDArray, strata: int = 96) -> NDArray[np.float64]:
        """(n,) directional albedo (0 to 1) for light at ``cosine`` (n,) to the normal."""
        place = (np.arange(strata) + 0.5) / strata
        c, u, v = (
            device_array(mi.Float, x) for x in np.meshgrid(np.asarray(cosine, float), place, place, indexing="ij")
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
    """Reflectance of a dielectric for unpolarised light (Fresnel); a negative cosine is set to 0."""
    cosine = dr.maximum(cosine, 0)
    g = dr.sqrt(index * index - 1 + cosine * cosine)
    a = dr.square((g - cosine) / (g + cosine))
    b = dr.square((cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1))
    return 0.5 * a * (1 + b)


def _for_diffuse_light(albedo: Albedo) -> list[mi.Float]:
    """The albedos of base and coat for light that is equally bright from all directions."""
    cosine = (np.arange(_COSINES) + 0.5) / _COSINES
    each = albedo(device_array(mi.Float, cosine))
    return [dr.opaque(mi.Float, float(np.mean(2 * cosine * np.array(mean, float)))) for mean in each]


def changed_reflection(
    light: PatchedScene,
    camera: Camera,
    radiance: NDArray,
    reflectances: NDArray,
    lamp_shares: NDArray,
    reflection: Reflection,
    *,
    material: int,
    seen_in: NDArray[np.int64],
    samples: tuple[int, int] = (256, 256),
    seed: int = 0,
) -> NDArray[np.float64]:
    """Change (w, y, x) of radiance, relative to the lamps' mean, for a changed reflection of one ``material``.

    radiance : (p, w) of the patches, relative to the lamps' mean. reflectances : (material, w) of all materials
    and of the lamps. lamp_shares : (lamps, w) radiance of each lamp relative to their mean. reflection : if it has
    albedos, which ``radiance`` includes, the light reflected towards the surfaces seen by the camera gets the
    directional distribution of the changed reflection. seen_in : (n,) pixels that see the material, counted along the
    rows. samples : rays of each of these, and of all pixels for the reflection before, which the last one spreads.
    """
    tracer, patches = light.tracer, light.patches
    base, coat, albedo = reflection.base, reflection.coat, reflection.albedo
    bands = radiance.shape[1]
    table = device_array(mi.Float, radiance)
    rho = [dr.opaque(mi.Float, float(r)) for r in reflectances[material]]
    table_rho = device_array(mi.Float, reflectances)
    shares = [[dr.opaque(mi.Float, float(s)) for s in row] for row in lamp_shares]
    count = camera.width_px * camera.height_px

    def seen(hit: Hit, active: mi.Bool) -> list[mi.Float]:
        on = hit.reflecting & active
        patch = patch_of(patches, hit.triangle, hit.uv, on)
        return [dr.gather(mi.Float, table, patch * bands + k, on) for k in range(bands)]

    def at_surface(points: SobolPoints, i: mi.UInt32, ray: mi.Ray3f) -> list[mi.Float]:
        """The change at the surface that the camera sees."""
        hit = intersect(tracer, ray)
        mine = hit.front & (hit.material == material)
        frame = mi.Frame3f(hit.normal)
        outgoing = frame.to_local(-ray.d)
        origin = hit.position + hit.normal * RAY_OFFSET_MM
        arriving = from_lamps(frame, origin, points.point(i, 2), points.point(i, 3), mine)
        change = [mi.Float(0) for _ in rho]
        for one, own in zip(arriving, shares, strict=True):
            beyond = one.weight * (base(one.incoming, outgoing) - 1)
            change = [c + r * s * beyond for c, r, s in zip(change, rho, own, strict=True)]
        gathered = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 0), points.point(i, 1)))
        far = intersect(tracer, mi.Ray3f(origin, frame.to_world(gathered)), mine)
        factor = base(gathered, outgoing) - 1
        change = [c + r * factor * b for c, r, b in zip(change, rho, seen(far, mine), strict=True)]
        if coat is not None:
            u, v = points.point(i, 6), points.point(i, 7)
            lobes, strength, near, valid = mirrored(coat, frame, origin, arriving, outgoing, u=u, v=v, active=mine)
            change = [
                c + lobe + dr.select(valid, strength * b, 0)
                for c, lobe, b in zip(change, lobes, seen(near, valid), strict=True)
            ]
        return [dr.select(mine, c, 0) for c in change]

    def from_lamps(frame: mi.Frame3f, origin: mi.Point3f, u: mi.Float, v: mi.Float, active: mi.Bool) -> list[_Arriving]:
        """One point of each lamp, as light that arrives at ``origin``."""
        found = []
        for lamp in light.lamps:
            weight, to_lamp, per_area = lamp_point(lamp, origin, frame.n, u, v, active)
            incoming = frame.to_local(dr.normalize(to_lamp))
            free = visible(tracer, origin, origin + to_lamp, active & (weight > 0), enclosed=True)
            found.append(_Arriving(lamp, dr.select(free, weight, 0), incoming, per_area))
        return found

    def mirrored(
        coat: Coat,
        frame: mi.Frame3f,
        origin: mi.Point3f,
        arriving: list[_Arriving],
        outgoing: mi.Vector3f,
        *,
        u: mi.Float,
        v: mi.Float,
        active: mi.Bool,
    ) -> tuple[list[mi.Float], mi.Float, Hit, mi.Bool]:
        """The lamps' light by the coat (multiple importance sampling); the weight and hit of a sampled direction."""
        direction = coat.sample(outgoing, u, v)
        valid = active & (direction.z > 1e-6)
        pdf = coat.density(direction, outgoing)
        strength = dr.select(pdf > 0, coat.value(direction, outgoing) * direction.z / pdf, 0)
        near = intersect(tracer, mi.Ray3f(origin, frame.to_world(direction)), valid)
        lobes = [mi.Float(0) for _ in rho]
        for one, own in zip(arriving, shares, strict=True):
            value, density = coat.value(one.incoming, outgoing), coat.density(one.incoming, outgoing)
            share = dr.select(one.per_area > 0, one.per_area / (one.per_area + density), 0)
            lamp_cosine = -dr.dot(frame.to_world(direction), one.lamp.normal)
            lamp_pdf = dr.square(near.distance) / (one.lamp.area * dr.maximum(lamp_cosine, 1e-6))
            emitted = lamp_seen(one.lamp, near, frame.to_world(direction))
            lobe = one.weight * np.pi * value * share
            lobe += dr.select(emitted > 0, strength * emitted * pdf / (pdf + lamp_pdf), 0)
            lobes = [old + s * lobe for old, s in zip(lobes, own, strict=True)]
        return lobes, strength, near, valid

    def before_last(
        albedo: Albedo, diffuse: Sequence[mi.Float], points: SobolPoints, i: mi.UInt32, ray: mi.Ray3f
    ) -> list[mi.Float]:
        """The light reflected by the material before the surface seen, minus its mean over directions."""
        hit = intersect(tracer, ray)
        onwards = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 0), points.point(i, 1)))
        origin = hit.position + hit.normal * RAY_OFFSET_MM
        ray = mi.Ray3f(origin, mi.Frame3f(hit.normal).to_world(onwards))
        far = intersect(tracer, ray, hit.reflecting)
        theirs = far.front & (far.material == material)
        frame = mi.Frame3f(far.normal)
        outgoing = frame.to_local(-ray.d)
        there = far.position + far.normal * RAY_OFFSET_MM
        arriving = from_lamps(frame, there, points.point(i, 8), points.point(i, 9), theirs)
        change = [mi.Float(0) for _ in rho]
        for one, own in zip(arriving, shares, strict=True):
            # rays that meet no surface have no angle of incidence; the albedo may be read from a table
            base_mean, coat_mean = albedo(dr.select(theirs, one.incoming.z, 0))
            beyond = one.weight * (base(one.incoming, outgoing) - base_mean)
            change = [c + s * (r * beyond - one.weight * coat_mean) for c, s, r in zip(change, own, rho, strict=True)]
        base_mean, coat_mean = diffuse
        gathered = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 12), points.point(i, 13)))
        source = intersect(tracer, mi.Ray3f(there, frame.to_world(gathered)), theirs)
        factor = base(gathered, outgoing) - base_mean
        change = [c + (r * factor - coat_mean) * b for c, r, b in zip(change, rho, seen(source, theirs), strict=True)]
        if coat is not None:
            u, v = points.point(i, 10), points.point(i, 11)
            lobes, strength, near, valid = mirrored(coat, frame, there, arriving, outgoing, u=u, v=v, active=theirs)
            change = [
                c + lobe + dr.select(valid, strength * b, 0)
                for c, lobe, b in zip(change, lobes, seen(near, valid), strict=True)
            ]
        entry = hit.material * bands
        first = [dr.gather(mi.Float, table_rho, entry + k, hit.reflecting) for k in range(bands)]
        return [dr.select(theirs, f * c, 0) for f, c in zip(first, change, strict=True)]

    def means(pixels: NDArray, dimensions: int, own_samples: int, sample: Sample) -> NDArray[np.float64]:
        """(w, n) mean changes of some pixels."""
        lane = device_array(mi.UInt32, pixels)
        rays, points = pixel_rays(camera, lane), SobolPoints(dimensions, own_samples, lane, seed)

        def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
            change = sample(points, i, rays(points.point(i, 4), points.point(i, 5)))
            return i + 1, [total + c for total, c in zip(sums, change, strict=True)]

        last = dr.opaque(mi.UInt32, own_samples)
        start = (dr.zeros(mi.UInt32, len(pixels)), [dr.zeros(mi.Float, len(pixels)) for _ in range(bands)])
        _, sums = dr.while_loop(start, lambda i, _: i < last, body)
        dr.eval(sums)
        return np.stack([np.array(total) for total in sums]) / own_samples

    change = np.zeros((bands, count))
    if len(seen_in):
        change[:, seen_in] = means(seen_in, 8, samples[0], at_surface)
    if albedo is not None:
        change += means(np.arange(count), 14, samples[1], partial(before_last, albedo, _for_diffuse_light(albedo)))
    return change.reshape(bands, camera.height_px, camera.width_px)


def with_reflection(
    light: PatchLight, material: int, reflection: Reflection, *, of: tuple[str | float, ...], samples: tuple[int, int]
) -> PatchLight:
    """The light with a changed reflection of one material, whose patches have the albedo of it already.

    of : what determines the reflection; where the light is the same as well, rays traced before are used again.
    """
    transport, radiance = light.transport, light.patch_radiance()
    reflectances = light.scene.reflectances(light.wavelength_nm)
    added = transport.kept(
        (*of, material, *samples, radiance, reflectances, light.lamp_shares),
        lambda: changed_reflection(
            transport.light,
            transport.camera,
            radiance,
            reflectances,
            light.lamp_shares,
            reflection,
            material=material,
            seen_in=transport.pixels_of(material),
            samples=samples,
        ),
    )
    return light.change(added=light.added + added)
