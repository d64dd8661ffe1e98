"""Change of a picture by a non-Lambertian material, rough or glossy.

At the surface that the camera sees and at the reflection before, the changed reflection is applied to direct light and
to light from the patches. At earlier ones light is treated as diffusely reflected with the changed albedo.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..device import SobolPoints, device_array, dr, lane_ranges, mi
from ..radiosity import LampSampler, PatchedScene, lamp_point, lamp_seen, patch_of
from ..visibility import RAY_OFFSET_MM, Hit, intersect, pixel_rays, visible
from .coat import Coat
from .patch_light import PatchLight
from .spreading import fewer_rays

__all__ = ["Reflection", "changed_reflection", "coat_light", "with_reflection"]

#: Number of cosines, in equal steps, over which light from all directions is summed.
_COSINES = 256

#: Random numbers of a path that ends at the surface seen, and of one with a reflection before it.
_DIMENSIONS_AT_SURFACE = 8
_DIMENSIONS_BEFORE_LAST = 14

#: Indices of the random numbers that place the camera ray in its pixel, across and down.
_PIXEL_U = 4
_PIXEL_V = 5

#: Seed of the random numbers: changes of one scene share their rays.
_SEED = 0

#: Smallest cosine to the normal of a sampled direction above the surface.
_MIN_COSINE = 1e-6

Albedo: TypeAlias = "Callable[[mi.Float], tuple[mi.Float, mi.Float]]"
Sample: TypeAlias = "Callable[[SobolPoints, mi.UInt32, mi.Ray3f], list[mi.Float]]"
Base: TypeAlias = "Callable[[mi.Vector3f, mi.Vector3f], mi.Float]"


@dataclass(frozen=True, eq=False)
class Reflection:
    """A reflection in place of Lambert's."""

    #: Diffuse BRDF over Lambert's, of the directions of incoming and outgoing light in the surface's frame.
    base: Base
    #: Specular coat above the base; None without one.
    coat: Coat | None = None
    #: Albedos of base (over Lambert's) and coat for light from a cosine; None where patches keep Lambert's.
    albedo: Albedo | None = None


@dataclass
class _LampLight:
    """Light that arrives at a point from a sampled point of a lamp."""

    #: The lamp.
    lamp: LampSampler
    #: Form factor, 0 where the lamp's point is hidden.
    weight: mi.Float
    #: Direction towards the lamp in the surface's frame.
    incoming: mi.Vector3f
    #: Probability density of the direction, 1/sr.
    density: mi.Float


@dataclass
class _Surface:
    """A point of a surface, the direction in which its light leaves, and where the point counts."""

    #: Frame with the normal as z.
    frame: mi.Frame3f
    #: Beginning of rays that leave the surface, mm.
    origin: mi.Point3f
    #: Direction of outgoing light in the frame.
    outgoing: mi.Vector3f
    #: Lanes whose point has the changed material.
    active: mi.Bool


