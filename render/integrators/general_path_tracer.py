"""Path tracer for any scene (textures, coatings, glass, metals, media), with all wavelengths along each path.

As in ``path_tracer`` a path is traced once and has one throughput per wavelength; directions, distances and Russian
roulette use densities common to all wavelengths. Each lamp is sampled at every vertex. On surfaces and in media whose
own directions may also hit a lamp, the two estimates are combined by the balance heuristic (Veach and Guibas 1995).
Lambertian surfaces use only the samples of the lamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..device import cosine_hemisphere, device_array, dr, mi
from ..image import RenderedImage, RenderJob, means_by_strips
from ..materials import SpectralBsdfs, SpectralMedia, SpectralTextures
from ..radiosity import LampSampler, build_lamp_samplers, direct_light, lamp_radiance, lamp_seen
from ..visibility import RAY_OFFSET_MM, Tracer, build_tracer, facet_coverage, intersect, pixel_rays, visible
from .path_points import PathPoints
from .path_tracer import HIGHEST_SURVIVAL, ROULETTE_START, UNLIMITED
from .shadow_rays import shadow_through

__all__ = ["render_general_path_tracer"]


def render_general_path_tracer(job: RenderJob, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """Render the scene through the camera by path tracing; arguments and result as ``render_path_tracer``.

    Supports textures on Lambertian surfaces, any BSDF of Mitsuba, and media, around the surfaces and inside
    closed ones. A scattering counts as a bounce, a boundary without refraction ("null") does not.
    The coefficients are radiance relative to the lamps' mean (``Scene.lamp_radiance``), one for each wavelength.
    Raises InputError for a material that Mitsuba does not support.
    """
    scene, wavelengths = job.scene, job.wavelength_nm
    compiled = "cuda_ad_spectral" if mi.variant().startswith("cuda") else "llvm_ad_spectral"
    with mi.scoped_set_variant(compiled):
        tracer = build_tracer(scene)
        lamps = build_lamp_samplers(tracer)
        bsdfs = SpectralBsdfs(scene, wavelengths)
        textures = SpectralTextures(tracer, wavelengths)
        filled = scene.medium is not None or any(s.inside is not None for s in scene.surfaces) or bsdfs.passing
        media = SpectralMedia(tracer, wavelengths) if filled else None
        contents = _Stuff(bsdfs, textures, media)

        def strip(pixels: mi.UInt32, lane_samples: int, seeds: mi.UInt32) -> list[mi.Float]:
            return _strip(tracer, lamps, contents, job, pixels, samples=lane_samples, seeds=seeds)

        coefficients = means_by_strips(strip, job, progress)
        coverage = facet_coverage(tracer, job.camera)
    return RenderedImage(
        coefficients=coefficients,
        spectra=np.diag(scene.lamp_radiance(wavelengths)),
        wavelength_nm=wavelengths,
        coverage=coverage,
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )


@dataclass(frozen=True, eq=False)
class _Stuff:
    """What surfaces and the space between them are made of."""

    bsdfs: SpectralBsdfs
    textures: SpectralTextures
    media: SpectralMedia | None


def _strip(
    tracer: Tracer,
    lamps: tuple[LampSampler, ...],
    stuff: _Stuff,
    job: RenderJob,
    pixels: mi.UInt32,
    *,
    samples: int,
    seeds: mi.UInt32,
) -> list[mi.Float]:
    """Sums over the paths of some pixels, at each wavelength: one lane per pixel, one loop over path segments."""
    wavelengths, max_bounces = job.wavelength_nm, job.max_bounces
    count, bands = dr.width(pixels), len(wavelengths)
    reflectances, shares = tracer.scene.reflectances(wavelengths), tracer.scene.lamp_shares(wavelengths)
    bsdfs, textures, media = stuff.bsdfs, stuff.textures, stuff.media
    around = tracer.scene.medium is not None
    rays = pixel_rays(job.camera, pixels)
    points = PathPoints(samples, pixels, seeds)
    own_seed = mi.sample_tea_32(pixels, seeds ^ 0x6C62272E)[0]
    reflectance_table = device_array(mi.Float, reflectances)
    passing = mi.UInt32([1 if m in bsdfs.passing else 0 for m in range(len(reflectances))])
    lambertian = mi.UInt32([0 if m in bsdfs.materials else 1 for m in range(len(reflectances))])
    total = dr.opaque(mi.UInt32, samples)
    last = dr.opaque(mi.UInt32, UNLIMITED if max_bounces is None else max_bounces)
    one = mi.Float(1)
    mixed = [[dr.opaque(mi.Float, float(x)) for x in row] for row in shares]

    def begin(index: mi.UInt32) -> mi.Ray3f:
        return rays(*points.pixel(index))

    def body(
        index: mi.UInt32,
        state: tuple[mi.UInt32, mi.UInt32, mi.UInt32],
        origin: mi.Point3f,
        direction: mi.Vector3f,
        reach: tuple[mi.Float, mi.Float],
        throughput: list[mi.Float],
        sums: list[mi.Float],
    ) -> tuple:
        """state : how many vertices the path has, how many of them were no bounce, and the medium that it is in.

        reach : probability density of the direction, 1/sr; 0 if the lamps have already been sampled there; and how far
        the path has come in it, through boundaries that are no bounce, mm.
        """
        depth, passed, which = state
        before, travelled = reach
        hit = intersect(tracer, mi.Ray3f(origin, direction))
        chance = mi.sample_tea_float32(own_seed + index * 0x9E3779B9, depth * 2)
        lobe = mi.sample_tea_float32(own_seed + index * 0x9E3779B9, depth * 2 + 1)
        scattered, position = mi.Bool(False), hit.position
        if media is not None:
            distance, scattered, throughput = media.sample_distance(
                which, chance, dr.select(hit.valid, hit.distance, dr.inf), throughput
            )
            position = dr.select(scattered, origin + distance * direction, hit.position)
        met, front = hit.valid & ~scattered, hit.front & ~scattered
        position = mi.Point3f(dr.select(met | scattered, position, origin))
        material = hit.material
        for lamp, own in zip(lamps, mixed, strict=True):
            by_lamp = dr.square(travelled + hit.distance) / (lamp.area * -dr.dot(direction, lamp.normal))
            share = dr.select(dr.isinf(before), one, before / (before + by_lamp))
            emitted = dr.select(met, lamp_seen(lamp, hit, direction) * share, 0)
            sums = [
                s + dr.select(emitted > 0, emitted * m * t, 0) for s, m, t in zip(sums, own, throughput, strict=True)
            ]

        through = met & (dr.gather(mi.UInt32, passing, material, met & (material < tracer.reflectors)) == 1)
        going = ((depth - passed < last) | through) & (scattered | (met & (material < tracer.reflectors)))
        plain = going & front & (dr.gather(mi.UInt32, lambertian, material, going & front) == 1)
        special = going & met & (dr.gather(mi.UInt32, lambertian, material, going & met) == 0)
        vertex = points.at_vertex(index, depth)
        row_of = material * bands
        rho = [dr.gather(mi.Float, reflectance_table, row_of + k, plain) for k in range(bands)]
        rho = textures.reflectance(hit, rho, plain)

        # next event estimation
        side = dr.select(dr.dot(direction, hit.normal) < 0, one, -one)
        for lamp, own in zip(lamps, mixed, strict=True):
            way, far, by_lamp, radiance = lamp_radiance(lamp, position, vertex.light_u, vertex.light_v)
            lifted = position + hit.normal * dr.select(scattered, 0, RAY_OFFSET_MM * dr.sign(dr.dot(way, hit.normal)))
            cosine = dr.maximum(dr.dot(way, hit.normal), 0)
            arriving = [dr.select(plain, r * cosine / dr.pi, 0) for r in rho]
            by_bsdf = mi.Float(0)
            if bsdfs.materials:
                si = bsdfs.interaction(position, hit.normal, direction)
                bright, by_bsdf = bsdfs.values(si, material, way, special & (by_lamp > 0))
                arriving = [dr.select(special, new, old) for new, old in zip(bright, arriving, strict=True)]
            if media is not None:
                phase = media.phase(which, dr.dot(direction, way))
                arriving = [dr.select(scattered, phase, old) for old in arriving]
                by_bsdf = dr.select(scattered, phase, by_bsdf)
            in_medium = mi.Bool(around) | (which > 0)
            weight = dr.select(plain, radiance / by_lamp, radiance / (by_lamp + by_bsdf))
            asked = going & (scattered | (special & ~through) | (plain & in_medium)) & (by_lamp > 0)
            target, beyond, crossed = position + way * far, which, mi.Bool(False)
            if media is not None:
                beyond = media.behind(hit, way, which, met)
            if bsdfs.passing and media is not None:
                asked |= plain & (by_lamp > 0)
                shadow = shadow_through(tracer, media, passing, beyond, lifted, target, bands=bands, active=asked)
                free, parts, crossed = shadow.free, shadow.transmittance, shadow.boundaries > 0
            else:
                free = visible(tracer, lifted, target, asked, enclosed=not around)
                parts = [one] * bands if media is None else media.transmittance(beyond, far)
            weight = dr.select(free, weight, 0)
            light = [t * a * p * weight for t, a, p in zip(throughput, arriving, parts, strict=True)]
            if not around:
                analytic = direct_light(
                    tracer, lamp, hit.position, hit.normal, vertex.light_u, vertex.light_v, plain & ~in_medium
                )
                light = [
                    dr.select(plain & ~in_medium, t * r * analytic + dr.select(crossed, x, 0), x)
                    for x, t, r in zip(light, throughput, rho, strict=True)
                ]
            sums = [s + m * x for s, m, x in zip(sums, own, light, strict=True)]

        # next direction
        u, v = points.direction(index, depth)
        turned = cosine_hemisphere(hit.normal, u, v)
        factors, density = [dr.select(plain, r, 0) for r in rho], mi.Float(0)
        if bsdfs.materials:
            toward, drawn, by_bsdf = bsdfs.sample(si, material, lobe, mi.Point2f(u, v), special)
            turned = mi.Vector3f(dr.select(special, toward, turned))
            factors = [dr.select(special, new, old) for new, old in zip(drawn, factors, strict=True)]
            density = dr.select(special, by_bsdf, density)
            side = dr.select(special, dr.sign(dr.dot(toward, hit.normal)), side)
        if media is not None:
            toward, phase = media.sample(which, direction, u, v)
            turned = mi.Vector3f(dr.select(scattered, toward, turned))
            factors = [dr.select(scattered, one, old) for old in factors]
            density = dr.select(scattered, phase, density)
        density = dr.select(through, before, density)
        carried = [t * f for t, f in zip(throughput, factors, strict=True)]
        most = carried[0]
        for value in carried[1:]:
            most = dr.maximum(most, value)
        survives = dr.select(depth < ROULETTE_START, one, dr.minimum(most, HIGHEST_SURVIVAL))
        # after the last bounce a lamp may still be met where its own samples do not count for all of its light
        onward = (depth + 1 - passed < last) | special | scattered
        ended = ~(going & (scattered | plain | special) & (vertex.roulette < survives) & onward)
        ended |= ~(most > 0)
        if media is not None:
            which = media.behind(hit, turned, which, met)
        next_index = index + dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        fresh = begin(next_index)
        start_point = position + hit.normal * dr.select(scattered, 0, side * RAY_OFFSET_MM)
        return (
            next_index,
            (
                dr.select(ended, mi.UInt32(0), depth + 1),
                dr.select(ended, mi.UInt32(0), passed + dr.select(through, mi.UInt32(1), mi.UInt32(0))),
                dr.select(ended, mi.UInt32(0), which),
            ),
            mi.Point3f(dr.select(ended, fresh.o, start_point)),
            mi.Vector3f(dr.select(ended, fresh.d, turned)),
            (
                dr.select(ended, mi.Float(dr.inf), density),
                dr.select(through & ~ended, travelled + hit.distance, 0),
            ),
            [dr.select(ended, one, t / survives) for t in carried],
            sums,
        )

    zero = dr.zeros(mi.UInt32, count)
    first = begin(zero)
    state = (
        zero,
        (mi.UInt32(zero), mi.UInt32(zero), mi.UInt32(zero)),
        mi.Point3f(first.o),
        mi.Vector3f(first.d),
        (dr.full(mi.Float, dr.inf, count), dr.zeros(mi.Float, count)),
        [dr.ones(mi.Float, count) for _ in range(bands)],
        [dr.zeros(mi.Float, count) for _ in range(bands)],
    )
    *_, sums = dr.while_loop(state, lambda index, *_: index < total, body)
    return sums
