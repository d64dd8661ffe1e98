"""Excesses of captures with a cause that no catalogue holds, by a short way: hundreds in minutes.

A laboratory is photographed, calibrated and compared once, by the complete pipeline. Each cause then changes the light
or the counts of its photograph, and the change is added to the excess of the comparison, with camera, lamp and shared
errors adjusted as there. To first order that is what the pipeline makes of a capture with the cause. The causes are
written as physics: other meshes, paints, lamps and cameras in the rendered scene, other filters on its spectra, charges
and pixels. No formula of a family of `cboxlab.validation.diagnose.families` is used.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import made_causes
import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render_to_precision
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings, write_photographs
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose.field_fit import ResidualData
from cboxlab.validation.diagnose.linearised_fit import linearised_fit
from cboxlab.validation.diagnose.unexplained import residual_data_of
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photographed_light, photographed_scene
from cboxlab.validation.synthetic.varied import varied_settings, with_block_offsets
from numpy.typing import NDArray
from scipy.ndimage import (
    distance_transform_edt,
    shift,
)
from scipy.spatial.transform import Rotation

__all__ = [
    "BASES",
    "CAUSE_ERROR",
    "FINER",
    "Draw",
    "Laboratory",
    "Made",
    "Maker",
    "Stack",
    "Truth",
    "as_counts",
    "binned",
    "blend",
    "finer_places",
    "grid",
    "laboratory",
    "moved_bands",
    "of_other_scene",
    "of_scene",
    "per_rate",
    "rendered",
    "scaled_change",
]

Stack = NDArray[np.float64]
Draw = np.random.Generator

#: Relative error of a render: below the noise of the frames.
_RENDER_ERROR = 0.0015

#: Relative error of a render with a cause; that of the same picture without it has the same random numbers.
CAUSE_ERROR = 0.004

#: Pixels of the fine picture for one of the sensor, along each side.
FINER = 3

#: Relative error of the fine picture's pixels.
_FINE_ERROR = 0.01

#: Excess of chi2 per sample that scaled causes are given: from hardly visible to plain.
_LEAST_EXCESS, _MOST_EXCESS = 0.06, 5.0


@dataclass(frozen=True)
class Truth:
    """Family of a cause ("none" where no family covers it), and its place."""

    family: str
    centre_px: tuple[float, float] | None = None
    surface: str | None = None


@dataclass(frozen=True, eq=False)
class Laboratory:
    """A photographed box, and the excess of its capture over the model."""

    #: Flaws of the box that the model lacks, in words.
    base: str
    #: Seed of its draws and renders.
    seed: int
    data: ResidualData
    scene: Scene
    camera: Camera
    settings: CaptureSettings
    #: Render of the scene.
    image: RenderedImage
    #: (band, y, x) signal, DN/s.
    rate: Stack
    #: (band, y, x) the same of a draft, to be compared with renders with causes.
    draft: Stack
    #: (band, 3 y, 3 x) the same of pixels a third as wide: shifts and blurs act on it before pixels add up.
    fine: Stack

    @property
    def shape(self) -> tuple[int, int]:
        return self.data.shape


def _softer(rate: Stack, image: RenderedImage, amount: float) -> Stack:
    """Corners are filled: less light is lost in them, by a part that falls off over a pixel."""
    surface = image.surface.astype(int)
    edge = np.zeros(surface.shape, bool)
    for axis in (0, 1):
        step = np.diff(surface, axis=axis) != 0
        for part in (slice(None, -1), slice(1, None)):
            where = [slice(None), slice(None)]
            where[axis] = part
            edge[tuple(where)] |= step
    return rate * (1 + amount * np.exp(-distance_transform_edt(~edge) / 0.7))


def _leaning(scene: Scene, draw: Draw) -> Scene:
    """Blocks that do not stand upright."""
    surfaces = []
    for surface in scene.surfaces:
        if surface.name.endswith("-block"):
            vertices = surface.vertices_mm
            foot = np.array([vertices[:, 0].mean(), 0.0, vertices[:, 2].mean()])
            tilt = Rotation.from_euler("xz", draw.normal(0, 0.07, 2), degrees=True)
            surface = replace(surface, vertices_mm=tilt.apply(vertices - foot) + foot)
        surfaces.append(surface)
    return replace(scene, surfaces=tuple(surfaces))


def _other_paints(scene: Scene, draw: Draw) -> Scene:
    """Paints off their tables by half a percent, smoothly."""
    materials = {}
    for name, material in scene.materials.items():
        x = (WAVELENGTH_NM - 550) / 150
        factor = 1 + 0.004 * (draw.normal() * x + draw.normal() * x**2)
        values = np.clip(material.reflectance.at(WAVELENGTH_NM) * factor, 0, 1)
        materials[name] = replace(material, reflectance=Spectrum(WAVELENGTH_NM, values))
    return replace(scene, materials=materials)


#: Flaws of the box, by name.
BASES = ("exact", "creases", "leaning", "paints", "all")


def rendered(scene: Scene, camera: Camera, seed: int, error: float = _RENDER_ERROR) -> RenderedImage:
    return render_to_precision(RenderJob(scene, camera, WAVELENGTH_NM, seed=seed), error)


def laboratory(seed: int, size_px: int, base: str) -> Laboratory:
    """A laboratory with a box whose flaws have a name of ``BASES``; the pipeline runs once."""
    draw = np.random.default_rng([seed, 17])
    camera, settings = (
        perturbed_camera(size_px, seed),
        replace(varied_settings(seed), repeats=2 + seed % 2, sphere_brightness=1.0),
    )
    scene = with_block_offsets(photographed_scene(Model()), seed)
    if base in ("leaning", "all"):
        scene = _leaning(scene, draw)
    if base in ("paints", "all"):
        scene = _other_paints(scene, draw)
    image = rendered(scene, camera, seed)
    rate, sphere, _ = photographed_light(image, (), None, camera, settings)
    cause = (
        _softer(rate, image, draw.choice([-1, 1]) * draw.uniform(0.005, 0.02)) if base in ("creases", "all") else rate
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "capture"
        surveyed = photographed_scene(Model())
        write_photographs(
            folder, cause, sphere, image.sees_lamp, camera=camera, scene=surveyed, settings=settings, seed=seed
        )
        validation = validate_capture(load_capture(folder), Model())
        first = linearised_fit(validation.prepared, validation.rendered, ())
        data = residual_data_of(first, first.model.residual, validation.prepared.calibration.capture)
    # the capture's bands are in the order of time
    settings = replace(settings, filters={band: settings.filters[band] for band in data.bands})
    rate, _, _ = photographed_light(image, (), None, camera, settings)
    draft = photographed_light(rendered(scene, camera, seed, CAUSE_ERROR), (), None, camera, settings)[0]
    fine = fine_rate(scene, camera, settings, seed, rate)
    return Laboratory(base, seed, data, scene, camera, settings, image, rate, draft, fine)


def fine_rate(scene: Scene, camera: Camera, settings: CaptureSettings, seed: int, rate: Stack) -> Stack:
    """The picture with pixels a third as wide, of the brightness of the picture itself."""
    fine_camera = replace(
        camera,
        width_px=FINER * camera.width_px,
        height_px=FINER * camera.height_px,
        focal_length_px=FINER * camera.focal_length_px,
        principal_point_px=FINER * (camera.principal_point_px + 0.5) - 0.5,
    )
    fine = photographed_light(rendered(scene, fine_camera, seed, _FINE_ERROR), (), None, fine_camera, settings)[0]
    return fine * (rate.mean(axis=(1, 2)) / fine.mean(axis=(1, 2)))[:, None, None]


def binned(fine: Stack) -> Stack:
    """Means of squares of pixels."""
    bands, rows, columns = fine.shape
    return fine.reshape(bands, rows // FINER, FINER, columns // FINER, FINER).mean(axis=(2, 4))


Made = tuple[Truth, Stack, Mapping[str, Any]]
Maker = Callable[[Draw, Laboratory], Made]


def per_rate(lab: Laboratory, changed: Stack) -> Stack:
    """Change of the signal, DN, by another rate, DN/s."""
    bright = lab.rate > 0.05 * lab.rate.mean(axis=(1, 2), keepdims=True)
    ratios = zip(lab.data.signal, lab.rate, bright & lab.data.used, strict=True)
    dn = np.array([np.median(signal[signal_seen] / rate[signal_seen]) for signal, rate, signal_seen in ratios])
    return dn[:, None, None] * (changed - lab.rate)


def as_counts(lab: Laboratory, counts: Stack) -> Stack:
    """Change of the signal, DN, by counts added before the division by the flat."""
    return np.broadcast_to(counts, lab.rate.shape) / np.maximum(lab.data.flat, 0.05)


def scaled_change(draw: Draw, lab: Laboratory, change: Stack, most: float = np.inf) -> Stack:
    """A change of a size drawn between hardly visible and plain, at most ``most`` times as given."""
    part = float(np.sum(lab.data.whitened(change) ** 2)) / lab.data.count
    target = np.exp(draw.uniform(np.log(_LEAST_EXCESS), np.log(_MOST_EXCESS)))
    return change * min(np.sqrt(target / max(part, 1e-12)), most)


def grid(lab: Laboratory) -> tuple[Stack, Stack]:
    rows, columns = np.indices(lab.shape).astype(float)
    return rows, columns


def of_scene(maker: made_causes.Maker) -> Maker:
    """A cause of ``made_causes`` that changes scene or camera."""

    def build(draw: Draw, lab: Laboratory) -> Made:
        cause = maker(draw, lab.scene, lab.camera)
        total: Any = 0.0
        for picture_seen, camera, weight in cause.pictures:
            if picture_seen is lab.scene and camera is lab.camera:
                total = total + weight * lab.rate
                continue
            added = np.max(weight) <= 0.1
            image = rendered(picture_seen, camera, lab.seed, 0.02 if added else CAUSE_ERROR)
            rate = photographed_light(image, (), None, camera, lab.settings)[0]
            total = total + weight * (rate if added else rate - lab.draft + lab.rate)
        truth = Truth(cause.truth.family, cause.truth.centre_px, cause.truth.surface)
        return truth, per_rate(lab, total), {}

    return build


def moved_bands(lab: Laboratory, by: Stack) -> Stack:
    """The rate with each band's picture moved by (dy, dx), px."""
    pairs = zip(lab.fine, by, strict=True)
    moved = np.array([shift(image, FINER * np.asarray(step), order=1, mode="nearest") for image, step in pairs])
    return lab.rate + binned(moved) - binned(lab.fine)


def finer_places(finer: list[Stack]) -> list[Stack]:
    """Places (y, x), px of the sensor, as places of the fine picture's pixels."""
    step = (np.arange(FINER) - (FINER - 1) / 2) / FINER
    each = []
    for axis, stack in enumerate(finer):
        wide = np.repeat(np.repeat(stack, FINER, axis=0), FINER, axis=1)
        within = np.tile(step, stack.shape[axis])
        each.append((wide + (within[:, None] if axis == 0 else within)) * FINER + (FINER - 1) / 2)
    return each


def blend(draw: Draw, lab: Laboratory, other: Stack) -> Stack:
    """Change of the signal where a part of the light takes another way, of a drawn size."""
    return scaled_change(draw, lab, per_rate(lab, other), 1.0)


def of_other_scene(lab: Laboratory, scene: Scene) -> Stack:
    """Change of the signal by another scene; both renders have the same random numbers."""
    image = rendered(scene, lab.camera, lab.seed, CAUSE_ERROR)
    other = photographed_light(image, (), None, lab.camera, lab.settings)[0]
    return per_rate(lab, lab.rate + other - lab.draft)
