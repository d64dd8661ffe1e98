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
from cboxlab.rendering.synthetic import CaptureSettings, unit_factors, write_photographs
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
from scipy.fft import dctn, idctn
from scipy.ndimage import (
    convolve1d,
    distance_transform_edt,
    gaussian_filter,
    gaussian_filter1d,
    map_coordinates,
    rotate,
    shift,
    uniform_filter,
)
from scipy.spatial.transform import Rotation

__all__ = ["BASES", "CAUSES", "Laboratory", "Truth", "excess_of", "laboratory"]

Stack = NDArray[np.float64]
Draw = np.random.Generator

#: Relative error of a render: below the noise of the frames.
_RENDER_ERROR = 0.0015

#: Relative error of a render with a cause; that of the same picture without it has the same random numbers.
_CAUSE_ERROR = 0.004

#: Pixels of the fine picture for one of the sensor, along each side.
_FINER = 3

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


def _image(scene: Scene, camera: Camera, seed: int, error: float = _RENDER_ERROR) -> RenderedImage:
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
    image = _image(scene, camera, seed)
    rate, sphere, _ = photographed_light(image, (), None, camera, settings)
    seen = (
        _softer(rate, image, draw.choice([-1, 1]) * draw.uniform(0.005, 0.02)) if base in ("creases", "all") else rate
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "capture"
        surveyed = photographed_scene(Model())
        write_photographs(
            folder, seen, sphere, image.sees_lamp, camera=camera, scene=surveyed, settings=settings, seed=seed
        )
        validation = validate_capture(load_capture(folder), Model())
        first = linearised_fit(validation.prepared, validation.rendered, ())
        data = residual_data_of(first, first.model.residual, validation.prepared.calibration.capture)
    draft = photographed_light(_image(scene, camera, seed, _CAUSE_ERROR), (), None, camera, settings)[0]
    fine = fine_rate(scene, camera, settings, seed, rate)
    return Laboratory(base, seed, data, scene, camera, settings, image, rate, draft, fine)


def fine_rate(scene: Scene, camera: Camera, settings: CaptureSettings, seed: int, rate: Stack) -> Stack:
    """The picture with pixels a third as wide, of the brightness of the picture itself."""
    fine_camera = replace(
        camera,
        width_px=_FINER * camera.width_px,
        height_px=_FINER * camera.height_px,
        focal_length_px=_FINER * camera.focal_length_px,
        principal_point_px=_FINER * (camera.principal_point_px + 0.5) - 0.5,
    )
    fine = photographed_light(_image(scene, fine_camera, seed, _FINE_ERROR), (), None, fine_camera, settings)[0]
    return fine * (rate.mean(axis=(1, 2)) / fine.mean(axis=(1, 2)))[:, None, None]


def _binned(fine: Stack) -> Stack:
    """Means of squares of pixels."""
    bands, rows, columns = fine.shape
    return fine.reshape(bands, rows // _FINER, _FINER, columns // _FINER, _FINER).mean(axis=(2, 4))


Made = tuple[Truth, Stack, Mapping[str, Any]]
Maker = Callable[[Draw, Laboratory], Made]


def _per_rate(lab: Laboratory, changed: Stack) -> Stack:
    """Change of the signal, DN, by another rate, DN/s."""
    bright = lab.rate > 0.05 * lab.rate.mean(axis=(1, 2), keepdims=True)
    ratios = zip(lab.data.signal, lab.rate, bright & lab.data.used, strict=True)
    dn = np.array([np.median(signal[seen] / rate[seen]) for signal, rate, seen in ratios])
    return dn[:, None, None] * (changed - lab.rate)


def _counts(lab: Laboratory, counts: Stack) -> Stack:
    """Change of the signal, DN, by counts added before the division by the flat."""
    return np.broadcast_to(counts, lab.rate.shape) / np.maximum(lab.data.flat, 0.05)


def _scaled(draw: Draw, lab: Laboratory, change: Stack, most: float = np.inf) -> Stack:
    """A change of a size drawn between hardly visible and plain, at most ``most`` times as given."""
    part = float(np.sum(lab.data.whitened(change) ** 2)) / lab.data.count
    target = np.exp(draw.uniform(np.log(_LEAST_EXCESS), np.log(_MOST_EXCESS)))
    return change * min(np.sqrt(target / max(part, 1e-12)), most)


def _grid(lab: Laboratory) -> tuple[Stack, Stack]:
    rows, columns = np.indices(lab.shape).astype(float)
    return rows, columns


def _of_scene(maker: made_causes.Maker) -> Maker:
    """A cause of ``made_causes`` that changes scene or camera."""

    def made(draw: Draw, lab: Laboratory) -> Made:
        cause = maker(draw, lab.scene, lab.camera)
        total: Any = 0.0
        for seen, camera, weight in cause.pictures:
            if seen is lab.scene and camera is lab.camera:
                total = total + weight * lab.rate
                continue
            added = np.max(weight) <= 0.1
            image = _image(seen, camera, lab.seed, 0.02 if added else _CAUSE_ERROR)
            rate = photographed_light(image, (), None, camera, lab.settings)[0]
            total = total + weight * (rate if added else rate - lab.draft + lab.rate)
        truth = Truth(cause.truth.family, cause.truth.centre_px, cause.truth.surface)
        return truth, _per_rate(lab, total), {}

    return made


# Sensor: counts added ------------------------------------------------------------------------------------------------
def row_offsets(draw: Draw, lab: Laboratory) -> Made:
    """Rows are read with offsets of their own."""
    counts = draw.normal(0, 1, (1, lab.shape[0], 1)) * np.ones(lab.rate.shape)
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, counts)), {}


