"""The default integrator for diffuse scenes: a final gather over a converged radiosity solution.

Each sample has a camera ray with direct light at its hit, and a gathering ray. At its hit direct light is read from
small cells, light reflected twice or more before from the patches. If a gathering ray hits a surface nearby (in a
corner), where the size of the cells would be visible, direct light is traced there; where that of the patches would
be, one more ray is traced, with direct light at its hit, and the patches are read there.
All wavelengths are computed at once: radiance is a sum of products of reflectance spectra and a short basis. Light of
several lamps is the sum of each one's light, which keeps their spectra apart from the rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..device import device_array, dr, mi
from ..image import RenderedImage, RenderJob, means_by_strips
from ..visibility import PlanarPixels, Tracer, facet_coverage, planar_pixels
from .direct_cells import DirectCells, build_direct_cells
from .face_controls import FaceControls, build_face_controls
from .gathering import Gathering, Planes
from .patched_scene import PatchedScene, Places, build_patched_scene
from .patches import Patches, build_patches, patch_of
from .solution import indirect_basis

__all__ = ["LightField", "gather", "render_final_gather", "solve_light"]

#: Divisions of a patch along each edge for reading the solution, by the patch's slopes.
PARTS = 2

#: A gathering ray shorter than this many patch edges is continued by one more ray. Between 0.5 and 2.5 no difference
#: is seen above 0.01% of any surface, with its standard error.
NEAR_PATCHES = 1.0

#: What the sums that are read from the patches leave out, relative to the largest.
_READ_TOLERANCE = 1e-4

#: Of the rays that tell how much of the faces' light is taken off.
_PILOT_SEED = 0x9107

#: Edges of direct light's cells in a patch's.
_CELLS = 5

#: Points in a cell, of those on a patch.
_CELL_SAMPLES = 1 / 8


@dataclass(frozen=True, eq=False)
class LightField(PatchedScene):
    """The radiosity solution of a scene, which does not depend on the camera.

    finer : the patches divided into PARTS^2 each, from which the solution is read.
    Of each lamp, tables : (1 + material, finer patch, k), see ``_lookup_table``; controls; direct, traced when first
    asked for.
    reflectances : (n, w) of the materials, and of the lamps if one reflects. spectra : (n, w) of the picture's
    accumulators, lamp by lamp.
    near : length below which gathering rays are continued, mm, see NEAR_PATCHES.
    """

    finer: Patches
    tables: tuple[np.ndarray, ...]
    controls: tuple[FaceControls | None, ...]
    reflectances: np.ndarray
    spectra: np.ndarray
    wavelength_nm: np.ndarray
    near: float
    max_bounces: int | None

    @property
    def direct(self) -> tuple[DirectCells, ...]:
        return _direct_cells(self.places)


def solve_light(
    scene: Scene,
    wavelength_nm: np.ndarray,
    max_bounces: int | None = None,
    patch_edge_mm: float | None = None,
    patch_samples: int = 2048,
    seed: int = 0,
) -> LightField:
    """The radiosity solution of a scene. Parameters as in ``render_final_gather``.

    Raises InputError for a scene that is not diffuse.
    """
    patched = build_patched_scene(scene, patch_edge_mm, patch_samples, seed)
    tracer, lamps, patches, exchange = patched.tracer, patched.lamps, patched.patches, patched.exchange
    edge = patched.places.edge_mm
    reflectances = scene.reflectances(wavelength_nm)[: tracer.reflectors]
    finer = build_patches(tracer, edge, PARTS)
    cut = None if max_bounces is None else max(max_bounces - 1, 1)
    paints, parents = reflectances[: _later_reflectors(tracer)], _parents(patches, finer)
    read = []
    for index in range(len(lamps)):
        coefficients, indirect = indirect_basis(exchange, index, patches.material, reflectances, cut)
        coefficients = exchange.slopes.at(coefficients, parents, finer.centre)
        read.append(_lookup_table(coefficients, indirect, paints))
    read = _of_one_rank(read)
    radiances = [lamp.radiance.at(wavelength_nm) for lamp in scene.lamps]
    spectra = [
        _basis_spectra(radiance, reflectances, paints, indirect)
        for radiance, (_, indirect) in zip(radiances, read, strict=True)
    ]
    return LightField(
        tracer,
        lamps,
        patches,
        exchange,
        patched.places,
        finer,
        tuple(table for table, _ in read),
        controls=tuple(
            build_face_controls(tracer, patches, exchange.direct[:, index], finer, table[0])
            for index, (table, _) in enumerate(read)
        ),
        reflectances=reflectances,
        spectra=np.concatenate(spectra),
        wavelength_nm=np.asarray(wavelength_nm, float),
        # the continuation adds a reflection, which is not allowed with a limit on bounces
        near=NEAR_PATCHES * edge if max_bounces is None else 0.0,
        max_bounces=max_bounces,
    )


@lru_cache(maxsize=2)
def _direct_cells(places: Places) -> tuple[DirectCells, ...]:
    samples = max(int(places.samples * _CELL_SAMPLES), 1)
    return build_direct_cells(places.tracer, places.lamps, places.edge_mm / _CELLS, samples, places.seed)


def gather(
    light: LightField,
    camera: Camera,
    samples: int | np.ndarray = 256,
    batches: int = 4,
    seed: int = 0,
    progress: Progress = NO_PROGRESS,
) -> RenderedImage:
    """The picture of a radiosity solution through a camera. Parameters as in ``render_final_gather``."""
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

    def strip(pixels: mi.UInt32, own_samples: int, seeds: mi.UInt32) -> list[mi.Float]:
        sums = []
        for index, lamp in enumerate(lamps):
            own = seeds + 6007 * index
            sums += _strip(lamp, camera, pixels.numpy(), view.planar, view.shares[index], own_samples, own)
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
    """Render the scene through the camera.

    wavelength_nm : (w,) at which reflectances and lamp are evaluated. samples : per pixel and batch; of each pixel
    where (y, x). batches : independent randomisations, whose scatter gives the standard error. max_bounces : largest
    number of reflections between lamp and camera (0 the visible lamp, 1 direct light; None for no limit).
    patch_edge_mm, patch_samples : largest edge of the radiosity patches and number of rays from each. seed : results
    are repeatable. Raises InputError for a scene that is not diffuse.
    """
    light = solve_light(job.scene, job.wavelength_nm, job.max_bounces, patch_edge_mm, patch_samples, job.seed)
    return gather(light, job.camera, job.samples, job.batches, job.batch_seed, progress)


def _later_reflectors(tracer: Tracer) -> int:
    """How many materials, by index, are second or third ones. A single lamp is none: no direct light falls on it."""
    return tracer.reflectors if len(tracer.scene.lamps) > 1 else len(tracer.material_names)


def _parents(patches: Patches, finer: Patches) -> np.ndarray:
    """(n,) the patch that contains each finer patch."""
    alone = np.searchsorted(finer.patch, np.arange(len(finer)))
    triangle = device_array(mi.UInt32, finer.triangle[alone])
    uv = mi.Point2f(*(device_array(mi.Float, column) for column in finer.uv[alone].T))
    return np.array(patch_of(patches, triangle, uv, dr.full(mi.Bool, True, len(finer))))


def _lookup_table(
    coefficients: np.ndarray, spectra: np.ndarray, reflectances: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """One basis for the light of the patches and for this light after one more reflection.

    Returns coefficients (1 + material, patch, k), first of the patches' light, then of this light times the
    reflectance of each material, and the spectra (k, w).
    """
    rows = np.concatenate([spectra, *(rho * spectra for rho in reflectances)])
    weight = np.tile(np.abs(coefficients).max(axis=0), 1 + len(reflectances))
    _, singular, basis = np.linalg.svd(weight[:, None] * rows, full_matrices=False)
    basis = basis[: max(1, int(np.sum(singular > _READ_TOLERANCE * singular[0])))]
    parts = [
        coefficients @ (spectra @ basis.T),
        *(coefficients @ ((rho * spectra) @ basis.T) for rho in reflectances),
    ]
    return np.stack(parts).astype(np.float32), basis


def _of_one_rank(read: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lookup tables and their spectra, padded with zeros: as many accumulators for every lamp."""
    rank = max(len(spectra) for _, spectra in read)
    return [
        (
            np.pad(table, ((0, 0), (0, 0), (0, rank - len(spectra)))),
            np.pad(spectra, ((0, rank - len(spectra)), (0, 0))),
        )
        for table, spectra in read
    ]


