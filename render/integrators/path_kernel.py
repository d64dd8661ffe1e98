"""The kernel of the general path tracer: paths through any BSDF and medium.

Estimator
---------
A path starts at the camera and carries one throughput T per wavelength, the product of f cos(theta) / p over its
vertices: f is the BSDF (or the phase function, without the cosine), p the density of the sampled direction per solid
angle. Directions, distances and Russian roulette use densities common to all wavelengths. So the estimate is unbiased
at each wavelength, and the wavelengths share the geometry of the path.

Each vertex adds light of a lamp of radiance L in two ways.

- A point of the lamp is sampled uniformly over its area A. At the distance d and the angle theta_l from the lamp's
  normal this is the density p_l = d^2 / (A cos(theta_l)) per solid angle. It adds T f cos(theta) V L / (p_l + p_b).
- If the direction sampled by the BSDF or the phase function, of density p_b, hits the lamp, its emission is added
  with the weight p_b / (p_l + p_b).

Here V is the transmittance of the shadow ray, 0 if it is blocked. This is the balance heuristic (Veach and Guibas
1995): for each direction the weights p_l / (p_l + p_b) and p_b / (p_l + p_b) of the two samples sum to 1, so their sum
is unbiased. Special cases of p_b:

- The camera's own rays and specular directions, which no lamp sample can replace: p_b is infinite, the weight is 1.
- Lambertian surfaces use only the samples of the lamps: p_b is taken as 0. In clear air these samples have the
  analytic form factor as a control variate (`direct_light`).
- Boundaries without refraction ("null") neither change the direction nor count as a bounce. The density p_b and the
  distance travelled are carried through them.

From vertex ROULETTE_START on, a path survives with the probability q = min(largest T, HIGHEST_SURVIVAL), and T is
divided by q.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..device import cosine_hemisphere, device_array, dr, mi
from ..image import RenderJob
from ..materials import SpectralBsdfs, SpectralMedia, SpectralTextures
from ..radiosity import LampSampler, direct_light, lamp_radiance, lamp_seen
from ..visibility import RAY_OFFSET_MM, Hit, Tracer, intersect, pixel_rays, visible
from .path_points import PathPoints, VertexPoints
from .path_tracer import HIGHEST_SURVIVAL, ROULETTE_START, UNLIMITED
from .shadow_rays import shadow_through

__all__ = ["Contents", "PathKernel"]

#: Mixed into the seeds of lanes for random numbers that are not of `PathPoints`.
_SEED_OF_CHANCES = 0x6C62272E
#: Step between the seeds of consecutive paths: 2^32 over the golden ratio.
_PATH_SEED_STEP = 0x9E3779B9


@dataclass(frozen=True, eq=False)
class Contents:
    """Surfaces' materials, and the media between the surfaces."""

    #: Materials that are not Lambertian.
    bsdfs: SpectralBsdfs
    #: Textures of Lambertian materials.
    textures: SpectralTextures
    #: Media; None if there is clear air everywhere and no boundary of type "null".
    media: SpectralMedia | None


@dataclass(frozen=True, eq=False)
class _Vertex:
    """The vertex at which a path segment ends, in each lane."""

    #: Nearest hit of the segment's ray.
    hit: Hit
    #: Unit direction of the segment.
    direction: mi.Vector3f
    #: Number of the medium of the segment.
    medium: mi.UInt32
    #: Position of the hit or of the scattering, mm.
    position: mi.Point3f
    #: Whether the path is scattered in the medium before it meets a surface.
    scattered: mi.Bool
    #: Whether it meets a surface, from either side.
    met: mi.Bool
    #: Whether it meets a boundary without refraction.
    through: mi.Bool
    #: Whether the path may continue: something reflects or scatters, and the limit of bounces is not reached.
    going: mi.Bool
    #: Lanes at the lit side of a Lambertian surface that may continue.
    plain: mi.Bool
    #: Lanes at any other surface that may continue.
    special: mi.Bool
    #: Reflectance at each wavelength, in the lanes of `plain`.
    reflectance: list[mi.Float]
    #: Mitsuba's record of the hit; None if all materials are Lambertian.
    interaction: mi.SurfaceInteraction3f | None