def column_offsets(draw: Draw, lab: Laboratory) -> Made:
    """A few columns have trapped charge, to their end."""
    counts = np.zeros(lab.shape)
    for column in draw.integers(0, lab.shape[1], int(draw.integers(2, 9))):
        counts[int(draw.integers(0, lab.shape[0] // 2)) :, column] += draw.normal(0, 1)
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, counts)), {}


def amplifier_glow(draw: Draw, lab: Laboratory) -> Made:
    """An amplifier shines on a corner of the sensor while the scene is taken."""
    rows, columns = _grid(lab)
    corner = draw.integers(0, 2, 2) * (np.array(lab.shape) - 1)
    away = np.hypot(rows - corner[0], columns - corner[1])
    glow = 1 / (1 + (away / (draw.uniform(0.06, 0.14) * lab.shape[0])) ** 2)
    by_time = lab.data.exposure_s[:, None, None] if draw.random() < 0.5 else np.ones((len(lab.rate), 1, 1))
    truth = Truth("sensor-offset", (float(corner[1]), float(corner[0])))
    return truth, _scaled(draw, lab, _counts(lab, glow * by_time)), {}


def hum(draw: Draw, lab: Laboratory) -> Made:
    """The mains hum in the read-out: a wave over rows and columns."""
    rows, columns = _grid(lab)
    frequency = draw.uniform(0.08, 0.45, 2)
    phase = 2 * np.pi * (frequency[0] * rows + frequency[1] * columns * draw.choice([-1, 1]))
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, np.sin(phase + draw.uniform(0, 6)))), {}


def light_leak(draw: Draw, lab: Laboratory) -> Made:
    """Light leaks into the camera past the filter wheel: more of it in long exposures."""
    rows, columns = (grid / lab.shape[0] for grid in _grid(lab))
    angle = draw.uniform(0, 2 * np.pi)
    leak = np.exp(draw.uniform(0.5, 2.5) * (np.cos(angle) * rows + np.sin(angle) * columns))
    counts = leak * lab.data.exposure_s[:, None, None]
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, counts)), {}


def old_darks(draw: Draw, lab: Laboratory) -> Made:
    """The darks are of another day: every pixel has another bias, and more or less dark current."""
    counts = draw.normal(0, 1, lab.shape) * np.ones((len(lab.rate), 1, 1))
    if draw.random() < 0.5:
        current = lab.data.exposure_s[:, None, None] / lab.data.exposure_s.mean()
        counts = draw.lognormal(0, 0.7, lab.shape) * current
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, counts)), {}


def hot_pixels(draw: Draw, lab: Laboratory) -> Made:
    """Radiation made pixels hot after the darks were taken."""
    hot = (draw.random(lab.shape) < draw.uniform(0.004, 0.03)) * draw.lognormal(0, 0.6, lab.shape)
    counts = hot * lab.data.exposure_s[:, None, None]
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, counts)), {}


def wrong_bit(draw: Draw, lab: Laboratory) -> Made:
    """One bit of the converter weighs too much."""
    step = 2.0 ** int(draw.integers(7, 11))
    raw = lab.data.signal * lab.data.flat + lab.settings.bias_dn
    return Truth("sensor-offset"), _scaled(draw, lab, _counts(lab, np.floor(raw / step) % 2)), {}


# Sensor: counts multiplied -------------------------------------------------------------------------------------------
def old_flats(draw: Draw, lab: Laboratory) -> Made:
    """The flats are old: every pixel's sensitivity has changed."""
    gain = draw.normal(0, 1, lab.shape)
    if draw.random() < 0.4:
        gain = gain * (draw.random(lab.shape) < draw.uniform(0.02, 0.3))
    return Truth("sensor-gain"), _scaled(draw, lab, lab.data.signal * gain, 0.06), {}


def frost(draw: Draw, lab: Laboratory) -> Made:
    """Crystals of ice on the cooled sensor: many grains of a pixel or two that scatter light away."""
    grains = (draw.random(lab.shape) < draw.uniform(0.02, 0.12)) * draw.uniform(0.3, 1, lab.shape)
    shade = gaussian_filter(grains, draw.uniform(0.25, 0.6))
    return Truth("sensor-gain"), _scaled(draw, lab, -lab.data.signal * shade, 0.3), {}


def dust(draw: Draw, lab: Laboratory) -> Made:
    """A grain on the sensor's window, out of focus: a ring or a disc of shade."""
    rows, columns = _grid(lab)
    y, x = draw.uniform(0.15, 0.85, 2) * lab.shape[0]
    away, radius = np.hypot(rows - y, columns - x), draw.uniform(0.03, 0.09) * lab.shape[0]
    shade = np.clip(radius + 0.5 - away, 0, 1)
    if draw.random() < 0.4:
        shade = shade - 0.7 * np.clip(radius / 2.2 + 0.5 - away, 0, 1)
    return Truth("sensor-gain", (float(x), float(y))), _scaled(draw, lab, -lab.data.signal * shade, 0.2), {}


def dust_everywhere(draw: Draw, lab: Laboratory) -> Made:
    """Several grains fell on the sensor's window after the flats."""
    rows, columns = _grid(lab)
    shade = np.zeros(lab.shape)
    for _ in range(int(draw.integers(3, 9))):
        y, x = draw.uniform(0, 1, 2) * lab.shape[0]
        away = np.hypot(rows - y, columns - x)
        shade += draw.uniform(0.3, 1) * np.clip(draw.uniform(0.02, 0.07) * lab.shape[0] + 0.5 - away, 0, 1)
    return Truth("sensor-gain"), _scaled(draw, lab, -lab.data.signal * shade, 0.15), {}


