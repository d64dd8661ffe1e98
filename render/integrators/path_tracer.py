"""Path tracer with all wavelengths along each path: the reference for diffuse scenes.

Each path is traced once. Its geometry and Russian roulette do not depend on the wavelength. It has one throughput per
wavelength, so reflectances are exact at every wavelength. For a path with the reflectances rho_1, rho_2, ... of its
vertices the estimate of reflected light at one wavelength is

    Sum_n (rho_1 ... rho_n) D_n / (q_1 ... q_(n-1))

where D_n is the direct light at vertex n, as a form factor (`direct_light`), and q_n the probability with which the
path survives vertex n. Directions have the density cos(theta) / pi, which cancels the cosine and 1 / pi of Lambert's
law. So the estimate is unbiased, apart from the rounding of single precision.

Direct light is added at every vertex (next-event estimation). Emission is added only where the camera sees a lamp.
Wavelengths share their paths, so the errors of neighbouring wavelengths are strongly correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..device import cosine_hemisphere, device_array, dr, mi
from ..image import RenderedImage, RenderJob, means_by_strips
from ..radiosity import LampSampler, build_lamp_samplers, direct_light, lamp_seen
from ..visibility import RAY_OFFSET_MM, Tracer, build_tracer, facet_coverage, intersect, pixel_rays
from .path_points import PathPoints

__all__ = ["render_path_tracer", "trace_paths"]

#: Number of bounces that stands for no limit.
UNLIMITED = 2**32 - 1
#: Number of reflections before Russian roulette starts. With 2 the product of time and variance is smallest in the
#: published box (with 0, 1 and 3 it is 60, 20 and 1% larger).
ROULETTE_START = 2
#: Largest survival probability of Russian roulette, so that paths end even if no light is absorbed.
HIGHEST_SURVIVAL = 0.95


def render_path_tracer(job: RenderJob, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """Image of a diffuse scene by path tracing.

    The coefficients are radiance relative to the lamps': of each visible lamp relative to its own, then of reflected
    light at each wavelength relative to the lamps' mean (`Scene.lamp_radiance`).

    Parameters
    ----------
    job
        The image to render; its scene is diffuse.
    progress
        Receives the completed share after each kernel call.

    Returns
    -------
    RenderedImage
        Image with one coefficient per lamp and one per wavelength.
    """
    scene, wavelengths = job.scene, job.wavelength_nm
    tracer = build_tracer(scene)
    coverage = facet_coverage(tracer, job.camera)
    sums = trace_paths(tracer, job, progress)
    lamp_radiance = scene.lamp_radiance(wavelengths)
    return RenderedImage(
        coefficients=sums,
        spectra=np.vstack([scene.lamp_shares(wavelengths) * lamp_radiance, np.diag(lamp_radiance)]),
        wavelength_nm=wavelengths,
        coverage=coverage,
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )


def trace_paths(
    tracer: Tracer,
    job: RenderJob,
    progress: Progress = NO_PROGRESS,
    *,
    counted: bool = False,
    split: int = 0,
) -> np.ndarray:
    """Means over paths of the relative radiance, and of its parts.

    Parameters
    ----------
    tracer
        Tracer of the job's scene.
    job
        The image to render; its scene is diffuse.
    progress
        Receives the completed share after each kernel call.
    counted
        Whether to return, too, for each material (not the lamps) the light at each wavelength times the number of
        reflections by that material.
    split
        Number of reflections up to which the light reflected once, twice, ... is returned, too, at each wavelength.

    Returns
    -------
    NDArray
        (batch, y, x, n): each visible lamp, the light at each wavelength (see `render_path_tracer`), then the light
        of `counted` (material, w) and of `split` (reflections, w).
    """
    lamps = build_lamp_samplers(tracer)

    def strip(pixels: mi.UInt32, lane_samples: int, seeds: mi.UInt32) -> list[mi.Float]:
        return _strip(
            tracer,
            lamps,
            job,
            pixels,
            samples=lane_samples,
            seeds=seeds,
            counted=counted,
            split=split,
        )

    return means_by_strips(strip, job, progress)


def _strip(
    tracer: Tracer,
    lamps: tuple[LampSampler, ...],
    job: RenderJob,
    pixels: mi.UInt32,
    *,
    samples: int,
    seeds: mi.UInt32,
    counted: bool = False,
    split: int = 0,
) -> list[mi.Float]:
    """Sums over the paths of each of some pixels, see `trace_paths`.

    One lane per pixel and one symbolic loop over path segments. A lane whose path has ended starts its next path in the
    same step, so lanes do not wait for the longest path of their neighbours.

    Two devices save time. The state of a path is reset when the next path meets its first surface. The throughputs and
    sums of all wavelengths are updated one step after the vertex.

    The survival probability of a vertex is the largest reflectance of its material over the wavelengths, between 0.05
    and HIGHEST_SURVIVAL.
    """
    count = dr.width(pixels)
    wavelengths, max_bounces = job.wavelength_nm, job.max_bounces
    rays = pixel_rays(job.camera, pixels)
    points = PathPoints(samples, pixels, seeds)
    reflectances = tracer.scene.reflectances(wavelengths)
    survival = np.clip(reflectances.max(axis=1), 0.05, HIGHEST_SURVIVAL)
    tables = _Spectra(_MaterialTable(reflectances), _opaque(tracer.scene.lamp_shares(wavelengths)))
    survival_of = _MaterialTable(np.column_stack([survival, 1 / survival]))
    total = dr.opaque(mi.UInt32, samples)
    max_depth = dr.opaque(mi.UInt32, UNLIMITED if max_bounces is None else max_bounces)
    full = mi.Float(1)

    def body(spectral: tuple, path: tuple) -> tuple[tuple, tuple]:
        """One path segment: the update for the vertex before, then the vertex at its end."""
        spectra, counts = tables.after_vertex(spectral), spectral[-1]
        index, depth, origin, direction, emitted, weight = path
        hit = intersect(tracer, mi.Ray3f(origin, direction))
        material, shaded = hit.material, hit.reflecting & (depth < max_depth)
        vertex = points.at_vertex(index, depth)
        begun = depth == 0
        weight = dr.select(begun, full, weight)
        u, v = vertex.light_u, vertex.light_v
        lights = [weight * direct_light(tracer, lamp, hit.position, hit.normal, u, v, shaded) for lamp in lamps]
        reflected = [
            dr.select(begun, 0, c) + dr.select(shaded & (material == m), full, 0)
            for m, c in enumerate(counts[:followed])
        ]
        reached = [dr.select(depth == n, full, 0) for n in range(split)]
        survives, raised = (dr.select(depth < ROULETTE_START, full, x) for x in survival_of(material))
        ended = ~(shaded & (vertex.roulette < survives) & (depth + 1 < max_depth))
        u, v = points.onward(index, depth, ended)
        turned, fresh = cosine_hemisphere(hit.normal, u, v), rays(u, v)
        return (*spectra, begun, material, lights, reflected + reached), (
            index + dr.select(ended, mi.UInt32(1), mi.UInt32(0)),
            dr.select(ended, mi.UInt32(0), depth + 1),
            mi.Point3f(dr.select(ended, fresh.o, hit.position + hit.normal * RAY_OFFSET_MM)),
            dr.select(ended, fresh.d, turned),
            [s + dr.select(begun, lamp_seen(lamp, hit, direction), 0) for s, lamp in zip(emitted, lamps, strict=True)],
            weight * raised,
        )

    def zeros(number: int) -> list[mi.Float]:
        return [dr.zeros(mi.Float, count) for _ in range(number)]

    zero = dr.zeros(mi.UInt32, count)
    first = rays(*points.pixel(zero))
    bands = len(wavelengths)
    followed = len(tracer.material_names) if counted else 0
    spectral = (
        zeros(bands),
        zeros(bands),
        [zeros(bands) for _ in range(followed + split)],
        dr.full(mi.Bool, True, count),
        mi.UInt32(zero),
        zeros(len(lamps)),
        zeros(followed + split),
    )
    path = (
        mi.UInt32(zero),
        mi.UInt32(zero),
        mi.Point3f(first.o),
        mi.Vector3f(first.d),
        zeros(len(lamps)),
        dr.zeros(mi.Float, count),
    )
    spectral, (*_, emitted, _) = dr.while_loop((spectral, path), lambda _, path: path[0] < total, body)
    _, sums, counted_sums = tables.after_vertex(spectral)
    return [*emitted, *sums, *(s for row in counted_sums for s in row)]


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Reflectances and the lamps' shares at all wavelengths."""

    #: Reflectances by material.
    reflectance_of: _MaterialTable
    #: (lamps, w) each lamp's radiance over the lamps' mean.
    lamp_shares: list[list[mi.Float]]

    def after_vertex(self, spectral: tuple) -> tuple[list[mi.Float], list[mi.Float], list[list[mi.Float]]]:
        """Throughputs, sums and counted sums of all wavelengths after a vertex.

        `spectral` begins with the three before it. Next is whether the vertex is the first of its path, which resets
        the throughput. Its material, the direct light of each lamp and the factors of the counted sums follow.
        """
        throughput, sums, counted_sums, begun, material, lights, counts = spectral
        reflectances = self.reflectance_of(material)
        throughput = [dr.select(begun, r, t * r) for t, r in zip(throughput, reflectances, strict=True)]
        if len(lights) == 1:  # of share 1 at every wavelength
            light = lights * len(sums)
        else:
            light = [
                sum(m * x for m, x in zip(shares_at, lights, strict=True))
                for shares_at in zip(*self.lamp_shares, strict=True)
            ]
        sums = [dr.fma(t, x, s) for t, x, s in zip(throughput, light, sums, strict=True)]
        counted_sums = [
            [dr.fma(c * x, t, s) for t, x, s in zip(throughput, light, row, strict=True)]
            for c, row in zip(counts, counted_sums, strict=True)
        ]
        return throughput, sums, counted_sums


def _opaque(table: np.ndarray) -> list[list[mi.Float]]:
    """Rows of a table in numbers of one lane, which are data of the kernel."""
    return [[dr.opaque(mi.Float, float(x)) for x in row] for row in table]


class _MaterialTable:
    """A table (material, w) from which each lane reads the row of its material.

    Four values are read at a time. The rows of lamps are last.
    """

    def __init__(self, table: np.ndarray) -> None:
        self._wavelengths = table.shape[1]
        self._fours = -(-self._wavelengths // 4)
        self._packed = device_array(mi.Float, np.pad(table, ((0, 0), (0, 4 * self._fours - self._wavelengths))))

    def __call__(self, material: mi.UInt32) -> list[mi.Float]:
        base = material * self._fours
        fours = [dr.gather(mi.Vector4f, self._packed, base + k) for k in range(self._fours)]
        return [value for four in fours for value in four][: self._wavelengths]