class PathKernel:
    """Sums over the paths of some pixels.

    There is one lane per pixel, and one symbolic loop over path segments. A lane whose path has ended starts its next
    path in the same step.

    Parameters
    ----------
    tracer
        Tracer of the job's scene.
    lamps
        Samplers of its lamps.
    contents
        Materials and media.
    job
        Camera, wavelengths and limit of bounces.
    pixels
        Pixel of each lane, counted along the rows.
    samples
        Number of paths of a lane.
    seeds
        Seed of each lane.
    """

    def __init__(
        self,
        tracer: Tracer,
        lamps: tuple[LampSampler, ...],
        contents: Contents,
        job: RenderJob,
        pixels: mi.UInt32,
        *,
        samples: int,
        seeds: mi.UInt32,
    ) -> None:
        wavelengths, max_bounces = job.wavelength_nm, job.max_bounces
        reflectances = tracer.scene.reflectances(wavelengths)
        materials = range(len(reflectances))
        self._tracer, self._lamps = tracer, lamps
        self._bsdfs, self._textures, self._media = contents.bsdfs, contents.textures, contents.media
        self._lanes, self._bands = dr.width(pixels), len(wavelengths)
        #: Whether there is a medium around the surfaces.
        self._around = tracer.scene.medium is not None
        self._rays = pixel_rays(job.camera, pixels)
        self._points = PathPoints(samples, pixels, seeds)
        self._chance_seed = mi.sample_tea_32(pixels, seeds ^ _SEED_OF_CHANCES)[0]
        self._reflectances = device_array(mi.Float, reflectances)
        #: By material, 1 for boundaries without refraction, and 1 for Lambertian surfaces.
        self._passing = mi.UInt32([1 if m in contents.bsdfs.passing else 0 for m in materials])
        self._lambertian = mi.UInt32([0 if m in contents.bsdfs.materials else 1 for m in materials])
        self._total = dr.opaque(mi.UInt32, samples)
        self._last = dr.opaque(mi.UInt32, UNLIMITED if max_bounces is None else max_bounces)
        #: Radiance of each lamp at each wavelength, relative to the lamps' mean.
        self._shares = [[dr.opaque(mi.Float, float(x)) for x in row] for row in tracer.scene.lamp_shares(wavelengths)]

    def sums(self) -> list[mi.Float]:
        """Sums over the paths of each lane.

        Returns
        -------
        list[Float]
            Radiance at each wavelength, relative to the lamps' mean, summed over the paths.
        """
        zero = dr.zeros(mi.UInt32, self._lanes)
        first = self._camera_ray(zero)
        state = (
            zero,
            (mi.UInt32(zero), mi.UInt32(zero), mi.UInt32(zero)),
            mi.Point3f(first.o),
            mi.Vector3f(first.d),
            (dr.full(mi.Float, dr.inf, self._lanes), dr.zeros(mi.Float, self._lanes)),
            [dr.ones(mi.Float, self._lanes) for _ in range(self._bands)],
            [dr.zeros(mi.Float, self._lanes) for _ in range(self._bands)],
        )
        *_, sums = dr.while_loop(state, lambda index, *_: index < self._total, lambda *state: self._step(state))
        return sums

    def _camera_ray(self, index: mi.UInt32) -> mi.Ray3f:
        """Camera ray of each lane's path of this index."""
        return self._rays(*self._points.pixel(index))

    def _step(self, state: tuple) -> tuple:
        """One path segment and the vertex at its end.

        The state is (index, counters, origin, direction, reach, throughput, sums). `counters` are the number of
        vertices of the path, the number of them that are no bounce, and the number of the medium of the segment.
        `reach` is the density of the direction, 1/sr: 0 if the lamps have already been sampled there. With it comes the
        distance travelled in this direction before the segment, through boundaries that are no bounce, mm.
        """
        index, counters, origin, direction, reach, throughput, sums = state
        depth, passed, medium = counters
        density, travelled = reach
        seed = self._chance_seed + index * _PATH_SEED_STEP
        chance = mi.sample_tea_float32(seed, depth * 2)
        lobe = mi.sample_tea_float32(seed, depth * 2 + 1)
        vertex, throughput = self._vertex(origin, direction, medium, chance, depth - passed, throughput)
        sums = self._with_emission(vertex, reach, throughput, sums)
        points = self._points.at_vertex(index, depth)
        sums = self._with_lamp_light(vertex, points, throughput, sums)
        turned, factors, next_density, side = self._next_direction(vertex, lobe, *self._points.direction(index, depth))
        next_density = dr.select(vertex.through, density, next_density)
        carried = [t * f for t, f in zip(throughput, factors, strict=True)]
        most = carried[0]
        for value in carried[1:]:
            most = dr.maximum(most, value)
        survives = dr.select(depth < ROULETTE_START, mi.Float(1), dr.minimum(most, HIGHEST_SURVIVAL))
        # after the last bounce a lamp may still be met where its own samples do not count for all of its light
        onward = (depth + 1 - passed < self._last) | vertex.special | vertex.scattered
        ended = ~(
            vertex.going & (vertex.scattered | vertex.plain | vertex.special) & (points.roulette < survives) & onward
        )
        ended |= ~(most > 0)
        if self._media is not None:
            medium = self._media.behind(vertex.hit, turned, medium, vertex.met)
        next_index = index + dr.select(ended, mi.UInt32(1), mi.UInt32(0))
        fresh = self._camera_ray(next_index)
        start = vertex.position + vertex.hit.normal * dr.select(vertex.scattered, 0, side * RAY_OFFSET_MM)
        return (
            next_index,
            (
                dr.select(ended, mi.UInt32(0), depth + 1),
                dr.select(ended, mi.UInt32(0), passed + dr.select(vertex.through, mi.UInt32(1), mi.UInt32(0))),
                dr.select(ended, mi.UInt32(0), medium),
            ),
            mi.Point3f(dr.select(ended, fresh.o, start)),
            mi.Vector3f(dr.select(ended, fresh.d, turned)),
            (
                dr.select(ended, mi.Float(dr.inf), next_density),
                dr.select(vertex.through & ~ended, travelled + vertex.hit.distance, 0),
            ),
            [dr.select(ended, mi.Float(1), t / survives) for t in carried],
            sums,
        )

    def _vertex(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        medium: mi.UInt32,
        chance: mi.Float,
        bounces: mi.UInt32,
        throughput: list[mi.Float],
    ) -> tuple[_Vertex, list[mi.Float]]:
        """Vertex at the end of a segment, and the throughput there.

        The throughput includes the transmittance of the medium. `chance` is the random number for the distance in the
        medium, `bounces` the number of bounces before.
        """
        tracer = self._tracer
        hit = intersect(tracer, mi.Ray3f(origin, direction))
        scattered, position = mi.Bool(False), hit.position
        if self._media is not None:
            limit = dr.select(hit.valid, hit.distance, dr.inf)
            distance, scattered, throughput = self._media.sample_distance(medium, chance, limit, throughput)
            position = dr.select(scattered, origin + distance * direction, hit.position)
        met, front = hit.valid & ~scattered, hit.front & ~scattered
        position = mi.Point3f(dr.select(met | scattered, position, origin))
        material, reflects = hit.material, met & (hit.material < tracer.reflectors)
        through = met & (dr.gather(mi.UInt32, self._passing, material, reflects) == 1)
        going = ((bounces < self._last) | through) & (scattered | reflects)
        plain = going & front & (dr.gather(mi.UInt32, self._lambertian, material, going & front) == 1)
        special = going & met & (dr.gather(mi.UInt32, self._lambertian, material, going & met) == 0)
        row = material * self._bands
        rho = [dr.gather(mi.Float, self._reflectances, row + k, plain) for k in range(self._bands)]
        vertex = _Vertex(
            hit,
            direction,
            medium,
            position,
            scattered,
            met,
            through,
            going,
            plain,
            special,
            self._textures.reflectance(hit, rho, plain),
            self._bsdfs.interaction(position, hit.normal, direction) if self._bsdfs.materials else None,
        )
        return vertex, throughput

    def _with_emission(
        self, vertex: _Vertex, reach: tuple[mi.Float, mi.Float], throughput: list[mi.Float], sums: list[mi.Float]
    ) -> list[mi.Float]:
        """Sums with the emission of a lamp that the segment hits, with the weight p_b / (p_b + p_l).

        The distance in p_l is that from the last bounce.
        """
        density, travelled = reach
        hit, direction = vertex.hit, vertex.direction
        for lamp, shares in zip(self._lamps, self._shares, strict=True):
            lamp_density = dr.square(travelled + hit.distance) / (lamp.area * -dr.dot(direction, lamp.normal))
            weight = dr.select(dr.isinf(density), mi.Float(1), density / (density + lamp_density))
            emitted = dr.select(vertex.met, lamp_seen(lamp, hit, direction) * weight, 0)
            sums = [
                s + dr.select(emitted > 0, emitted * m * t, 0) for s, m, t in zip(sums, shares, throughput, strict=True)
            ]
        return sums

    def _with_lamp_light(
        self, vertex: _Vertex, points: VertexPoints, throughput: list[mi.Float], sums: list[mi.Float]
    ) -> list[mi.Float]:
        """Sums with the light of a sampled point of each lamp, reflected or scattered at the vertex."""
        hit, position, plain = vertex.hit, vertex.position, vertex.plain
        in_medium = mi.Bool(self._around) | (vertex.medium > 0)
        for lamp, shares in zip(self._lamps, self._shares, strict=True):
            way, far, lamp_density, radiance = lamp_radiance(lamp, position, points.light_u, points.light_v)
            reflected, density = self._reflected(vertex, way, lamp_density)
            # p_b counts as 0 at Lambertian surfaces
            weight = dr.select(plain, radiance / lamp_density, radiance / (lamp_density + density))
            needed = vertex.scattered | (vertex.special & ~vertex.through) | (plain & in_medium)
            free, transmittance, crossed = self._shadow(
                vertex, way, far, vertex.going & needed & (lamp_density > 0), plain & (lamp_density > 0)
            )
            weight = dr.select(free, weight, 0)
            light = [t * a * p * weight for t, a, p in zip(throughput, reflected, transmittance, strict=True)]
            if not self._around:
                # in clear air by `direct_light`, to which boundaries are opaque: light that passes some is added
                clear = plain & ~in_medium
                analytic = direct_light(
                    self._tracer, lamp, hit.position, hit.normal, points.light_u, points.light_v, clear
                )
                light = [
                    dr.select(clear, t * r * analytic + dr.select(crossed, x, 0), x)
                    for x, t, r in zip(light, throughput, vertex.reflectance, strict=True)
                ]
            sums = [s + m * x for s, m, x in zip(sums, shares, light, strict=True)]
        return sums

    def _reflected(self, vertex: _Vertex, way: mi.Vector3f, lamp_density: mi.Float) -> tuple[list[mi.Float], mi.Float]:
        """BSDF times cosine towards `way` at each wavelength, and p_b of this direction.

        Of scatterings, the phase function.
        """
        cosine = dr.maximum(dr.dot(way, vertex.hit.normal), 0)
        values = [dr.select(vertex.plain, r * cosine / dr.pi, 0) for r in vertex.reflectance]
        density = mi.Float(0)
        if self._bsdfs.materials:
            active = vertex.special & (lamp_density > 0)
            bright, density = self._bsdfs.values(vertex.interaction, vertex.hit.material, way, active)
            values = [dr.select(vertex.special, new, old) for new, old in zip(bright, values, strict=True)]
        if self._media is not None:
            phase = self._media.phase(vertex.medium, dr.dot(vertex.direction, way))
            values = [dr.select(vertex.scattered, phase, old) for old in values]
            density = dr.select(vertex.scattered, phase, density)
        return values, density

    def _shadow(
        self, vertex: _Vertex, way: mi.Vector3f, far: mi.Float, active: mi.Bool, plain: mi.Bool
    ) -> tuple[mi.Bool, list[mi.Float], mi.Bool]:
        """Shadow ray to a lamp: free or not, its transmittance, and whether it passes boundaries.

        `active` are the lanes that need it. With boundaries without refraction those of `plain` need it, too: there
        `direct_light` counts as blocked what passes a boundary.
        """
        media, normal, position = self._media, vertex.hit.normal, vertex.position
        offset = dr.select(vertex.scattered, 0, RAY_OFFSET_MM * dr.sign(dr.dot(way, normal)))
        origin, target = position + normal * offset, position + way * far
        beyond = vertex.medium if media is None else media.behind(vertex.hit, way, vertex.medium, vertex.met)
        if self._bsdfs.passing and media is not None:
            shadow = shadow_through(
                self._tracer, media, self._passing, beyond, origin, target, bands=self._bands, active=active | plain
            )
            return shadow.free, shadow.transmittance, shadow.boundaries > 0
        free = visible(self._tracer, origin, target, active, enclosed=not self._around)
        parts = [mi.Float(1)] * self._bands if media is None else media.transmittance(beyond, far)
        return free, parts, mi.Bool(False)

    def _next_direction(
        self, vertex: _Vertex, lobe: mi.Float, u: mi.Float, v: mi.Float
    ) -> tuple[mi.Vector3f, list[mi.Float], mi.Float, mi.Float]:
        """Sampled direction, factors f cos / p at each wavelength, density p_b, and side.

        The side is the sign of the offset along the normal at which the next segment starts.
        """
        plain, special, scattered, normal = vertex.plain, vertex.special, vertex.scattered, vertex.hit.normal
        side = dr.select(dr.dot(vertex.direction, normal) < 0, mi.Float(1), -mi.Float(1))
        turned = cosine_hemisphere(normal, u, v)
        factors, density = [dr.select(plain, r, 0) for r in vertex.reflectance], mi.Float(0)
        if self._bsdfs.materials:
            sampled = self._bsdfs.sample(vertex.interaction, vertex.hit.material, lobe, mi.Point2f(u, v), special)
            toward, weights, bsdf_density = sampled
            turned = mi.Vector3f(dr.select(special, toward, turned))
            factors = [dr.select(special, new, old) for new, old in zip(weights, factors, strict=True)]
            density = dr.select(special, bsdf_density, density)
            side = dr.select(special, dr.sign(dr.dot(toward, normal)), side)
        if self._media is not None:
            toward, phase = self._media.sample(vertex.medium, vertex.direction, u, v)
            turned = mi.Vector3f(dr.select(scattered, toward, turned))
            factors = [dr.select(scattered, mi.Float(1), old) for old in factors]
            density = dr.select(scattered, phase, density)
        return turned, factors, density, side
