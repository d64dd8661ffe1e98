"""The default estimator for diffuse scenes: a final gather over a converged radiosity solution.

Per sample: a camera ray, direct light at its hit, one gathering ray, direct light where that lands.
Once and twice reflected light is thus exact; only light reflected three times or more is read from the
patches. All wavelengths come along: radiance is a sum of products of paint spectra and a short basis.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene

from .image import RenderedImage
from .lamp import LampSampler, build_lamp_sampler, direct_light
from .patches import Patches, build_patches, patch_of
from .primary import facet_coverage
from .radiosity import indirect_basis, trace_exchange
from .sampling import SobolPoints, cosine_hemisphere
from .tracer import RAY_OFFSET_MM, Tracer, build_tracer, camera_ray, intersect

__all__ = ["render_final_gather"]

#: Default patch size as a part of the scene's diagonal: about 48 mm in the published box.
PATCHES_PER_DIAGONAL = 20


def render_final_gather(
    scene: Scene,
    camera: Camera,
    wavelength_nm: np.ndarray,
    samples: int = 256,
    batches: int = 4,
    seed: int = 0,
    max_bounces: int | None = None,
    patch_edge_mm: float | None = None,
    patch_samples: int = 1024,
    progress: Callable[[float], None] | None = None,
) -> RenderedImage:
    """Render the scene through the camera.

    wavelength_nm : (w,) where paints and lamp are evaluated. samples : per pixel and batch. batches :
    independent randomisations, whose scatter gives the standard error. max_bounces : reflections between
    lamp and camera (0 the lamp alone, 1 direct light; None for all). Repeatable by ``seed``.
    """
    tracer = build_tracer(scene)
    lamp = build_lamp_sampler(tracer)
    extent = tracer.vertices.reshape(-1, 3)
    diagonal = float(np.linalg.norm(extent.max(axis=0) - extent.min(axis=0)))
    patches = build_patches(tracer, patch_edge_mm or diagonal / PATCHES_PER_DIAGONAL)
    reflectances = np.array([m.reflectance.at(wavelength_nm) for m in scene.materials.values()])
    exchange = trace_exchange(tracer, lamp, patches, patch_samples, seed=seed ^ 0x5EED)
    cut = None if max_bounces is None else max(max_bounces - 1, 1)
    coefficients, spectra = indirect_basis(exchange, patches, reflectances, cut)
    images = []
    for batch in range(batches):
        images.append(
            _gather(
                tracer,
                lamp,
                patches,
                coefficients,
                camera,
                samples,
                seed + 7919 * (batch + 1),
                max_bounces,
                progress and (lambda part, b=batch: progress((b + part) / batches)),
            )
        )
    return RenderedImage(
        coefficients=np.stack(images),
        spectra=_basis_spectra(scene, wavelength_nm, reflectances, spectra),
        wavelength_nm=np.asarray(wavelength_nm, float),
        coverage=facet_coverage(tracer, camera),
        facet_surface=tracer.facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )


def _basis_spectra(
    scene: Scene, wavelength_nm: np.ndarray, reflectances: np.ndarray, indirect: np.ndarray
) -> np.ndarray:
    """(n, w) spectra of the accumulators: the lamp, then for every first paint direct, second paints, indirect."""
    lamp = scene.lamp.radiance.at(wavelength_nm)
    rows = [lamp]
    for first in reflectances:
        rows.append(lamp * first)
        rows += [lamp * first * second for second in reflectances]
        rows += [lamp * first * k for k in indirect]
    return np.array(rows)


def _gather(
    tracer: Tracer, lamp: LampSampler, patches: Patches, table: np.ndarray, camera: Camera,
    samples: int, seed: int, max_bounces: int | None, progress: Callable[[float], None] | None,
) -> np.ndarray:  # fmt: skip
    """(y, x, n) accumulators of one randomisation, in strips of rows so that a bar can move."""
    rows = max(1, min(camera.height_px, 2**15 // camera.width_px))
    strips = []
    rank = table.shape[1]
    packed = mi.Float(table.astype(np.float32).ravel())
    for start in range(0, camera.height_px, rows):
        height = min(rows, camera.height_px - start)
        strips.append(
            _strip(tracer, lamp, patches, packed, rank, camera, start, height, samples, seed, max_bounces)
        )
        if progress:
            progress((start + height) / camera.height_px)
    return np.concatenate(strips)


def _strip(
    tracer: Tracer, lamp: LampSampler, patches: Patches, packed: mi.Float, rank: int, camera: Camera,
    start: int, height: int, samples: int, seed: int, max_bounces: int | None,
) -> np.ndarray:  # fmt: skip
    """(height, x, n) accumulators of a strip of rows: one lane per pixel, one symbolic loop over samples."""
    count = height * camera.width_px
    local = dr.arange(mi.UInt32, count)
    lane = local + dr.opaque(mi.UInt32, start * camera.width_px)
    column, row = mi.Float(lane % camera.width_px), mi.Float(lane // camera.width_px)
    points = SobolPoints(8, samples, lane, seed)
    paints = len(tracer.material_names)
    n_surfaces = len(tracer.scene.surfaces)
    second = max_bounces is None or max_bounces >= 2
    third = max_bounces is None or max_bounces >= 3
    per_paint = 1 + paints + rank

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        ray = camera_ray(camera, column + points.point(i, 4) - 0.5, row + points.point(i, 5) - 0.5)
        hit = intersect(tracer, ray)
        surface = dr.gather(mi.UInt32, tracer.packed_surface, hit.triangle, hit.valid)
        on_lamp = hit.front & (surface == n_surfaces)
        shaded = hit.front & ~on_lamp
        material = dr.gather(mi.UInt32, tracer.packed_material, hit.triangle, shaded)
        values = [
            direct_light(
                tracer, lamp, hit.position, hit.normal, points.point(i, 6), points.point(i, 7), shaded
            )
        ]
        if second:
            direction = cosine_hemisphere(hit.normal, points.point(i, 0), points.point(i, 1))
            far = intersect(tracer, mi.Ray3f(hit.position + hit.normal * RAY_OFFSET_MM, direction), shaded)
            lit = far.valid & (
                dr.gather(mi.UInt32, tracer.packed_surface, far.triangle, far.valid) < n_surfaces
            )
            paint = dr.gather(mi.UInt32, tracer.packed_material, far.triangle, lit)
            light = direct_light(
                tracer, lamp, far.position, far.normal, points.point(i, 2), points.point(i, 3), lit
            )
            values += [dr.select(lit & (paint == m), light, 0) for m in range(paints)]
            if third:
                patch = patch_of(patches, far.triangle, far.uv, lit)
                values += [dr.gather(mi.Float, packed, patch * rank + k, lit) for k in range(rank)]
        new = [sums[0] + dr.select(on_lamp, mi.Float(1), mi.Float(0))]
        for m in range(paints):
            here = shaded & (material == m)
            mine = sums[1 + m * per_paint : 1 + (m + 1) * per_paint]
            new += [old + dr.select(here, value, 0) for old, value in zip(mine, values, strict=False)]
            new += mine[len(values) :]
        return i + 1, new

    total = dr.opaque(mi.UInt32, samples)
    start_state = (
        dr.zeros(mi.UInt32, count),
        [dr.zeros(mi.Float, count) for _ in range(1 + paints * per_paint)],
    )
    _, sums = dr.while_loop(start_state, lambda i, _: i < total, body)
    dr.eval(sums)
    stacked = np.stack([np.array(s) for s in sums], axis=-1) / samples
    return stacked.reshape(height, camera.width_px, -1)
