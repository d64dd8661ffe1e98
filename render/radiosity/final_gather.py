"""The default integrator for diffuse scenes: a final gather over a radiosity solution.

The radiance of a Lambertian surface at x is split by the number of reflections,

    L = rho_1 D(x) + rho_1 mean over y of [rho_2 D(y) + B(y)]

D is direct light, a form factor. The mean is over the points y that cosine-distributed rays from x hit. B(y) is the
light that leaves y after two or more reflections, the last one at y. For each sample:

- A camera ray finds x, where direct light is sampled by a shadow ray (`direct_light`).

- A gathering ray finds y. Direct light there is read from small cells, B from the patches of the radiosity solution.

- Cells and patches would be visible where y is near, as in corners. Within a few cells direct light at y is sampled by
  a shadow ray instead. Within a patch edge one more ray from y replaces B(y) by rho_2 [rho_3 D(z) + B(z)], with z the
  point that it hits.

Light reflected once is unbiased. The rest has the small bias of cells and patches, averaged over a hemisphere;
`benchmarks/rendering/bias.py` measures it against the path tracer.

All wavelengths are computed at once: radiance is a sum of products of reflectance spectra and a short basis, and the
rays only sum coefficients. With several lamps, the light of each is summed separately, which keeps their spectra apart
from the rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.utils.progress import NO_PROGRESS, Progress, checkpoint

from ..device import device_array, dr, finish_call, mi
from ..image import RenderedImage, RenderJob, means_by_strips
from ..visibility import PlanarPixels, Tracer, facet_coverage, planar_pixels
from .direct_cells import DirectCells, build_direct_cells
from .face_controls import FaceControls, build_face_controls
from .gathering import PACKET, Gathering, Planes
from .mixtures import MixedSurface, Mixtures, build_mixtures, patch_shares
from .patched_scene import ExchangeInputs, PatchedScene, build_patched_scene
from .patches import Patches, build_patches, patch_of
from .solution import indirect_basis

__all__ = ["LightField", "gather", "render_final_gather", "solve_light"]

#: Divisions of a patch along each edge for reading the solution, by the patch's slopes.
PARTS = 2

#: A gathering ray shorter than this many patch edges is continued by one more ray. Between 0.5 and 2.5 no difference is
#: visible above 0.01% of any surface, with its standard error.
NEAR_PATCHES = 1.0

#: Largest relative part that the sums read from the patches leave out.
_LOOKUP_TOLERANCE = 1e-4

#: Seed of the pilot rays from which the shares of the control variate are estimated.
_PILOT_SEED = 0x9107

#: Edges of direct light's cells in the edge of a patch.
_CELLS_PER_PATCH_EDGE = 5

#: Points in a cell, as a part of those on a patch.
_CELL_SAMPLES = 1 / 8


@dataclass(frozen=True, eq=False)
class LightField(PatchedScene):
    """The radiosity solution of a scene, which does not depend on the camera."""

    #: The patches divided into PARTS^2 each, from which the solution is read.
    finer: Patches
    #: Of each lamp, (1 + material, finer patch, k) coefficients, see `_lookup_table`.
    tables: tuple[np.ndarray, ...]
    #: Of each lamp, the control variate of gathering rays; None for a scene without flat walls.
    controls: tuple[FaceControls | None, ...]
    #: (n, w) reflectances of the materials; with those of the lamps if one reflects.
    reflectances: np.ndarray
    #: (n, w) spectra of the image's accumulators, lamp by lamp, W m^-2 sr^-1 nm^-1.
    spectra: np.ndarray
    #: (w,) wavelengths, nm.
    wavelength_nm: np.ndarray
    #: Length below which gathering rays are continued, mm; see NEAR_PATCHES.
    near: float
    #: Largest number of reflections; None for no limit.
    max_bounces: int | None
    #: Mixtures of the surfaces; None for a scene without any.
    mixtures: Mixtures | None

    @property
    def direct(self) -> tuple[DirectCells, ...]:
        """Direct light of each lamp in cells, traced when it is first used."""
        return _direct_cells(self.inputs)


def solve_light(
    scene: Scene,
    wavelength_nm: np.ndarray,
    max_bounces: int | None = None,
    patch_edge_mm: float | None = None,
    patch_samples: int = 2048,
    seed: int = 0,
) -> LightField:
    """Radiosity solution of a scene.

    Parameters
    ----------
    scene
        A diffuse scene.
    wavelength_nm
        (w,) wavelengths, nm.
    max_bounces
        Largest number of reflections between lamp and camera; None for no limit.
    patch_edge_mm
        Largest edge of a patch, mm; None for a twentieth of the scene's diagonal.
    patch_samples
        Rays, and samples of each lamp, of each patch.
    seed
        Seed of these rays.

    Returns
    -------
    LightField
        The solution.

    Raises
    ------
    InputError
        For a scene that is not diffuse.
    """
    patched = build_patched_scene(scene, patch_edge_mm, patch_samples, seed)
    tracer, lamps, patches, exchange = patched.tracer, patched.lamps, patched.patches, patched.exchange
    edge = patched.inputs.edge_mm
    reflectances = scene.reflectances(wavelength_nm)[: tracer.reflectors]
    finer = build_patches(tracer, edge, PARTS)
    max_reflections = None if max_bounces is None else max(max_bounces - 1, 1)
    shares = patch_shares(tracer, patches, len(reflectances))
    paints, parents = reflectances[: _later_reflectors(tracer)], _parents(patches, finer)
    lookups = []
    for index in range(len(lamps)):
        checkpoint()
        coefficients, indirect = indirect_basis(exchange, index, shares, reflectances, max_reflections)
        coefficients = exchange.slopes.at(coefficients, parents, finer.centre)
        lookups.append(_lookup_table(coefficients, indirect, paints))
    lookups = _padded_to_one_rank(lookups)
    radiances = [lamp.radiance.at(wavelength_nm) for lamp in scene.lamps]
    spectra = [
        _basis_spectra(radiance, reflectances, paints, indirect)
        for radiance, (_, indirect) in zip(radiances, lookups, strict=True)
    ]
    return LightField(
        tracer,
        lamps,
        patches,
        exchange,
        patched.inputs,
        finer,
        tuple(table for table, _ in lookups),
        controls=tuple(
            build_face_controls(tracer, patches, exchange.direct[:, index], finer, table[0])
            for index, (table, _) in enumerate(lookups)
        ),
        reflectances=reflectances,
        spectra=np.concatenate(spectra),
        wavelength_nm=np.asarray(wavelength_nm, float),
        # the continuation adds a reflection, which is not allowed with a limit on bounces
        near=NEAR_PATCHES * edge if max_bounces is None else 0.0,
        max_bounces=max_bounces,
        mixtures=build_mixtures(tracer),
    )


@lru_cache(maxsize=2)
def _direct_cells(inputs: ExchangeInputs) -> tuple[DirectCells, ...]:
    """Direct light in cells, kept for the last two scenes."""
    samples = max(int(inputs.samples * _CELL_SAMPLES), 1)
    return build_direct_cells(inputs.tracer, inputs.lamps, inputs.edge_mm / _CELLS_PER_PATCH_EDGE, samples, inputs.seed)


def gather(
    light: LightField,
    camera: Camera,
    samples: int | np.ndarray = 256,
    batches: int = 4,
    seed: int = 0,
    progress: Progress = NO_PROGRESS,
) -> RenderedImage:
    """Image of a radiosity solution.

    Parameters
    ----------
    light
        The solution.
    camera
        Camera of the image.
    samples
        Samples of a pixel and batch: one number, or (y, x) of each pixel.
    batches
        Number of independent randomisations.
    seed
        Seed of the image's random numbers.
    progress
        Receives the completed share after each kernel call.

    Returns
    -------
    RenderedImage
        Image with the accumulators of `_basis_spectra`, lamp by lamp.
    """
    job = RenderJob(
        light.tracer.scene,
        camera,
        light.wavelength_nm,
        samples,
        batches,
        seed=seed,
        max_bounces=light.max_bounces,
    )
    lamps, view = _gatherings(light), _view(light, camera)

    def strip(pixels: mi.UInt32, lane_samples: int, seeds: mi.UInt32) -> list[mi.Float]:
        sums = []
        for index, lamp in enumerate(lamps):
            checkpoint()
            lamp_seeds = seeds + 6007 * index
            sums += _strip(lamp, camera, pixels.numpy(), view.planar, view.shares[index], lane_samples, lamp_seeds)
        return sums

    return RenderedImage(
        coefficients=means_by_strips(strip, job, progress),
        spectra=light.spectra,
        wavelength_nm=light.wavelength_nm,
        coverage=view.coverage,
        facet_surface=light.tracer.facet_surface,
        surface_names=tuple(s.name for s in light.tracer.scene.surfaces),
    )


def render_final_gather(
    job: RenderJob,
    *,
    patch_edge_mm: float | None = None,
    patch_samples: int = 2048,
    progress: Progress = NO_PROGRESS,
) -> RenderedImage:
    """Image of a diffuse scene by a final gather.

    Parameters
    ----------
    job
        The image to render.
    patch_edge_mm
        Largest edge of a patch, mm; None for a twentieth of the scene's diagonal.
    patch_samples
        Rays, and samples of each lamp, of each patch.
    progress
        Receives the completed share after each kernel call; the radiosity solution, before, reports nothing.

    Returns
    -------
    RenderedImage
        Image with the accumulators of `_basis_spectra`, lamp by lamp.

    Raises
    ------
    InputError
        For a scene that is not diffuse.
    """
    light = solve_light(job.scene, job.wavelength_nm, job.max_bounces, patch_edge_mm, patch_samples, job.seed)
    return gather(light, job.camera, job.samples, job.batches, job.batch_seed, progress)


def _later_reflectors(tracer: Tracer) -> int:
    """Number of materials, by index, that may reflect second or third.

    A single lamp does not: no direct light falls on it.
    """
    return tracer.reflectors if len(tracer.scene.lamps) > 1 else len(tracer.material_names)


def _parents(patches: Patches, finer: Patches) -> np.ndarray:
    """(n,) patch that contains each finer patch."""
    alone = np.searchsorted(finer.patch, np.arange(len(finer)))
    triangle = device_array(mi.UInt32, finer.triangle[alone])
    uv = mi.Point2f(*(device_array(mi.Float, column) for column in finer.uv[alone].T))
    return np.array(patch_of(patches, triangle, uv, dr.full(mi.Bool, True, len(finer))))


def _lookup_table(
    coefficients: np.ndarray, spectra: np.ndarray, reflectances: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """One basis for the light of the patches, and for this light after one more reflection.

    The light of a patch is coefficients @ spectra; after a reflection by a material its spectra are multiplied by the
    reflectance. All these spectra, weighted by the largest coefficients, have a common basis by singular value
    decomposition, of the rank at which the rest is below _LOOKUP_TOLERANCE.

    Returns coefficients (1 + material, patch, k), first of the patches' light, then of this light times the reflectance
    of each material, and the spectra (k, w).
    """
    rows = np.concatenate([spectra, *(rho * spectra for rho in reflectances)])
    weight = np.tile(np.abs(coefficients).max(axis=0), 1 + len(reflectances))
    _, singular, basis = np.linalg.svd(weight[:, None] * rows, full_matrices=False)
    basis = basis[: max(1, int(np.sum(singular > _LOOKUP_TOLERANCE * singular[0])))]
    parts = [
        coefficients @ (spectra @ basis.T),
        *(coefficients @ ((rho * spectra) @ basis.T) for rho in reflectances),
    ]
    return np.stack(parts).astype(np.float32), basis


def _padded_to_one_rank(lookups: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lookup tables and spectra padded with zeros, so that every lamp has as many accumulators."""
    rank = max(len(spectra) for _, spectra in lookups)
    return [
        (
            np.pad(table, ((0, 0), (0, 0), (0, rank - len(spectra)))),
            np.pad(spectra, ((0, rank - len(spectra)), (0, 0))),
        )
        for table, spectra in lookups
    ]