def fibre(draw: Draw, lab: Laboratory) -> Made:
    """A bent fibre on the sensor's window."""
    t = np.linspace(0, 1, 200)
    start, way = draw.uniform(0.25, 0.75, 2), draw.normal(0, 0.18, 2)
    bend = draw.normal(0, 0.16, 2)
    path = (start[:, None] + way[:, None] * t + bend[:, None] * t**2) * lab.shape[0]
    rows, columns = _grid(lab)
    away = np.min(np.hypot(rows[..., None] - path[0], columns[..., None] - path[1]), axis=-1)
    shade = np.clip(1.4 - away, 0, 1)
    centre = (float(path[1].mean()), float(path[0].mean()))
    return Truth("sensor-gain", centre), _scaled(draw, lab, -lab.data.signal * shade, 0.2), {}


def column_gains(draw: Draw, lab: Laboratory) -> Made:
    """Columns have amplifiers that drifted since the flats."""
    gain = draw.normal(0, 1, (1, lab.shape[1])) * np.ones(lab.shape)
    if draw.random() < 0.4:
        gain = gain.T
    return Truth("sensor-gain"), _scaled(draw, lab, lab.data.signal * gain), {}


def smooth_gain(draw: Draw, lab: Laboratory) -> Made:
    """A film of water dries on the window: smooth shades that the flats do not have."""
    shade = gaussian_filter(draw.normal(0, 1, lab.shape), draw.uniform(0.08, 0.2) * lab.shape[0], mode="reflect")
    return Truth("sensor-gain"), _scaled(draw, lab, lab.data.signal * shade / shade.std(), 0.1), {}


def rings(draw: Draw, lab: Laboratory) -> Made:
    """Interference in one filter: rings about a point beside the picture."""
    rows, columns = (grid / lab.shape[0] for grid in _grid(lab))
    y, x = draw.uniform(-0.6, 0.4, 2)
    phase = 2 * np.pi * draw.uniform(3, 7) * ((rows - y) ** 2 + (columns - x) ** 2)
    band = np.eye(len(lab.rate))[int(draw.integers(len(lab.rate)))][:, None, None]
    return Truth("sensor-gain"), _scaled(draw, lab, lab.data.signal * band * np.cos(phase)), {}


def wedge_fringes(draw: Draw, lab: Laboratory) -> Made:
    """A thin air wedge before the sensor: straight fringes in one band, or in all by their wavelength."""
    rows, columns = (grid / lab.shape[0] for grid in _grid(lab))
    angle, waves = draw.uniform(0, np.pi), draw.uniform(4, 10)
    path = np.cos(angle) * rows + np.sin(angle) * columns
    scale = 550 / lab.data.nm[:, None, None]
    strength = (
        np.ones(len(lab.rate)) if draw.random() < 0.4 else np.eye(len(lab.rate))[int(draw.integers(len(lab.rate)))]
    )
    fringe = np.cos(2 * np.pi * waves * path * scale + draw.uniform(0, 6))
    return Truth("sensor-gain"), _scaled(draw, lab, lab.data.signal * strength[:, None, None] * fringe), {}


# Image on the sensor -------------------------------------------------------------------------------------------------
def _moved(lab: Laboratory, by: Stack) -> Stack:
    """The rate with each band's picture moved by (dy, dx), px."""
    pairs = zip(lab.fine, by, strict=True)
    moved = np.array([shift(image, _FINER * np.asarray(step), order=1, mode="nearest") for image, step in pairs])
    return lab.rate + _binned(moved) - _binned(lab.fine)


def wedged_filter(draw: Draw, lab: Laboratory) -> Made:
    """One filter is a wedge and moves its picture."""
    steps = np.zeros((len(lab.rate), 2))
    steps[int(draw.integers(len(lab.rate)))] = draw.normal(0, 0.12, 2)
    return Truth("displacement"), _per_rate(lab, _moved(lab, steps)), {}


def sagging_tripod(draw: Draw, lab: Laboratory) -> Made:
    """The camera sinks while the bands are taken."""
    time = lab.data.minutes - lab.data.minutes.mean()
    steps = np.outer(time / np.abs(time).max(), draw.normal(0, 0.08, 2))
    return Truth("displacement"), _per_rate(lab, _moved(lab, steps)), {}


def warped_sensor(draw: Draw, lab: Laboratory) -> Made:
    """A warped film or a poor lens: points lie off their places by a smooth field."""
    rows, columns = _grid(lab)
    field = [gaussian_filter(draw.normal(0, 1, lab.shape), 0.18 * lab.shape[0], mode="reflect") for _ in range(2)]
    places = [
        grid + draw.uniform(0.08, 0.2) * way / way.std() for grid, way in zip((rows, columns), field, strict=True)
    ]
    moved = np.array([map_coordinates(image, _finer(places), order=1, mode="nearest") for image in lab.fine])
    return Truth("displacement"), _per_rate(lab, lab.rate + _binned(moved) - _binned(lab.fine)), {}


def _finer(places: list[Stack]) -> list[Stack]:
    """Places (y, x), px of the sensor, as places of the fine picture's pixels."""
    step = (np.arange(_FINER) - (_FINER - 1) / 2) / _FINER
    each = []
    for axis, place in enumerate(places):
        wide = np.repeat(np.repeat(place, _FINER, axis=0), _FINER, axis=1)
        within = np.tile(step, place.shape[axis])
        each.append((wide + (within[:, None] if axis == 0 else within)) * _FINER + (_FINER - 1) / 2)
    return each


def _blend(draw: Draw, lab: Laboratory, other: Stack) -> Stack:
    """Change of the signal where a part of the light takes another way, of a drawn size."""
    return _scaled(draw, lab, _per_rate(lab, other), 1.0)