@dataclass(frozen=True, eq=False)
class _ReflectionChange:
    """Change of radiance along camera rays for a changed reflection of a material; w bands."""

    #: Scene with its patches and lamps.
    light: PatchedScene
    #: The changed reflection.
    reflection: Reflection
    #: Index of the material.
    material: int
    #: Number of bands.
    bands: int
    #: (p w,) radiance of the patches, relative to the lamps' mean.
    patch_radiance: mi.Float
    #: (w) reflectance of the material.
    reflectance: list[mi.Float]
    #: (materials w,) reflectances of all materials and of the lamps.
    all_reflectances: mi.Float
    #: (lamps, w) radiance of each lamp relative to their mean.
    lamp_shares: list[list[mi.Float]]

    def at_surface(self, points: SobolPoints, i: mi.UInt32, ray: mi.Ray3f) -> list[mi.Float]:
        """Change at the surface that the camera sees, by band."""
        hit = intersect(self.light.tracer, ray)
        surface = self._surface(hit, ray, hit.front & (hit.material == self.material))
        arriving = self._from_lamps(surface, points.point(i, 2), points.point(i, 3))
        change = self._none()
        for lamp, shares in zip(arriving, self.lamp_shares, strict=True):
            excess = lamp.weight * (self.reflection.base(lamp.incoming, surface.outgoing) - 1)
            change = [c + r * s * excess for c, r, s in zip(change, self.reflectance, shares, strict=True)]
        gathered = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 0), points.point(i, 1)))
        far = self._patches_along(surface, gathered)
        factor = self.reflection.base(gathered, surface.outgoing) - 1
        change = [c + r * factor * b for c, r, b in zip(change, self.reflectance, far, strict=True)]
        change = self._with_coat(change, surface, arriving, points, i, first=6)
        return [dr.select(surface.active, c, 0) for c in change]

    def coat_at_surface(self, points: SobolPoints, i: mi.UInt32, ray: mi.Ray3f) -> list[mi.Float]:
        """Light of the coat at the surface that the camera sees, by band: a part of ``at_surface``."""
        hit = intersect(self.light.tracer, ray)
        surface = self._surface(hit, ray, hit.front & (hit.material == self.material))
        arriving = self._from_lamps(surface, points.point(i, 2), points.point(i, 3))
        reflected = self._with_coat(self._none(), surface, arriving, points, i, first=6)
        return [dr.select(surface.active, r, 0) for r in reflected]

    def before_last(self, diffuse: list[mi.Float]) -> Sample:
        """Sampler of the light that the material reflects towards the surface seen, minus its mean.

        diffuse : albedos of base and coat for light from all directions.
        """

        def sample(points: SobolPoints, i: mi.UInt32, ray: mi.Ray3f) -> list[mi.Float]:
            tracer = self.light.tracer
            hit = intersect(tracer, ray)
            onwards = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 0), points.point(i, 1)))
            origin = hit.position + hit.normal * RAY_OFFSET_MM
            ray = mi.Ray3f(origin, mi.Frame3f(hit.normal).to_world(onwards))
            far = intersect(tracer, ray, hit.reflecting)
            surface = self._surface(far, ray, far.front & (far.material == self.material))
            arriving = self._from_lamps(surface, points.point(i, 8), points.point(i, 9))
            change = self._lamps_less_mean(surface, arriving)
            gathered = mi.warp.square_to_cosine_hemisphere(mi.Point2f(points.point(i, 12), points.point(i, 13)))
            source = self._patches_along(surface, gathered)
            base_mean, coat_mean = diffuse
            factor = self.reflection.base(gathered, surface.outgoing) - base_mean
            change = [
                c + (r * factor - coat_mean) * b for c, r, b in zip(change, self.reflectance, source, strict=True)
            ]
            change = self._with_coat(change, surface, arriving, points, i, first=10)
            entry = hit.material * self.bands
            first = [dr.gather(mi.Float, self.all_reflectances, entry + k, hit.reflecting) for k in range(self.bands)]
            return [dr.select(surface.active, f * c, 0) for f, c in zip(first, change, strict=True)]

        return sample

    def _none(self) -> list[mi.Float]:
        """No change in any band."""
        return [mi.Float(0) for _ in self.reflectance]

    def _surface(self, hit: Hit, ray: mi.Ray3f, active: mi.Bool) -> _Surface:
        """Point where a ray meets a surface, whose light leaves against the ray."""
        frame = mi.Frame3f(hit.normal)
        return _Surface(frame, hit.position + hit.normal * RAY_OFFSET_MM, frame.to_local(-ray.d), active)

    def _from_lamps(self, surface: _Surface, u: mi.Float, v: mi.Float) -> list[_LampLight]:
        """One point of each lamp, as light that arrives at a surface."""
        tracer, arriving = self.light.tracer, []
        for lamp in self.light.lamps:
            weight, to_lamp, density = lamp_point(lamp, surface.origin, surface.frame.n, u, v, surface.active)
            incoming = surface.frame.to_local(dr.normalize(to_lamp))
            shining = surface.active & (weight > 0)
            free = visible(tracer, surface.origin, surface.origin + to_lamp, shining, enclosed=True)
            arriving.append(_LampLight(lamp, dr.select(free, weight, 0), incoming, density))
        return arriving

    def _patches_along(self, surface: _Surface, direction: mi.Vector3f) -> list[mi.Float]:
        """Radiance of the patch in a direction of the surface's frame, by band."""
        ray = mi.Ray3f(surface.origin, surface.frame.to_world(direction))
        return self._patch_radiance(intersect(self.light.tracer, ray, surface.active), surface.active)

    def _patch_radiance(self, hit: Hit, active: mi.Bool) -> list[mi.Float]:
        """Radiance of the patch that a ray meets, by band; 0 where it meets none."""
        on = hit.reflecting & active
        patch = patch_of(self.light.patches, hit.triangle, hit.uv, on)
        return [dr.gather(mi.Float, self.patch_radiance, patch * self.bands + k, on) for k in range(self.bands)]

    def _lamps_less_mean(self, surface: _Surface, arriving: list[_LampLight]) -> list[mi.Float]:
        """Lamps' light by the base, minus the light of base and coat spread evenly, by band."""
        albedo, change = self.reflection.albedo, self._none()
        for lamp, shares in zip(arriving, self.lamp_shares, strict=True):
            # rays that meet no surface have no angle of incidence; the albedo may be read from a table
            cosine = dr.select(surface.active, lamp.incoming.z, 0)
            base_mean, coat_mean = albedo(cosine)  # type: ignore[misc]
            excess = lamp.weight * (self.reflection.base(lamp.incoming, surface.outgoing) - base_mean)
            change = [
                c + s * (r * excess - lamp.weight * coat_mean)
                for c, s, r in zip(change, shares, self.reflectance, strict=True)
            ]
        return change

    def _with_coat(
        self,
        change: list[mi.Float],
        surface: _Surface,
        arriving: list[_LampLight],
        points: SobolPoints,
        i: mi.UInt32,
        *,
        first: int,
    ) -> list[mi.Float]:
        """Change with the light that the coat reflects, if there is one.

        first : index of the first of its two random numbers.
        """
        coat = self.reflection.coat
        if coat is None:
            return change
        u, v = points.point(i, first), points.point(i, first + 1)
        lobes, strength, near, valid = self._by_coat(coat, surface, arriving, u, v)
        return [
            c + lobe + dr.select(valid, strength * b, 0)
            for c, lobe, b in zip(change, lobes, self._patch_radiance(near, valid), strict=True)
        ]

    def _by_coat(
        self, coat: Coat, surface: _Surface, arriving: list[_LampLight], u: mi.Float, v: mi.Float
    ) -> tuple[list[mi.Float], mi.Float, Hit, mi.Bool]:
        """Lamps' light by the coat, by band, and a sampled direction of its lobe.

        By multiple importance sampling. Of the direction: its weight, what its ray meets, and whether it is valid.
        """
        outgoing = surface.outgoing
        direction = coat.sample(outgoing, u, v)
        valid = surface.active & (direction.z > _MIN_COSINE)
        pdf = coat.density(direction, outgoing)
        strength = dr.select(pdf > 0, coat.value(direction, outgoing) * direction.z / pdf, 0)
        toward = surface.frame.to_world(direction)
        near = intersect(self.light.tracer, mi.Ray3f(surface.origin, toward), valid)
        lobes = self._none()
        for light, shares in zip(arriving, self.lamp_shares, strict=True):
            value, density = coat.value(light.incoming, outgoing), coat.density(light.incoming, outgoing)
            share = dr.select(light.density > 0, light.density / (light.density + density), 0)
            lamp_cosine = -dr.dot(toward, light.lamp.normal)
            lamp_pdf = dr.square(near.distance) / (light.lamp.area * dr.maximum(lamp_cosine, 1e-6))
            emitted = lamp_seen(light.lamp, near, toward)
            lobe = light.weight * np.pi * value * share
            lobe += dr.select(emitted > 0, strength * emitted * pdf / (pdf + lamp_pdf), 0)
            lobes = [old + s * lobe for old, s in zip(lobes, shares, strict=True)]
        return lobes, strength, near, valid


