"""Paths that carry every wavelength: the unbiased reference for diffuse scenes.

Each path is traced once. Its geometry, and whether Russian roulette ends it, do not depend on the
wavelength; beside it runs one throughput per wavelength, so reflectances act exactly where they are asked
for. At every vertex the lamp's light is added (next-event estimation); only the camera sees the lamp itself.
Neighbouring wavelengths share their paths, so their errors are almost fully correlated.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene

from .film import means_by_strips
from .image import RenderedImage
from .lamp import LampSampler, build_lamp_sampler, direct_light, lamp_pattern
from .path_points import PathPoints
from .primary import facet_coverage
from .sampling import cosine_hemisphere
from .tracer import RAY_OFFSET_MM, Tracer, build_tracer, intersect, pixel_rays

__all__ = ["render_path_tracer", "trace_paths"]

UNLIMITED = 2**32 - 1
#: Russian roulette spares so many reflections: with 2 the product of time and variance is least in the
#: published box (with 0, 1 and 3 it is 60, 20 and 1% larger).
SPARED_REFLECTIONS = 2
#: No path survives a reflection with a higher probability, so each ends even where a paint absorbs nothing.
HIGHEST_SURVIVAL = 0.95


def render_path_tracer(
    scene: Scene,
    camera: Camera,
    wavelength_nm: np.ndarray,
    samples: int = 256,
    batches: int = 4,
    seed: int = 0,
    max_bounces: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> RenderedImage:
    """Render the scene through the camera by path tracing.

    wavelength_nm : (w,) where paints and lamp are evaluated. samples : paths per pixel and batch. batches :
    independent randomisations, whose scatter gives the standard error. max_bounces : reflections between
    lamp and camera (0 the lamp alone, 1 direct light; None for all). Repeatable by ``seed``.

    The result's coefficients are radiance over the lamp's radiance: of the lamp as the camera sees it, then
    at each wavelength.
    """
    wavelengths = np.asarray(wavelength_nm, float)
    tracer = build_tracer(scene)
    coverage = facet_coverage(tracer, camera)
    sums = trace_paths(tracer, camera, wavelengths, samples, batches, seed, max_bounces, progress)
    lamp_radiance = scene.lamp.radiance.at(wavelengths)
    return RenderedImage(
        coefficients=sums,
        spectra=np.vstack([lamp_radiance, np.diag(lamp_radiance)]),
        wavelength_nm=wavelengths,
        coverage=coverage,
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )


def trace_paths(
    tracer: Tracer,
    camera: Camera,
    wavelengths: np.ndarray,
    samples: int,
    batches: int,
    seed: int,
    max_bounces: int | None,
    progress: Callable[[float], None] | None,
    counted: bool = False,
    split: int = 0,
) -> np.ndarray:
    """(batch, y, x, n) means over paths: of the lamp as seen, then of light at each wavelength, over the lamp's.

    counted : then also, for each paint, of light at each wavelength times the number of reflections by it.
    split : then also of light reflected once, twice, up to so many times, at each wavelength.
    """
    lamp = build_lamp_sampler(tracer)
    reflectances = np.array([m.reflectance.at(wavelengths) for m in tracer.scene.materials.values()])

    def strip(pixels: mi.UInt32, own_seed: int) -> list[mi.Float]:
        bounds = samples, own_seed, max_bounces
        return _strip(tracer, lamp, reflectances, camera, pixels, *bounds, counted, split)

    return means_by_strips(strip, camera, samples, batches, seed, progress)


def _strip(
    tracer: Tracer, lamp: LampSampler, reflectances: np.ndarray, camera: Camera, pixels: mi.UInt32,
    samples: int, seed: int, max_bounces: int | None, counted: bool = False, split: int = 0,
) -> list[mi.Float]:  # fmt: skip
    """Sums over the paths of each of some pixels, see ``trace_paths``.

    One lane per pixel and one symbolic loop over path segments: a lane whose path has ended begins its next
    path in the same step, so none waits for the longest path of its neighbours. What a path carries is set
    back when the next one meets its first surface, which takes less than at the end of the one before. And
    wavelengths carry each vertex only in the next step: their arithmetic does not wait for its light.
    """
    count = dr.width(pixels)
    rays = pixel_rays(camera, pixels)
    points = PathPoints(samples, pixels, seed)
    survival = np.clip(reflectances.max(axis=1), 0.05, HIGHEST_SURVIVAL)
    paints = _Paints(reflectances)
    survivals = _Paints(np.column_stack([survival, 1 / survival]))
    total = dr.opaque(mi.UInt32, samples)
    last = dr.opaque(mi.UInt32, UNLIMITED if max_bounces is None else max_bounces)
    one = mi.Float(1)

    def carried(
        throughput: list[mi.Float], sums: list[mi.Float], counted_sums: list[list[mi.Float]],
        begun: mi.Bool, material: mi.UInt32, light: mi.Float, counts: list[mi.Float],
    ) -> tuple[list[mi.Float], list[mi.Float], list[list[mi.Float]]]:  # fmt: skip
        """All wavelengths' throughputs and sums after a vertex: its paint, and the light that reaches it."""
        throughput = [dr.select(begun, one, t) * r for t, r in zip(throughput, paints(material), strict=True)]
        sums = [dr.fma(t, light, s) for t, s in zip(throughput, sums, strict=True)]
        counted_sums = [
            [dr.fma(c * light, t, s) for t, s in zip(throughput, row, strict=True)]
            for c, row in zip(counts, counted_sums, strict=True)
        ]
        return throughput, sums, counted_sums

    def body(spectral: tuple, path: tuple) -> tuple[tuple, tuple]:
        carried_on, counts = carried(*spectral), spectral[-1]
        index, depth, origin, direction, seen, weight = path
        hit = intersect(tracer, mi.Ray3f(origin, direction))
        material, shaded = hit.material, hit.painted & (depth < last)
        glow = lamp_pattern(lamp, hit.position, -dr.dot(direction, lamp.normal))
        vertex = points.at_vertex(index, depth)
        begun = depth == 0
        weight = dr.select(begun, one, weight)
        light = weight * direct_light(
            tracer, lamp, hit.position, hit.normal, vertex.light_u, vertex.light_v, shaded
        )
        reflected = [
            dr.select(begun, 0, c) + dr.select(shaded & (material == m), one, 0)
            for m, c in enumerate(counts[:followed])
        ]
        reached = [dr.select(depth == n, one, 0) for n in range(split)]
        survives, raised = (dr.select(depth < SPARED_REFLECTIONS, one, x) for x in survivals(material))
        ended = ~(shaded & (vertex.roulette < survives) & (depth + 1 < last))
        u, v = points.onward(index, depth, ended)
        turned, fresh = cosine_hemisphere(hit.normal, u, v), rays(u, v)
        return (*carried_on, begun, material, light, reflected + reached), (
            index + dr.select(ended, mi.UInt32(1), mi.UInt32(0)),
            dr.select(ended, mi.UInt32(0), depth + 1),
            mi.Point3f(dr.select(ended, fresh.o, hit.position + hit.normal * RAY_OFFSET_MM)),
            dr.select(ended, fresh.d, turned),
            seen + dr.select(hit.on_lamp & begun, glow, 0),
            weight * raised,
        )

    def nothing(number: int) -> list[mi.Float]:
        return [dr.zeros(mi.Float, count) for _ in range(number)]

    zero = dr.zeros(mi.UInt32, count)
    first = rays(*points.pixel(zero))
    wavelengths = reflectances.shape[1]
    followed = len(reflectances) if counted else 0
    spectral = (
        nothing(wavelengths), nothing(wavelengths), [nothing(wavelengths) for _ in range(followed + split)],
        dr.full(mi.Bool, True, count), mi.UInt32(zero), dr.zeros(mi.Float, count), nothing(followed + split),
    )  # fmt: skip
    path = (
        mi.UInt32(zero), mi.UInt32(zero), mi.Point3f(first.o), mi.Vector3f(first.d),
        dr.zeros(mi.Float, count), dr.zeros(mi.Float, count),
    )  # fmt: skip
    spectral, (*_, seen, _) = dr.while_loop((spectral, path), lambda _, path: path[0] < total, body)
    _, sums, counted_sums = carried(*spectral)
    return [seen, *sums, *(s for row in counted_sums for s in row)]


class _Paints:
    """Looks up a paint's row of a small table (material, w), for each lane its own paint.

    The number after the last paint's is the lamp's, which reflects nothing.
    """

    #: Up to so many paints a chain of selections is cheaper than gathering from memory.
    MOST_SELECTED = 4

    def __init__(self, table: np.ndarray) -> None:
        self._paints, self._wavelengths = table.shape
        self._selects = self._paints <= self.MOST_SELECTED
        if self._selects:
            self._rows = [[dr.opaque(mi.Float, float(x)) for x in row] for row in table]
        else:
            lamp = np.zeros((1, self._wavelengths))
            self._packed = mi.Float(np.concatenate([table, lamp]).astype(np.float32).ravel())

    def __call__(self, material: mi.UInt32) -> list[mi.Float]:
        if not self._selects:
            base = material * self._wavelengths
            return [dr.gather(mi.Float, self._packed, base + k) for k in range(self._wavelengths)]
        values = list(self._rows[0])
        for paint in range(1, self._paints):
            here = material == paint
            values = [dr.select(here, new, old) for new, old in zip(self._rows[paint], values, strict=True)]
        return values