def smear(draw: Draw, lab: Laboratory) -> Made:
    """The camera swings while the shutter is open."""
    angle = draw.uniform(0, np.pi)
    way = np.array([np.sin(angle), np.cos(angle)]) * draw.uniform(0.4, 1.2)
    copies = [_moved(lab, np.tile(part * way, (len(lab.rate), 1))) for part in np.linspace(-1, 1, 7)]
    return Truth("blur"), _blend(draw, lab, np.mean(copies, axis=0)), {}


def tilted_sensor(draw: Draw, lab: Laboratory) -> Made:
    """Sharp at one side only: discs of confusion that grow across the picture."""
    rows, columns = (grid / lab.shape[0] for grid in _grid(lab))
    along = rows if draw.random() < 0.5 else columns
    wide = _binned(uniform_filter(lab.fine, (0, 7, 7), mode="nearest") - lab.fine)
    return Truth("blur"), _blend(draw, lab, lab.rate + along**2 * wide), {}


def wiped_lens(draw: Draw, lab: Laboratory) -> Made:
    """Grease drawn over the lens in one direction scatters light far along the other."""
    angle = draw.uniform(0, np.pi)
    wide = np.array([rotate(image, np.degrees(angle), reshape=False, order=1, mode="nearest") for image in lab.rate])
    away = np.arange(-int(0.35 * lab.shape[0]), int(0.35 * lab.shape[0]) + 1)
    profile = np.exp(-np.abs(away) / (0.1 * lab.shape[0]))
    wide = convolve1d(wide, profile / profile.sum(), axis=2, mode="nearest")
    plain = np.array([rotate(image, np.degrees(angle), reshape=False, order=1, mode="nearest") for image in lab.rate])
    astray = np.array(
        [rotate(image, -np.degrees(angle), reshape=False, order=1, mode="nearest") for image in wide - plain]
    )
    return Truth("blur"), _blend(draw, lab, lab.rate + astray), {}


def fogged_lens(draw: Draw, lab: Laboratory) -> Made:
    """Droplets on the lens: light spreads into a wide halo."""
    width = draw.uniform(0.04, 0.15) * lab.shape[0]
    spectrum = (lab.data.nm[:, None, None] / 550) ** draw.choice([0.0, -2.0])
    halo = gaussian_filter(lab.rate, (0, width, width), mode="nearest")
    return Truth("blur"), _blend(draw, lab, lab.rate + 0.2 * spectrum * (halo - lab.rate)), {}


def soft_band(draw: Draw, lab: Laboratory) -> Made:
    """One filter is thicker, and its picture out of focus."""
    band = np.eye(len(lab.rate))[int(draw.integers(len(lab.rate)))][:, None, None]
    soft = _binned(gaussian_filter(lab.fine, (0, 2.0, 2.0), mode="nearest") - lab.fine)
    return Truth("blur"), _blend(draw, lab, lab.rate + band * soft), {}


def _astray(draw: Draw, lab: Laboratory, copy: Stack) -> Stack:
    """A faint copy of the picture is added; the lamp keeps its brightness in it."""
    return _scaled(draw, lab, _per_rate(lab, lab.rate + 0.05 * copy), 2.0)


def pane(draw: Draw, lab: Laboratory) -> Made:
    """A tilted pane before the lens: reflected twice in it, the picture appears again beside itself."""
    angle, far = draw.uniform(0, 2 * np.pi), draw.uniform(2.0, 0.2 * lab.shape[0])
    copy = _moved(lab, np.tile([far * np.sin(angle), far * np.cos(angle)], (len(lab.rate), 1)))
    return Truth("blur"), _astray(draw, lab, copy), {}


def lens_ghost(draw: Draw, lab: Laboratory) -> Made:
    """Sensor and lens mirror each other: the picture appears turned upside down, somewhat out of focus."""
    copy = gaussian_filter(lab.rate[:, ::-1, ::-1], (0, *[draw.uniform(0.3, 1.5)] * 2))
    copy = np.array([shift(image, draw.uniform(-2, 2, 2), order=1, mode="constant") for image in copy])
    return Truth("blur"), _astray(draw, lab, copy), {}


def mirror_ghost(draw: Draw, lab: Laboratory) -> Made:
    """A shiny part beside the lens mirrors the picture from left to right."""
    copy = lab.rate[:, :, ::-1] if draw.random() < 0.7 else lab.rate[:, ::-1]
    copy = np.roll(copy, int(draw.integers(-6, 7)), axis=2)
    return Truth("blur"), _astray(draw, lab, copy), {}


def double_exposure(draw: Draw, lab: Laboratory) -> Made:
    """A part of an earlier picture of the box is in the frame, taken with the camera turned or elsewhere."""
    turns, step = int(draw.integers(1, 4)), draw.uniform(-5, 5, 2)
    copy = np.array([shift(image, step, order=1) for image in np.rot90(lab.rate, turns, axes=(1, 2))])
    return Truth("blur"), _astray(draw, lab, copy), {}


def trailing_charge(draw: Draw, lab: Laboratory) -> Made:
    """Charge stays behind in the register and comes out behind its pixel: tails along rows or columns."""
    away = np.arange(int(0.5 * lab.shape[0]))
    length = draw.uniform(1.0, 6.0)
    release = np.exp(-away / length) * (away > 0)
    axis, way = int(draw.integers(1, 3)), int(draw.choice([-1, 1]))
    counts = lab.rate * lab.data.flat
    if way < 0:
        counts = np.flip(counts, axis)
    trail = np.apply_along_axis(lambda line: np.convolve(line, release / release.sum())[: len(line)], axis, counts)
    change = trail - counts
    if way < 0:
        change = np.flip(change, axis)
    return Truth("blur"), _blend(draw, lab, lab.rate + 0.3 * change / np.maximum(lab.data.flat, 0.05)), {}