def _basis_spectra(lamp: np.ndarray, reflectances: np.ndarray, paints: np.ndarray, indirect: np.ndarray) -> np.ndarray:
    """(n, w) spectra of the accumulators of one lamp.

    First that of the visible lamp. Then, for every first material rho_1, those of

    - direct light, rho_1;

    - direct light reflected twice, rho_1 rho_2, for every second material;

    - direct light reflected three times, rho_1 rho_2 rho_3, for every second and third material;

    - the light read from the patches, rho_1 times the basis `indirect`.

    All are multiplied by the lamp's radiance. `reflectances` are those of first materials, `paints` those of second and
    third ones.
    """
    rows = [lamp]
    for first in reflectances:
        rows.append(lamp * first)
        rows += [lamp * first * second for second in paints]
        rows += [lamp * first * second * third for second in paints for third in paints]
        rows += [lamp * first * k for k in indirect]
    return np.array(rows)


def _gatherings(light: LightField) -> list[Gathering]:
    """Kernels of each lamp."""
    return [
        Gathering(
            light.tracer,
            light.lamps[index],
            light.finer,
            dr.opaque(mi.UInt32, len(light.finer)),
            device_array(mi.Float, np.pad(table, ((0, 0), (0, 0), (0, -table.shape[2] % PACKET)))),
            table.shape[2],
            light.direct[index],
            light.controls[index],
            firsts=light.tracer.reflectors,
            materials=_later_reflectors(light.tracer),
            bounces=3 if light.max_bounces is None else min(light.max_bounces, 3),
            near=dr.opaque(mi.Float, light.near),
            mixtures=light.mixtures,
        )
        for index, table in enumerate(light.tables)
    ]