def _basis_spectra(lamp: np.ndarray, reflectances: np.ndarray, paints: np.ndarray, indirect: np.ndarray) -> np.ndarray:
    """(n, w) spectra of the accumulators of one lamp.

    First that of the lamp; then for every first material those of direct light, of second materials, of second and
    third materials, and of the light read from the patches. reflectances : of first materials, paints : of second
    and third ones.
    """
    rows = [lamp]
    for first in reflectances:
        rows.append(lamp * first)
        rows += [lamp * first * second for second in paints]
        rows += [lamp * first * second * third for second in paints for third in paints]
        rows += [lamp * first * k for k in indirect]
    return np.array(rows)


def _gatherings(light: LightField) -> list[Gathering]:
    """The kernels of each lamp."""
    return [
        Gathering(
            light.tracer,
            light.lamps[index],
            light.finer,
            dr.opaque(mi.UInt32, len(light.finer)),
            device_array(mi.Float, table),
            table.shape[2],
            light.direct[index],
            light.controls[index],
            firsts=light.tracer.reflectors,
            materials=_later_reflectors(light.tracer),
            bounces=3 if light.max_bounces is None else min(light.max_bounces, 3),
            near=dr.opaque(mi.Float, light.near),
        )
        for index, table in enumerate(light.tables)
    ]