# Time ----------------------------------------------------------------------------------------------------------------
def _timed(lab: Laboratory, levels: Stack, repeats: Stack | None = None) -> tuple[Stack, Mapping[str, Any]]:
    """Change by a level of the lamp in each band; ``repeats`` (band, repeat) are levels of its frames."""
    change = lab.data.signal * levels[:, None, None]
    return change, {} if repeats is None else {"repeats": lab.data.repeats + repeats}


def lamp_step(draw: Draw, lab: Laboratory) -> Made:
    """The lamp falls to a lower level, for the rest or for a while."""
    rank = np.argsort(np.argsort(lab.data.minutes))
    first, last = sorted(draw.choice(len(rank) + 1, 2, replace=False))
    inside = ((rank >= first) & (rank < last)).astype(float)
    change, more = _timed(lab, draw.choice([-1, 1]) * inside)
    return Truth("time-order"), _scaled(draw, lab, change, 0.1), more


def lamp_drift(draw: Draw, lab: Laboratory) -> Made:
    """The lamp warms up, or ages, while the bands are taken."""
    time = lab.data.minutes - lab.data.minutes.min()
    levels = 1 - np.exp(-time / (draw.uniform(0.15, 0.8) * time.max()))
    change, more = _timed(lab, draw.choice([-1, 1]) * levels)
    return Truth("time-order"), _scaled(draw, lab, change, 0.1), more


def flicker(draw: Draw, lab: Laboratory) -> Made:
    """The lamp's level is another in every frame."""
    frames = np.where(np.isfinite(lab.data.repeats), draw.normal(0, 0.012, lab.data.repeats.shape), np.nan)
    mean = np.nanmean(frames, axis=1)
    change, more = _timed(lab, mean, frames - mean[:, None])
    return Truth("time-order"), change, more


def persistence(draw: Draw, lab: Laboratory) -> Made:
    """A part of each frame's charge stays in the sensor and is read with the next frame."""
    part, counts = draw.uniform(0.002, 0.01), lab.data.signal * lab.data.flat
    frames = np.maximum(np.isfinite(lab.data.repeats).sum(axis=1), 1)
    order, change = np.argsort(lab.data.minutes, kind="stable"), np.zeros(counts.shape)
    for place, band in enumerate(order):
        earlier = counts[order[place - 1]] if place else 0.0 * counts[band]
        change[band] = part * ((frames[band] - 1) * counts[band] + earlier) / frames[band]
    return Truth("time-order"), _counts(lab, change), {}


# Lamp, paints, filters -----------------------------------------------------------------------------------------------
def _cube(lab: Laboratory) -> Stack:
    """(y, x, w) spectral radiance of the render."""
    mean, _ = lab.image.project(np.eye(len(WAVELENGTH_NM)))
    return np.asarray(mean)


def _responses(lab: Laboratory) -> tuple[Stack, Stack]:
    """(band, w) transmittances of the filters, and the responses of the rest."""
    factors = unit_factors(lab.settings, lab.camera.width_px)
    inside = [int(np.argmin(np.abs(factors.grid.nm - nm))) for nm in WAVELENGTH_NM]
    return factors.transmittance[:, inside], factors.rest[:, inside] * factors.factor[:, None]


def hotter_lamp(draw: Draw, lab: Laboratory) -> Made:
    """The lamp burns hotter or colder than when its table was measured, at the same power."""
    kelvin = 3000 + draw.choice([-1, 1]) * draw.uniform(10, 60)
    factor = np.exp(-1.4388e7 / WAVELENGTH_NM * (1 / kelvin - 1 / 3000))
    transmittance, rest = _responses(lab)
    weights = (transmittance * rest).T
    cube = _cube(lab)
    return Truth("lamp-spectrum"), _per_rate(lab, lab.rate * _ratio(cube * factor @ weights, cube @ weights)), {}


def _ratio(new: Stack, old: Stack) -> Stack:
    return np.moveaxis(new / np.maximum(old, 1e-12), -1, 0)


def gas_lines(draw: Draw, lab: Laboratory) -> Made:
    """The lamp has lines of a gas that its table lacks."""
    lines = draw.uniform(410, 690, int(draw.integers(1, 4)))
    lamp = lab.scene.lamp.radiance.at(WAVELENGTH_NM)
    more = sum(draw.uniform(0.3, 1) * np.exp(-(((WAVELENGTH_NM - nm) / 3) ** 2)) for nm in lines)
    factor = 1 + draw.uniform(0.05, 0.4) * lamp.mean() * more / lamp
    transmittance, rest = _responses(lab)
    weights = (transmittance * rest).T
    cube = _cube(lab)
    return Truth("lamp-spectrum"), _per_rate(lab, lab.rate * _ratio(cube * factor @ weights, cube @ weights)), {}


def uneven_lamp_by_colour(draw: Draw, lab: Laboratory) -> Made:
    """The lamp's cover scatters blue light wider than red: another lobe in each band."""
    t, bands = lab.data.transport, len(lab.rate)
    exponent = draw.uniform(0.05, 0.3) * (lab.data.nm - lab.data.nm.mean()) / np.ptp(lab.data.nm)
    lamp = lab.scene.lamp.surface.vertices_mm.mean(axis=0)

    def lobe(points: Stack) -> Stack:
        way = points - lamp
        cosine = np.clip(-way[:, 1] / np.maximum(np.linalg.norm(way, axis=1), 1), 0.02, 1)
        return cosine[:, None] ** exponent * (exponent + 2) / 2

    picture = np.zeros((bands, lab.shape[0] * lab.shape[1]))
    old = picture.copy()
    for band in range(bands):
        rho = t.reflectance[t.patch_material, band]
        for image, factors in ((picture, (lobe(t.position), lobe(t.patch_position))), (old, (1, 1))):
            fragment, patch = (f if np.isscalar(f) else f[:, band] for f in factors)
            radiosity = np.linalg.solve(
                np.eye(len(rho)) - rho[:, None] * t.form_factors, rho * t.patch_direct[:, band] * patch
            )
            arriving = t.direct[:, band] * fragment + t.gather @ radiosity
            image[band] = np.bincount(t.pixel, t.coverage * t.reflectance[t.material, band] * arriving, image.shape[1])
    ratio = np.where(old > 0, picture / np.maximum(old, 1e-12), 1.0).reshape(lab.rate.shape)
    return Truth("lamp-spectrum"), _per_rate(lab, lab.rate * ratio), {}