def _for_diffuse_light(albedo: Albedo) -> list[mi.Float]:
    """Albedos of base and coat for light that is equally bright from all directions."""
    cosine = (np.arange(_COSINES) + 0.5) / _COSINES
    each = albedo(device_array(mi.Float, cosine))
    return [dr.opaque(mi.Float, float(np.mean(2 * cosine * np.array(mean, float)))) for mean in each]


def _means(
    sample: Sample, camera: Camera, pixels: NDArray, samples: int, dimensions: int, bands: int, seed: int
) -> NDArray[np.float64]:
    """(w, n) means of a sample over ``samples`` camera rays of each of n pixels."""
    parts = [
        _means_of_call(sample, camera, pixels[first:end], samples, dimensions, bands, seed)
        for first, end in lane_ranges(len(pixels), samples)
    ]
    return np.hstack([np.zeros((bands, 0)), *parts])


def _means_of_call(
    sample: Sample, camera: Camera, pixels: NDArray, samples: int, dimensions: int, bands: int, seed: int
) -> NDArray[np.float64]:
    """Means of ``_means`` by one kernel call."""
    lane = device_array(mi.UInt32, pixels)
    rays = pixel_rays(camera, lane)
    points = SobolPoints(dimensions, samples, lane, seed)

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        change = sample(points, i, rays(points.point(i, _PIXEL_U), points.point(i, _PIXEL_V)))
        return i + 1, [total + c for total, c in zip(sums, change, strict=True)]

    last = dr.opaque(mi.UInt32, samples)
    start = (dr.zeros(mi.UInt32, len(pixels)), [dr.zeros(mi.Float, len(pixels)) for _ in range(bands)])
    _, sums = dr.while_loop(start, lambda i, _: i < last, body)
    dr.eval(sums)
    return np.stack([np.array(total) for total in sums]) / samples


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
    spread: csr_array | None = None,
) -> NDArray[np.float64]:
    """Change of a picture for a changed reflection of one material.

    If the reflection has albedos, the patches' radiance includes them. The light that the material reflects towards
    the surfaces seen by the camera then gets the directional distribution of the changed reflection.

    Parameters
    ----------
    light
        Scene with its patches and lamps.
    camera
        Camera of the picture.
    radiance
        (p, w) of the patches, relative to the lamps' mean.
    reflectances
        (material, w) of all materials and of the lamps.
    lamp_shares
        (lamps, w) radiance of each lamp relative to their mean.
    reflection
        The changed reflection.
    material
        Index of the material.
    seen_in
        (n,) pixels that see the material, counted along the rows.
    samples
        Rays of each of these pixels, and of every pixel for the reflection before, which the last one spreads.
    spread
        (pixel, pixel) weights by which traced pixels stand for all, see ``spreading``; None traces all.

    Returns
    -------
    NDArray
        (w, y, x) change of radiance, relative to the lamps' mean.
    """
    bands, count = radiance.shape[1], camera.width_px * camera.height_px
    change = _reflection_change(light, radiance, reflectances, lamp_shares, reflection, material)

    def picture_of(sample: Sample, pixels: NDArray, rays: int, dimensions: int) -> NDArray[np.float64]:
        picture = np.zeros((bands, count))
        traced = pixels if spread is None else pixels[spread.diagonal()[pixels] > 0]
        if len(traced):
            picture[:, traced] = _means(sample, camera, traced, rays, dimensions, bands, _SEED)
        return picture if spread is None else np.asarray((spread @ picture.T).T)

    picture = picture_of(change.at_surface, seen_in, samples[0], _DIMENSIONS_AT_SURFACE)
    if reflection.albedo is not None:
        sample = change.before_last(_for_diffuse_light(reflection.albedo))
        picture += picture_of(sample, np.arange(count), samples[1], _DIMENSIONS_BEFORE_LAST)
    return picture.reshape(bands, camera.height_px, camera.width_px)