@dataclass(frozen=True, eq=False)
class _View:
    """Data that all passes of a picture share."""

    #: (y, x, f) coverage of pixels by flat faces.
    coverage: np.ndarray
    #: Pixels that show one plane of one material.
    planar: PlanarPixels
    #: Of each lamp, the shares of the control variate, see `_control_shares`.
    shares: tuple[np.ndarray | None, ...]


@lru_cache(maxsize=1)
def _view(light: LightField, camera: Camera) -> _View:
    """Data that all passes of a picture share, kept for the last picture."""
    coverage = facet_coverage(light.tracer, camera)
    checkpoint()
    plain = np.array([not isinstance(s, MixedSurface) for s in light.tracer.scene.surfaces] + [True])
    planar = planar_pixels(light.tracer, camera, coverage * plain[light.tracer.facet_surface])
    checkpoint()
    lamps = _gatherings(light)
    shares = (
        _control_shares(lamp, camera, planar, rows)
        for lamp, rows in zip(lamps, np.split(light.spectra, len(lamps)), strict=True)
    )
    return _View(coverage, planar, tuple(shares))


def _control_shares(lamp: Gathering, camera: Camera, planar: PlanarPixels, spectra: np.ndarray) -> np.ndarray | None:
    """(pixel, 2) shares of the control variate of the planar pixels, see `face_controls`.

    `spectra` (n, w) are those of the lamp's accumulators; the variance of the light summed over wavelengths and
    materials counts. None without planar pixels or controls.
    """
    if not len(planar.index):
        return None
    weights = spectra[1:].sum(axis=1).reshape(lamp.firsts, -1).sum(axis=0)
    shares = lamp.control_shares(camera, _planes(planar, slice(None)), list(weights), _PILOT_SEED)
    checkpoint()
    if shares is None:
        return None
    dr.eval(shares)  # together: one kernel
    return np.stack([share.numpy() for share in shares], axis=1)