def aged_paints(draw: Draw, lab: Laboratory) -> Made:
    """All paints yellowed: they reflect less blue, each otherwise."""
    scene = lab.scene
    for name in tuple(scene.materials):
        factor = 1 - draw.uniform(0.005, 0.05) * np.exp(-(((WAVELENGTH_NM - 400) / draw.uniform(40, 90)) ** 2))
        scene = _repainted(scene, name, factor)
    return Truth("paint-spectrum"), _of_other_scene(lab, scene), {}


def other_batch(draw: Draw, lab: Laboratory) -> Made:
    """One wall or one block was painted with another batch: lighter, darker, or of another hue."""
    surface = lab.scene.surfaces[int(draw.integers(len(lab.scene.surfaces)))]
    old = lab.scene.materials[surface.material]
    x = (WAVELENGTH_NM - 550) / 150
    factor = 1 + draw.normal(0, 0.02) * np.tanh(2 * x) + draw.normal(0, 0.02) * np.exp(-((x / 0.3) ** 2))
    new = replace(
        old,
        name="batch",
        reflectance=Spectrum(WAVELENGTH_NM, np.clip(old.reflectance.at(WAVELENGTH_NM) * factor, 0, 1)),
    )
    surfaces = tuple(replace(s, material="batch") if s is surface else s for s in lab.scene.surfaces)
    scene = replace(lab.scene, surfaces=surfaces, materials={**lab.scene.materials, "batch": new})
    return Truth("paint-spectrum", None, surface.name), _of_other_scene(lab, scene), {}


def _repainted(scene: Scene, material: str, factor: Stack) -> Scene:
    old = scene.materials[material]
    values = np.clip(old.reflectance.at(WAVELENGTH_NM) * factor, 0, 1)
    return replace(
        scene, materials={**scene.materials, material: replace(old, reflectance=Spectrum(WAVELENGTH_NM, values))}
    )


def _of_other_scene(lab: Laboratory, scene: Scene) -> Stack:
    """Change of the signal by another scene; both renders have the same random numbers."""
    image = _image(scene, lab.camera, lab.seed, _CAUSE_ERROR)
    other = photographed_light(image, (), None, lab.camera, lab.settings)[0]
    return _per_rate(lab, lab.rate + other - lab.draft)


def _of_filters(lab: Laboratory, changed: Stack, in_references: bool) -> Stack:
    """Change by other transmittances (band, w); references and flats see the sphere through them too."""
    transmittance, rest = _responses(lab)
    cube = _cube(lab)
    ratio = _ratio(cube @ (changed * rest).T, cube @ (transmittance * rest).T)
    if in_references:
        sphere = 1e-5 * 1 / (WAVELENGTH_NM**5.0) / (np.exp(1.4388e7 / (WAVELENGTH_NM * 2856.0)) - 1)
        level = (changed * rest) @ sphere / ((transmittance * rest) @ sphere)
        ratio = ratio / level[:, None, None]
    return _per_rate(lab, lab.rate * ratio)


def red_leak(draw: Draw, lab: Laboratory) -> Made:
    """One filter lets light through far from its band."""
    transmittance, _ = _responses(lab)
    band = int(draw.integers(len(transmittance)))
    peaks = WAVELENGTH_NM[np.argmax(transmittance, axis=1)]
    far = draw.choice(WAVELENGTH_NM[np.abs(WAVELENGTH_NM - peaks[band]) > 70])
    changed = transmittance.copy()
    changed[band] += draw.uniform(0.001, 0.012) * np.exp(-(((WAVELENGTH_NM - far) / draw.uniform(10, 40)) ** 2))
    return Truth("filter-curve"), _of_filters(lab, changed, bool(draw.random() < 0.6)), {}


def next_filters_light(draw: Draw, lab: Laboratory) -> Made:
    """The wheel stops early: a part of the light passes the next filter."""
    transmittance, _ = _responses(lab)
    band = int(draw.integers(len(transmittance)))
    other = (band + int(draw.choice([-1, 1]))) % len(transmittance)
    part, changed = draw.uniform(0.003, 0.03), transmittance.copy()
    changed[band] = (1 - part) * transmittance[band] + part * transmittance[other]
    return Truth("filter-curve"), _of_filters(lab, changed, bool(draw.random() < 0.5)), {}


def wrong_table(draw: Draw, lab: Laboratory) -> Made:
    """One filter's table is of another piece: its curve is shifted and wider."""
    transmittance, _ = _responses(lab)
    band, nm = int(draw.integers(len(transmittance))), WAVELENGTH_NM
    changed = transmittance.copy()
    changed[band] = np.interp(
        nm - draw.choice([-1, 1]) * draw.uniform(2, 8), nm, gaussian_filter1d(transmittance[band], draw.uniform(0.5, 3))
    )
    return Truth("filter-curve"), _of_filters(lab, changed, True), {}