def _reflection_change(
    light: PatchedScene,
    radiance: NDArray,
    reflectances: NDArray,
    lamp_shares: NDArray,
    reflection: Reflection,
    material: int,
) -> _ReflectionChange:
    """Samplers of a changed reflection; the parameters are those of ``changed_reflection``."""
    return _ReflectionChange(
        light,
        reflection,
        material,
        radiance.shape[1],
        patch_radiance=device_array(mi.Float, radiance),
        reflectance=[dr.opaque(mi.Float, float(r)) for r in reflectances[material]],
        all_reflectances=device_array(mi.Float, reflectances),
        lamp_shares=[[dr.opaque(mi.Float, float(s)) for s in row] for row in lamp_shares],
    )


def coat_light(
    light: PatchedScene,
    camera: Camera,
    radiance: NDArray,
    reflectances: NDArray,
    lamp_shares: NDArray,
    reflection: Reflection,
    *,
    material: int,
    seen_in: NDArray[np.int64],
    samples: int = 256,
) -> NDArray[np.float64]:
    """Light that the coat of one material reflects at the surfaces seen.

    It is a part of ``changed_reflection``, by the same rays.

    Parameters
    ----------
    light
        Scene with its patches and lamps.
    camera
        Camera of the picture.
    radiance
        (p, w) of the patches, relative to the lamps' mean.
    reflectances
        (material, w) of all materials and of the lamps.
    lamp_shares
        (lamps, w) radiance of each lamp relative to their mean.
    reflection
        The reflection with its coat.
    material
        Index of the material.
    seen_in
        (n,) pixels that see the material, counted along the rows.
    samples
        Rays of each of these pixels.

    Returns
    -------
    NDArray
        (w, y, x) radiance, relative to the lamps' mean; 0 without a coat.
    """
    bands = radiance.shape[1]
    picture = np.zeros((bands, camera.width_px * camera.height_px))
    if len(seen_in) and reflection.coat is not None:
        change = _reflection_change(light, radiance, reflectances, lamp_shares, reflection, material)
        picture[:, seen_in] = _means(
            change.coat_at_surface, camera, seen_in, samples, _DIMENSIONS_AT_SURFACE, bands, _SEED
        )
    return picture.reshape(bands, camera.height_px, camera.width_px)