def _planes(planar: PlanarPixels, entries: np.ndarray | slice) -> Planes:
    """Some of the planar pixels on the device."""
    return Planes(
        pixels=device_array(mi.UInt32, planar.index[entries]),
        normal=mi.Vector3f(*(device_array(mi.Float, column) for column in planar.normal[entries].T)),
        height=device_array(mi.Float, planar.height[entries]),
    )


def _strip(
    lamp: Gathering,
    camera: Camera,
    pixels: np.ndarray,
    planar: PlanarPixels,
    shares: np.ndarray | None,
    samples: int,
    seeds: mi.UInt32,
) -> list[mi.Float]:
    """Accumulators of the pixels (n,) of some lanes under one lamp.

    Pixels that show one plane of one material need no intersection of camera rays, and use the control variate. The
    others are computed by a general kernel.
    """
    position = np.searchsorted(planar.index, pixels)
    flat = np.append(planar.index, -1)[position] == pixels
    sums = [dr.zeros(mi.Float, len(pixels)) for _ in range(1 + lamp.firsts * lamp.per_material)]

    def put(values: list[mi.Float], first: int, lanes: np.ndarray) -> None:
        """Write sums of some lanes, from accumulator `first` on."""
        targets = device_array(mi.UInt32, lanes)
        for k, value in enumerate(values):
            dr.scatter(sums[first + k], value, targets, mode=dr.ReduceMode.NoConflicts)

    other_lanes = np.flatnonzero(~flat)
    if len(other_lanes):
        lane_seeds = dr.gather(mi.UInt32, seeds, device_array(mi.UInt32, other_lanes))
        put(lamp.any_pixels(camera, device_array(mi.UInt32, pixels[other_lanes]), samples, lane_seeds), 0, other_lanes)
        finish_call(sums)
    planar_lanes = np.flatnonzero(flat)
    if len(planar_lanes):
        entries = position[planar_lanes]
        walls_and_blocks = (
            None if shares is None else tuple(device_array(mi.Float, column) for column in shares[entries].T)
        )
        lane_seeds = dr.gather(mi.UInt32, seeds, device_array(mi.UInt32, planar_lanes))
        values = lamp.planar_pixels(camera, _planes(planar, entries), walls_and_blocks, samples, lane_seeds)
        dr.eval(values)
        finish_call(values)
        material = planar.material[entries]
        for m in range(lamp.firsts):
            members = np.flatnonzero(material == m)
            if len(members):
                indices = device_array(mi.UInt32, members)
                put([dr.gather(mi.Float, v, indices) for v in values], 1 + m * lamp.per_material, planar_lanes[members])
    return sums