# Surfaces ------------------------------------------------------------------------------------------------------------
def gradient(draw: Draw, lab: Laboratory) -> Made:
    """Paint rolled unevenly over one wall: smooth shades along it, with what they reflect further left out."""
    names = [n for n in lab.data.names if n not in ("short-block", "tall-block")]
    surface = lab.data.names.index(str(draw.choice(names)))
    t = lab.data.transport
    on = t.surface == surface
    low, extent = t.position[on].min(axis=0), np.maximum(np.ptp(t.position[on], axis=0), 1.0)
    x = (t.position - low) / extent
    shade = np.sin(
        draw.uniform(1.5, 4) * x[:, 0]
        + draw.uniform(1.5, 4) * x[:, 1]
        + draw.uniform(1.5, 4) * x[:, 2]
        + draw.uniform(0, 6)
    )
    map_ = np.bincount(t.pixel, t.coverage * on * shade, lab.shape[0] * lab.shape[1]).reshape(lab.shape)
    colour = 1 + draw.uniform(-0.5, 0.5) * (lab.data.nm - 550) / 150
    change = lab.data.signal * map_ * colour[:, None, None]
    return Truth("reflectance-map", None, lab.data.names[surface]), _scaled(draw, lab, change, 0.12), {}


def shiny_plate(draw: Draw, lab: Laboratory) -> Made:
    """A thin clear plate lies on the floor: it mirrors the box behind it, traced from the picture itself."""
    t = lab.data.transport
    floor = lab.data.names.index("floor")
    centre = np.array([draw.uniform(300, 480), 0.0, draw.uniform(40, 180)])
    angle, half = draw.uniform(0, np.pi), draw.uniform(25, 60, 2)
    local = t.position - centre
    along = local[:, 0] * np.cos(angle) + local[:, 2] * np.sin(angle)
    across = -local[:, 0] * np.sin(angle) + local[:, 2] * np.cos(angle)
    on = (t.surface == floor) & (np.abs(along) < half[0]) & (np.abs(across) < half[1])
    eye = lab.camera.position_mm
    way = t.position - eye
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    cosine = np.abs(way[:, 1])
    mirrored = way * [1, -1, 1]
    seen = np.zeros((len(t.pixel), len(lab.rate)))
    box = np.array([[0.0, 0, 0], [556, 548.8, 559.2]])
    for f in np.flatnonzero(on):
        limit = np.where(mirrored[f] > 0, box[1], box[0])
        distance = np.min(np.where(np.abs(mirrored[f]) > 1e-9, (limit - t.position[f]) / mirrored[f], np.inf))
        hit = t.position[f] + distance * mirrored[f]
        u, v = lab.camera.project(hit[None])[0]
        if 0 <= u < lab.shape[1] - 1 and 0 <= v < lab.shape[0] - 1:
            seen[f] = lab.rate[:, round(v), round(u)]
    n = 1.5
    inner = np.sqrt(1 - (1 - cosine**2) / n**2)
    fresnel = 0.5 * (
        ((cosine - n * inner) / (cosine + n * inner)) ** 2 + ((inner - n * cosine) / (inner + n * cosine)) ** 2
    )
    both = 2 * fresnel / (1 + fresnel)
    change = []
    for band in range(len(lab.rate)):
        own = lab.rate[band].ravel()[t.pixel]
        change.append(np.bincount(t.pixel, t.coverage * on * both * (seen[:, band] - own), lab.shape[0] * lab.shape[1]))
    picture = np.reshape(change, lab.rate.shape)
    place = lab.camera.project(centre[None])[0]
    truth = Truth("reflection-lobe", (float(place[0]), float(place[1])), "floor")
    return truth, _per_rate(lab, lab.rate + picture), {}


def velvet(draw: Draw, lab: Laboratory) -> Made:
    """Dusty white paint: fibres brighten it at grazing view, and it is darker where light comes steeply."""
    t = lab.data.transport
    white = t.material == lab.data.materials.index("white")
    lobe = draw.uniform(0.02, 0.15) * (1 - t.view) ** 3 - draw.uniform(0, 0.08) * (1 - t.incidence) ** 2
    map_ = np.bincount(t.pixel, t.coverage * white * lobe, lab.shape[0] * lab.shape[1]).reshape(lab.shape)
    return Truth("reflection-lobe"), _scaled(draw, lab, lab.data.signal * map_, 2.0), {}


def window(draw: Draw, lab: Laboratory) -> Made:
    """Daylight from the room falls through the opening: brighter towards the front, bluish."""
    t = lab.data.transport
    source = np.array([draw.uniform(0, 556), draw.uniform(100, 549), -draw.uniform(300, 900)])
    way = source - t.position
    distance = np.linalg.norm(way, axis=1)
    normals = np.zeros((len(t.pixel), 3))
    for index, name in enumerate(lab.data.names):
        axis = {"floor": (0, 1, 0), "ceiling": (0, -1, 0), "back": (0, 0, -1), "right": (1, 0, 0), "left": (-1, 0, 0)}
        normals[t.surface == index] = axis.get(name, (0, 0.5, -0.8))
    light = np.clip(np.sum(way / distance[:, None] * normals, axis=1), 0, 1) / (distance / 500) ** 2
    spectrum = (lab.data.nm / 550) ** -3
    change = []
    for band in range(len(lab.rate)):
        bounced = t.gather @ (t.reflectance[t.patch_material, band] * 0.15)
        value = t.reflectance[t.material, band] * (light + bounced) * spectrum[band]
        change.append(np.bincount(t.pixel, t.coverage * value, lab.shape[0] * lab.shape[1]))
    picture = np.reshape(change, lab.rate.shape) * lab.data.exposure_s[:, None, None]
    return Truth("extra-light"), _scaled(draw, lab, picture / picture.mean() * lab.data.signal.mean()), {}