@dataclass(frozen=True, eq=False)
class _View:
    """What all passes of a picture share. coverage : (y, x, f). shares : of each lamp, see ``_control_shares``."""

    coverage: np.ndarray
    planar: PlanarPixels
    shares: tuple[np.ndarray | None, ...]


@lru_cache(maxsize=1)
def _view(light: LightField, camera: Camera) -> _View:
    coverage = facet_coverage(light.tracer, camera)
    planar = planar_pixels(light.tracer, camera, coverage)
    lamps = _gatherings(light)
    shares = (
        _control_shares(lamp, camera, planar, rows)
        for lamp, rows in zip(lamps, np.split(light.spectra, len(lamps)), strict=True)
    )
    return _View(coverage, planar, tuple(shares))


def _control_shares(lamp: Gathering, camera: Camera, planar: PlanarPixels, spectra: np.ndarray) -> np.ndarray | None:
    """(pixel, 2) of the planar pixels, see ``Gathering``.

    spectra : (n, w) of the lamp's accumulators; the light summed over wavelengths and materials counts.
    """
    if not len(planar.index):
        return None
    weights = spectra[1:].sum(axis=1).reshape(lamp.firsts, -1).sum(axis=0)
    shares = lamp.control_shares(camera, _planes(planar, slice(None)), list(weights), _PILOT_SEED)
    return None if shares is None else np.stack([share.numpy() for share in shares], axis=1)


def _planes(planar: PlanarPixels, which: np.ndarray | slice) -> Planes:
    return Planes(
        pixels=device_array(mi.UInt32, planar.index[which]),
        normal=mi.Vector3f(*(device_array(mi.Float, column) for column in planar.normal[which].T)),
        height=device_array(mi.Float, planar.height[which]),
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
    """The accumulators of the pixels (n,) of some lanes under one lamp."""
    place = np.searchsorted(planar.index, pixels)
    flat = np.append(planar.index, -1)[place] == pixels
    sums = [dr.zeros(mi.Float, len(pixels)) for _ in range(1 + lamp.firsts * lamp.per_material)]

    def put(values: list[mi.Float], first: int, lanes: np.ndarray) -> None:
        at = device_array(mi.UInt32, lanes)
        for k, value in enumerate(values):
            dr.scatter(sums[first + k], value, at, mode=dr.ReduceMode.NoConflicts)

    mixed = np.flatnonzero(~flat)
    if len(mixed):
        theirs = dr.gather(mi.UInt32, seeds, device_array(mi.UInt32, mixed))
        put(lamp.any_pixels(camera, device_array(mi.UInt32, pixels[mixed]), samples, theirs), 0, mixed)
    own = np.flatnonzero(flat)
    if len(own):
        which = place[own]
        walls_and_blocks = (
            None if shares is None else tuple(device_array(mi.Float, column) for column in shares[which].T)
        )
        theirs = dr.gather(mi.UInt32, seeds, device_array(mi.UInt32, own))
        values = lamp.planar_pixels(camera, _planes(planar, which), walls_and_blocks, samples, theirs)
        dr.eval(values)
        material = planar.material[which]
        for m in range(lamp.firsts):
            here = np.flatnonzero(material == m)
            if len(here):
                chosen = device_array(mi.UInt32, here)
                put([dr.gather(mi.Float, v, chosen) for v in values], 1 + m * lamp.per_material, own[here])
    return sums