def with_reflection(
    light: PatchLight, material: int, reflection: Reflection, *, of: tuple[str | float, ...], samples: tuple[int, int]
) -> PatchLight:
    """Light with a changed reflection of one material, whose patches have its albedo already.

    Parameters
    ----------
    light
        Light of the scene.
    material
        Index of the material.
    reflection
        The changed reflection.
    of
        Values that determine the reflection. Rays are traced once for each reflection and light.
    samples
        As ``changed_reflection``.

    Returns
    -------
    PatchLight
        The light with the change added to its picture, and the coat's part to its specular light.
    """
    transport, radiance = light.transport, light.patch_radiance()
    samples = fewer_rays(samples[0], transport.covered.size), fewer_rays(samples[1], transport.covered.size)
    reflectances = light.scene.reflectances(light.wavelength_nm)
    inputs = (transport.light, transport.camera, radiance, reflectances, light.lamp_shares, reflection)
    seen_in = transport.pixels_of(material)
    added = transport.cached(
        (*of, material, *samples, radiance, reflectances, light.lamp_shares),
        lambda: changed_reflection(
            *inputs, material=material, seen_in=seen_in, samples=samples, spread=transport.spread
        ),
    )
    changed = light.change(added=light.added + added)
    if light.specular is None:
        return changed
    coat = coat_light(*inputs, material=material, seen_in=seen_in, samples=samples[0])
    return changed.change(specular=light.specular + coat)