# Not covered by any family -------------------------------------------------------------------------------------------
def cosmic_rays(draw: Draw, lab: Laboratory) -> Made:
    """Charged particles hit single frames: pixels of one band each."""
    hits = (draw.random(lab.rate.shape) < draw.uniform(0.003, 0.02)) * draw.lognormal(0, 1, lab.rate.shape)
    return Truth("none"), _scaled(draw, lab, _counts(lab, hits)), {}


def compression(draw: Draw, lab: Laboratory) -> Made:
    """Frames went through a lossy compression in blocks of 8 x 8 pixels."""
    step = draw.uniform(4, 30)
    raw = lab.data.signal * lab.data.flat
    rows, columns = (n - n % 8 for n in lab.shape)
    blocks = raw[:, :rows, :columns].reshape(len(raw), rows // 8, 8, columns // 8, 8)
    noisy = blocks + draw.normal(0, 3, blocks.shape)
    weights = 1 + np.add.outer(np.arange(8), np.arange(8))
    coefficients = dctn(noisy, axes=(2, 4), norm="ortho") / (step * weights[:, None, :])
    squeezed = idctn(np.round(coefficients) * step * weights[:, None, :], axes=(2, 4), norm="ortho")
    change = np.zeros(raw.shape)
    change[:, :rows, :columns] = (squeezed - noisy).reshape(len(raw), rows, columns)
    return Truth("none"), _counts(lab, change), {}


def heat_haze(draw: Draw, lab: Laboratory) -> Made:
    """Warm air before the lens: small places of each band's picture move by themselves."""
    rows, columns = _grid(lab)
    moved = []
    for image in lab.fine:
        field = [gaussian_filter(draw.normal(0, 1, lab.shape), 2.0) for _ in range(2)]
        places = [grid + 0.25 * way / way.std() for grid, way in zip((rows, columns), field, strict=True)]
        moved.append(map_coordinates(image, _finer(places), order=1, mode="nearest"))
    change = _per_rate(lab, lab.rate + _binned(np.array(moved)) - _binned(lab.fine))
    return Truth("none"), _scaled(draw, lab, change, 3.0), {}


def moved_block(draw: Draw, lab: Laboratory) -> Made:
    """A block was pushed, turned and tilted after the survey, by more than a survey errs."""
    name, surfaces = str(draw.choice(["short-block", "tall-block"])), []
    for surface in lab.scene.surfaces:
        if surface.name == name:
            vertices = surface.vertices_mm
            foot = np.array([vertices[:, 0].mean(), 0.0, vertices[:, 2].mean()])
            turn = Rotation.from_euler("xyz", draw.normal(0, [0.5, 1.0, 0.5]), degrees=True)
            surface = replace(surface, vertices_mm=turn.apply(vertices - foot) + foot + draw.normal(0, [2, 0, 2]))
        surfaces.append(surface)
    return Truth("none"), _of_other_scene(lab, replace(lab.scene, surfaces=tuple(surfaces))), {}


def telegraph_noise(draw: Draw, lab: Laboratory) -> Made:
    """Pixels jump between two levels: each frame has another pattern."""
    states = draw.choice([-1, 1], lab.rate.shape) * (draw.random(lab.shape) < draw.uniform(0.05, 0.4))
    return Truth("none"), _scaled(draw, lab, _counts(lab, states * draw.lognormal(0, 0.5, lab.shape))), {}


def torn_frame(draw: Draw, lab: Laboratory) -> Made:
    """The transfer of one frame broke off: below a row it repeats the lines before, in one band."""
    band, row = int(draw.integers(len(lab.rate))), int(draw.uniform(0.3, 0.9) * lab.shape[0])
    slip = int(draw.integers(1, 4))
    changed = lab.rate.copy()
    changed[band, row:] = np.roll(changed[band], slip, axis=1)[row:]
    part = 1 / max(int(np.isfinite(lab.data.repeats[band]).sum()), 1)
    return Truth("none"), _per_rate(lab, lab.rate + part * (changed - lab.rate)), {}


def sound(draw: Draw, lab: Laboratory) -> Made:
    """No cause but the flaws of the box."""
    return Truth("sound"), np.zeros(lab.rate.shape), {}


#: By name, every cause.
CAUSES: Mapping[str, Maker] = {
    **{
        maker.__name__: _of_scene(maker)
        for maker in (
            made_causes.ball,
            made_causes.rod,
            made_causes.thread,
            made_causes.floor_stain,
            made_causes.wall_stain,
            made_causes.soot,
            made_causes.bleached,
            made_causes.second_lamp,
            made_causes.sun_blade,
            made_causes.pilot_light,
        )
    },
    **{
        maker.__name__: maker
        for maker in (
            row_offsets, column_offsets, amplifier_glow, hum, light_leak, old_darks, hot_pixels, wrong_bit,
            old_flats, frost, dust, dust_everywhere, fibre, column_gains, smooth_gain, rings, wedge_fringes,
            wedged_filter, sagging_tripod, warped_sensor,
            smear, tilted_sensor, wiped_lens, fogged_lens, soft_band, pane, lens_ghost, mirror_ghost, double_exposure,
            trailing_charge,
            lamp_step, lamp_drift, flicker, persistence,
            hotter_lamp, gas_lines, uneven_lamp_by_colour, aged_paints, other_batch,
            red_leak, next_filters_light, wrong_table,
            gradient, shiny_plate, velvet, window,
            cosmic_rays, compression, heat_haze, moved_block, telegraph_noise, torn_frame,
            sound,
        )
    },
}  # fmt: skip


def excess_of(name: str, seed: int, lab: Laboratory) -> tuple[Truth, ResidualData]:
    """The excess of a laboratory's capture with a cause, and the truth about it."""
    draw = np.random.default_rng([seed, *name.encode()])
    truth, change, others = CAUSES[name](draw, lab)
    return truth, replace(lab.data.with_change(change), **others)
