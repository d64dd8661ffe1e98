"""The default estimator for diffuse scenes: a final gather over a converged radiosity solution.

Per sample: a camera ray, direct light at its hit, one gathering ray, direct light where that lands.
Once and twice reflected light is thus exact; only light reflected three times or more is read from the
patches. A gathering ray that lands nearby, in a corner, would see the patches' size: from there one more ray
goes on, with direct light at its end, and the patches are read there.
All wavelengths come along: radiance is a sum of products of paint spectra and a short basis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Scene

from .film import means_by_strips
from .image import RenderedImage
from .lamp import LampSampler, build_lamp_sampler, direct_light, lamp_pattern
from .patches import Patches, build_patches, patch_of
from .primary import facet_coverage
from .radiosity import TOLERANCE, Exchange, indirect_basis, trace_exchange
from .sampling import SobolPoints, cosine_hemisphere
from .tracer import RAY_OFFSET_MM, Tracer, build_tracer, intersect, pixel_rays

__all__ = ["LightField", "gather", "render_final_gather", "solve_light"]

#: Default patch size as a part of the scene's diagonal: about 50 mm in the published box.
PATCHES_PER_DIAGONAL = 20

#: The solution is read from so many parts of a patch along each edge, for which its slope is known.
PARTS = 2

#: A gathering ray that lands within so many patches' edges goes on once more.
NEAR_PATCHES = 1.5

#: Gathering rays of one camera ray, where the samples can be shared out so. Camera rays see little noise: with
#: 2 the product of time and variance is a fifth less than with 1, with 4 no less but edges are noisier.
GATHERS = 2


@dataclass(frozen=True, eq=False)
class LightField:
    """The camera-independent part: the scene's radiosity solution, ready to be gathered from any camera.

    finer : the patches cut into PARTS^2 each, by which the solution is read.
    table : (1 + material, finer patch, k), see ``_lookup_table``. spectra : (n, w) of the picture's accumulators.
    near : mm, see NEAR_PATCHES.
    """

    tracer: Tracer
    lamp: LampSampler
    patches: Patches
    finer: Patches
    exchange: Exchange
    table: np.ndarray
    spectra: np.ndarray
    wavelength_nm: np.ndarray
    near: float
    max_bounces: int | None


def solve_light(
    scene: Scene,
    wavelength_nm: np.ndarray,
    max_bounces: int | None = None,
    patch_edge_mm: float | None = None,
    patch_samples: int = 2048,
    seed: int = 0,
) -> LightField:
    """Solve the scene's interreflection. Parameters as in ``render_final_gather``.

    Raises InputError for a scene that is not diffuse.
    """
    if not scene.diffuse:
        found = "surfaces that are not Lambertian, or a medium"
        raise InputError(f"scene {scene.name}", found, "a diffuse scene", "`cbox render` takes any scene")
    tracer = build_tracer(scene)
    lamp = build_lamp_sampler(tracer)
    extent = tracer.vertices.reshape(-1, 3)
    diagonal = float(np.linalg.norm(extent.max(axis=0) - extent.min(axis=0)))
    edge = patch_edge_mm or diagonal / PATCHES_PER_DIAGONAL
    patches = build_patches(tracer, edge)
    reflectances = np.array([m.reflectance.at(wavelength_nm) for m in scene.materials.values()])
    exchange = trace_exchange(tracer, lamp, patches, patch_samples, seed=seed ^ 0x5EED)
    finer = build_patches(tracer, edge, PARTS)
    cut = None if max_bounces is None else max(max_bounces - 1, 1)
    coefficients, indirect = indirect_basis(exchange, patches.material, reflectances, cut)
    coefficients = exchange.slopes.at(coefficients, _parents(patches, finer), finer.centre)
    table, indirect = _lookup_table(coefficients, indirect, reflectances)
    return LightField(
        tracer, lamp, patches, finer, exchange, table,
        spectra=_basis_spectra(scene, wavelength_nm, reflectances, indirect),
        wavelength_nm=np.asarray(wavelength_nm, float),
        # going on once more adds a reflection, which a picture cut after so many must not have
        near=NEAR_PATCHES * edge if max_bounces is None else 0.0,
        max_bounces=max_bounces,
    )  # fmt: skip


def gather(
    light: LightField, camera: Camera, samples: int = 256, batches: int = 4, seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> RenderedImage:  # fmt: skip
    """The picture of a solved scene through a camera. Parameters as in ``render_final_gather``."""
    table = mi.Float(light.table.ravel())

    def strip(pixels: mi.UInt32, own_seed: int) -> list[mi.Float]:
        return _strip(light, table, camera, pixels, samples, own_seed)

    return RenderedImage(
        coefficients=means_by_strips(strip, camera, samples, batches, seed, progress),
        spectra=light.spectra,
        wavelength_nm=light.wavelength_nm,
        coverage=facet_coverage(light.tracer, camera),
        facet_surface=light.tracer.facet_surface,
        surface_names=tuple(s.name for s in light.tracer.scene.surfaces),
    )


def render_final_gather(
    scene: Scene,
    camera: Camera,
    wavelength_nm: np.ndarray,
    samples: int = 256,
    batches: int = 4,
    seed: int = 0,
    max_bounces: int | None = None,
    patch_edge_mm: float | None = None,
    patch_samples: int = 2048,
    progress: Callable[[float], None] | None = None,
) -> RenderedImage:
    """Render the scene through the camera.

    wavelength_nm : (w,) where paints and lamp are evaluated. samples : per pixel and batch. batches :
    independent randomisations, whose scatter gives the standard error. max_bounces : reflections between
    lamp and camera (0 the lamp alone, 1 direct light; None for all). patch_edge_mm, patch_samples : size of
    the radiosity patches and rays from each. Repeatable by ``seed``.
    """
    light = solve_light(scene, wavelength_nm, max_bounces, patch_edge_mm, patch_samples, seed)
    return gather(light, camera, samples, batches, seed, progress)


def _parents(patches: Patches, finer: Patches) -> np.ndarray:
    """The patch (n,) of which each finer one is a part."""
    triangle, uv = mi.UInt32(finer.triangle.astype(np.uint32)), mi.Point2f(finer.uv.T.astype(np.float32))
    return np.array(patch_of(patches, triangle, uv, dr.full(mi.Bool, True, len(finer))))


def _lookup_table(
    coefficients: np.ndarray, spectra: np.ndarray, reflectances: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """One basis for what is read from patches directly and after one more reflection.

    Returns (1 + material, patch, k) coefficients, first those of the patches' own light, then those of it
    times each paint's reflectance, and the spectra (k, w).
    """
    rows = np.concatenate([spectra, *(rho * spectra for rho in reflectances)])
    weight = np.tile(np.abs(coefficients).max(axis=0), 1 + len(reflectances))
    _, singular, basis = np.linalg.svd(weight[:, None] * rows, full_matrices=False)
    basis = basis[: max(1, int(np.sum(singular > TOLERANCE * singular[0])))]
    parts = [
        coefficients @ (spectra @ basis.T),
        *(coefficients @ ((rho * spectra) @ basis.T) for rho in reflectances),
    ]
    return np.stack(parts).astype(np.float32), basis


def _basis_spectra(
    scene: Scene, wavelength_nm: np.ndarray, reflectances: np.ndarray, indirect: np.ndarray
) -> np.ndarray:
    """(n, w) spectra of the accumulators.

    First the lamp's; then for every first paint those of direct light, of second paints, of third paints, and
    of what is read from the patches.
    """
    lamp = scene.lamp.radiance.at(wavelength_nm)
    rows = [lamp]
    for first in reflectances:
        rows.append(lamp * first)
        rows += [lamp * first * second for second in reflectances]
        rows += [lamp * first * second * third for second in reflectances for third in reflectances]
        rows += [lamp * first * k for k in indirect]
    return np.array(rows)


def _strip(
    light: LightField, table: mi.Float, camera: Camera, pixels: mi.UInt32, samples: int, seed: int
) -> list[mi.Float]:
    """The n accumulators of some pixels: one lane per pixel, one symbolic loop over samples."""
    tracer, lamp, patches = light.tracer, light.lamp, light.finer
    rank, max_bounces = light.table.shape[2], light.max_bounces
    count = dr.width(pixels)
    rays = pixel_rays(camera, pixels)
    gathers = GATHERS if samples % GATHERS == 0 else 1
    points = SobolPoints(12, samples, pixels, seed)
    paints = len(tracer.material_names)
    first = max_bounces is None or max_bounces >= 1
    second = max_bounces is None or max_bounces >= 2
    third = max_bounces is None or max_bounces >= 3
    per_paint = 1 + paints + paints**2 + rank
    reach = dr.opaque(mi.Float, light.near)

    def gathered(i: mi.UInt32, position: mi.Point3f, normal: mi.Vector3f, shaded: mi.Bool) -> list[mi.Float]:
        """What one gathering ray brings: direct light by second and third paints, and the patches' part."""
        direction = cosine_hemisphere(normal, points.point(i, 0), points.point(i, 1))
        far = intersect(tracer, mi.Ray3f(position + normal * RAY_OFFSET_MM, direction), shaded)
        lit, paint = far.painted, far.material
        u, v = points.point(i, 2), points.point(i, 3)
        arriving = direct_light(tracer, lamp, far.position, far.normal, u, v, lit)
        values = [dr.select(lit & (paint == m), arriving, 0) for m in range(paints)]
        if not third:
            return values
        close = lit & (far.distance < reach)
        onward = cosine_hemisphere(far.normal, points.point(i, 8), points.point(i, 9))
        last = intersect(tracer, mi.Ray3f(far.position + far.normal * RAY_OFFSET_MM, onward), close)
        at_last, last_paint = last.painted, last.material
        u, v = points.point(i, 10), points.point(i, 11)
        arriving = direct_light(tracer, lamp, last.position, last.normal, u, v, at_last)
        values += [
            dr.select(at_last & (paint == m) & (last_paint == n), arriving, 0)
            for m in range(paints)
            for n in range(paints)
        ]
        read = (lit & ~close) | at_last
        triangle = dr.select(close, last.triangle, far.triangle)
        uv = mi.Point2f(dr.select(close, last.uv.x, far.uv.x), dr.select(close, last.uv.y, far.uv.y))
        patch = patch_of(patches, triangle, uv, read)
        entry = (patch + dr.select(close, (paint + 1) * len(patches), 0)) * rank
        return values + [dr.gather(mi.Float, table, entry + k, read) for k in range(rank)]

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        ray = rays(points.point(i, 4), points.point(i, 5))
        hit = intersect(tracer, ray)
        shaded, material = hit.painted, hit.material
        values = []
        if first:
            u, v = points.point(i, 6), points.point(i, 7)
            values.append(gathers * direct_light(tracer, lamp, hit.position, hit.normal, u, v, shaded))
        if second:

            def inner(j: mi.UInt32, brought: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
                more = gathered(j, hit.position, hit.normal, shaded)
                return j + 1, [old + value for old, value in zip(brought, more, strict=True)]

            end = (i + 1) * gathers
            nothing = [dr.zeros(mi.Float, count) for _ in range(per_paint - 1 if third else paints)]
            values += dr.while_loop((i * gathers, nothing), lambda j, _: j < end, inner)[1]
        glow = gathers * lamp_pattern(lamp, hit.position, -dr.dot(ray.d, lamp.normal))
        new = [sums[0] + dr.select(hit.on_lamp, glow, mi.Float(0))]
        for m in range(paints):
            here = shaded & (material == m)
            mine = sums[1 + m * per_paint : 1 + (m + 1) * per_paint]
            new += [old + dr.select(here, value, 0) for old, value in zip(mine, values, strict=False)]
            new += mine[len(values) :]
        return i + 1, new

    total = dr.opaque(mi.UInt32, samples // gathers)
    start_state = (
        dr.zeros(mi.UInt32, count),
        [dr.zeros(mi.Float, count) for _ in range(1 + paints * per_paint)],
    )
    return dr.while_loop(start_state, lambda i, _: i < total, body)[1]
