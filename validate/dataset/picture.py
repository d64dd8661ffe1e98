"""One picture of a data set: the cube of a box through a camera, with the truth about it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.rendering.dataset import (
    REFLECTIONS,
    Box,
    Recipe,
    SensorTable,
    joined_scene,
    light_parts,
    mixed_pixels,
    mixed_scenes,
    shadow_fraction,
    split_image,
    visible_points,
)
from cboxlab.rendering.files import RADIANCE_UNIT, camera_attribute, raw_to_srgb, scene_white, strip_cameras
from cboxlab.rendering.image import NOTHING, RenderedImage, RenderJob
from cboxlab.rendering.integrators import MOST_PASSES, fireflies, relative_errors, render_to_precision
from cboxlab.rendering.model import model_cube_inputs
from cboxlab.rendering.photometry import tristimulus_weights
from cboxlab.rendering.sensor import auto_exposure, load_camera, simulate_frame
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from numpy.typing import NDArray

from ..predict import Coated, coated

__all__ = ["STRIP_PIXELS", "mean_spectrum", "render_pictures", "rounded", "sensor_camera", "visible_weights"]

#: Bits of the mantissa of a number in single precision.
_FULL_BITS = 23

#: Percentile of the relative standard errors of a picture that a recipe asks for.
_MEDIAN = 50.0

#: Percentile of the noisiest hundredth.
_HIGH = 99.0

#: Part of the error that is asked for where a picture is rendered again: the error of an error by eight batches.
_RESERVE = 0.9

#: Pixels of a strip of rows, in which larger pictures are rendered: a strip takes up to 0.7 GB of memory.
STRIP_PIXELS = 2**16

#: Unit of irradiance.
_IRRADIANCE_UNIT = "W m^-2 nm^-1"


def render_pictures(
    boxes: Sequence[Box], camera_name: str, recipe: Recipe, folder: Path, progress: Progress = NO_PROGRESS
) -> Iterator[xr.Dataset]:
    """Pictures of boxes by one of their cameras, from the same rays.

    Parameters
    ----------
    boxes
        Boxes that may share rays (``sharing_rays``).
    camera_name
        Name of the camera.
    recipe
        The recipe, for wavelengths, noise, truths and sensors.
    folder
        Folder of the recipe, to which files of sensor cameras are relative.
    progress
        Receives the completed share.

    Yields
    ------
    xr.Dataset
        Picture of each box: the variables of docs/reference/data-set-format.md, rounded as the recipe asks.

    Raises
    ------
    InputError
        If an effect or a sensor does not fit.
    """
    inputs = [model_cube_inputs(box.model, box.cameras[camera_name]) for box in boxes]
    scenes, camera, bounces = [scene for scene, _, _ in inputs], *inputs[0][1:]
    strips = strip_cameras(camera, max(1, STRIP_PIXELS // camera.width_px))
    mixed = mixed_scenes(scenes)
    views = [_View(mixed, scenes[0], strip, bounces, camera_name, number) for number, strip in enumerate(strips)]
    progresses = [share(progress, n / len(views), (n + 1) / len(views)) for n in range(len(views))]
    pictures = [_strip_pictures(boxes, view, recipe, part) for view, part in zip(views, progresses, strict=True)]
    # of several strips one at a time is rendered, with all its boxes
    each = pictures if len(views) == 1 else map(list, pictures)
    for box, parts in zip(boxes, zip(*each, strict=True), strict=True):
        yield _with_frames(_joined(parts), box, camera_name, recipe, folder)


@dataclass(frozen=True, eq=False)
class _View:
    """Some rows of a picture of boxes that share rays."""

    #: Scenes of the boxes, with mixed surfaces for textures.
    scenes: list[Scene]
    #: Scene of the first box with its textures.
    textured: Scene
    #: Camera of the rows.
    camera: Camera
    #: Largest number of reflections; None for no limit.
    bounces: int | None
    #: Name of the camera.
    camera_name: str
    #: Number of the strip, from the top.
    strip: int


def _strip_pictures(boxes: Sequence[Box], view: _View, recipe: Recipe, progress: Progress) -> Iterator[xr.Dataset]:
    """Strip of the picture of each box, to the noise that the recipe asks for."""
    each_nm, seed, scenes, camera = recipe.picture.wavelength_nm, boxes[0].seed, view.scenes, view.camera
    joined, grid = joined_scene(scenes, each_nm)
    pictures = len(boxes[0].cameras) * recipe.boxes_per_geometry
    first = MOST_PASSES * (_order(boxes[0], view.camera_name, recipe) + pictures * view.strip)
    job = RenderJob(joined, camera, grid, seed=seed, max_bounces=view.bounces, first_batch=first)
    image = render_to_precision(job, recipe.picture.noise, progress=progress, pictures=len(boxes))
    geometry = _geometry(image, view.textured, camera, seed + view.strip)
    mixed_shares = mixed_pixels(joined, camera)
    for number, (box, scene) in enumerate(zip(boxes, scenes, strict=True)):
        part = split_image(image, len(boxes), each_nm)[number]
        changes = coated(part, scene, camera, box.model.effects, box.seed + view.strip, view.bounces)
        reached, limit = relative_errors(changes.image, (_MEDIAN,))[0], recipe.picture.noise
        if reached > limit:  # an effect takes light and leaves its error: the picture needs more rays
            finer = render_to_precision(job, limit * limit / reached * _RESERVE, pictures=len(boxes))
            part = split_image(finer, len(boxes), each_nm)[number]
            changes = coated(part, scene, camera, box.model.effects, box.seed + view.strip, view.bounces)
        yield _picture(recipe, scene, image=part, changes=changes, geometry=geometry, mixed_shares=mixed_shares)


def _order(box: Box, camera_name: str, recipe: Recipe) -> int:
    """Number of a picture among those of one geometry."""
    variant = box.number % recipe.boxes_per_geometry
    return variant * len(box.cameras) + list(box.cameras).index(camera_name)


def _picture(
    recipe: Recipe,
    scene: Scene,
    *,
    image: RenderedImage,
    changes: Coated,
    geometry: Mapping[str, Any],
    mixed_shares: Mapping[int, NDArray[np.float64]],
) -> xr.Dataset:
    """Picture of a box from its image without effects on light transport, and with them."""
    median, high = relative_errors(changes.image, (_MEDIAN, _HIGH))
    data = {**_light(image, changes, scene, mixed_shares), **geometry}
    cube = xr.Dataset(
        {name: value for name, value in data.items() if name in _variables(recipe)},
        coords={"wavelength": ("wavelength", recipe.picture.wavelength_nm, {"units": "nm"})},
        attrs={
            "relative_standard_error": median,
            "relative_standard_error_99": high,
            "firefly_pixels": int(fireflies(changes.image).sum()),
        },
    )
    return cube.assign({name: rounded(value, recipe.picture.mantissa_bits) for name, value in cube.data_vars.items()})


def _joined(strips: Sequence[xr.Dataset]) -> xr.Dataset:
    """Picture of its strips: median of their median errors, largest 99 % error."""
    if len(strips) == 1:
        return strips[0]
    errors = [strip.attrs["relative_standard_error"] for strip in strips]
    return xr.concat(strips, "y", combine_attrs="override").assign_attrs(
        relative_standard_error=float(np.median(errors)),
        relative_standard_error_99=max(strip.attrs["relative_standard_error_99"] for strip in strips),
        firefly_pixels=sum(strip.attrs["firefly_pixels"] for strip in strips),
    )


def _with_frames(cube: xr.Dataset, box: Box, camera_name: str, recipe: Recipe, folder: Path) -> xr.Dataset:
    """Picture of a box with its raw frames, and the names of what it shows."""
    order, camera = _order(box, camera_name, recipe), model_cube_inputs(box.model, box.cameras[camera_name])[1]
    for index, sensor in enumerate(recipe.sensor):
        cube = cube.assign(_frames(cube, sensor, folder, box.seed + 7919 * (order + 1) + 104729 * index))
    later = [e.id for e in box.model.effects if e.stage not in ("scene", "settings", "transport", "camera")]
    return cube.assign_attrs(
        box=box.number,
        camera_name=camera_name,
        camera=camera_attribute(camera),
        part=box.part,
        seed=str(box.seed),
        effects=", ".join(e.id for e in box.model.effects),
        effects_left_out=", ".join(later),
    )


def _variables(recipe: Recipe) -> set[str]:
    """Variables of every picture, and the truths that a recipe lists."""
    return {"radiance", "standard_error", "surface", "material", *recipe.picture.truths}


def _light(
    image: RenderedImage, changes: Coated, scene: Scene, mixed_shares: Mapping[int, NDArray[np.float64]]
) -> dict[str, Any]:
    """Radiance, its errors and its parts; `changes` has the effects of light transport."""
    every = np.eye(image.wavelength_nm.size)
    changed = changes.image
    mean, variance = changed.project(every)
    axes, unit = ("y", "x", "wavelength"), {"units": RADIANCE_UNIT}
    parts = light_parts(image, scene, mixed_shares)
    added = changed.mean(every) - image.mean(every) if changed is not image else np.zeros_like(mean)
    irradiance, specular = parts.irradiance, changes.specular
    if changes.coats is not image:
        at_base = changes.coats.mean(every) - image.mean(every) - specular
        reflects = parts.albedo > 0
        irradiance = irradiance + np.pi * np.divide(at_base, parts.albedo, out=np.zeros_like(mean), where=reflects)
        specular = np.where(reflects, specular, specular + at_base)  # the difference is of rounding
    names = ("order", *axes)
    return {
        "radiance": (axes, mean, unit),
        "standard_error": (axes, np.sqrt(variance), {**unit, "batches": len(changed.coefficients)}),
        "xyz": (
            ("y", "x", "tristimulus"),
            mean @ visible_weights(image.wavelength_nm),
            {"units": "cd m^-2", "names": "X, Y, Z"},
        ),
        "albedo": (axes, parts.albedo, {"units": "1"}),
        "irradiance": (axes, irradiance, {"units": _IRRADIANCE_UNIT}),
        "specular": (axes, specular, unit),
        "reflections": (names, parts.reflections, {**unit, "names": ", ".join(REFLECTIONS)}),
        "effects_light": (axes, added, unit),
    }


def visible_weights(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights from radiance to X, Y, Z.

    Parameters
    ----------
    wavelength_nm
        (w,) wavelengths, nm.

    Returns
    -------
    NDArray
        (w, 3) weights; 0 for wavelengths without visible light.
    """
    try:
        return tristimulus_weights(wavelength_nm)
    except InputError:
        return np.zeros((wavelength_nm.size, 3))


def _geometry(image: RenderedImage, scene: Scene, camera: Camera, seed: int) -> dict[str, Any]:
    """Labels, coverage, and what the rays through the pixel centres meet."""
    points = visible_points(scene, camera)
    surfaces, materials = [s.name for s in scene.surfaces], list(scene.materials)
    count = len(surfaces)
    coverage = np.stack([image.coverage[..., image.facet_surface == s].sum(-1) for s in range(count + 1)], axis=-1)
    of_surface = np.array([materials.index(s.material) for s in scene.surfaces] + [len(materials)])
    material = np.where(points.surface == NOTHING, NOTHING, of_surface[points.surface]).astype(np.int16)
    flags = {"nothing": NOTHING}
    return {
        "surface": (("y", "x"), image.surface, {"names": ", ".join(surfaces), "lamp": -1, **flags}),
        "material": (("y", "x"), material, {"names": ", ".join([*materials, "lamp"]), **flags}),
        "coverage": (("y", "x", "label"), coverage, {"units": "1", "names": ", ".join([*surfaces, "lamp"])}),
        "depth": (("y", "x"), points.depth_mm, {"units": "mm"}),
        "position": (("y", "x", "axis"), points.position_mm, {"units": "mm"}),
        "normal": (("y", "x", "axis"), points.normal, {"units": "1"}),
        "shadow": (("lamp", "y", "x"), shadow_fraction(scene, camera, seed), {"units": "1"}),
    }


def rounded(values: xr.DataArray, bits: int) -> xr.DataArray:
    """Numbers in single precision with fewer bits in the mantissa.

    Parameters
    ----------
    values
        Numbers; whole ones are returned as they are.
    bits
        Bits to keep, 1 to 23; the relative error is at most 2^-(bits + 1).

    Returns
    -------
    xr.DataArray
        The nearest such numbers, ties to even.
    """
    if values.dtype.kind != "f":
        return values
    plain = np.ascontiguousarray(values.values, np.float32)
    drop = _FULL_BITS - bits
    if drop > 0:
        pattern = plain.view(np.uint32).astype(np.uint64)
        pattern += (1 << (drop - 1)) - 1 + ((pattern >> drop) & 1)
        short = ((pattern >> drop) << drop).astype(np.uint32).view(np.float32)
        plain = np.where(np.isfinite(plain), short, plain)
    return values.copy(data=plain)


def sensor_camera(sensor: SensorTable, folder: Path) -> Any:
    """Camera of a sensor's table.

    Parameters
    ----------
    sensor
        The table.
    folder
        Folder of the recipe, to which a camera file is relative.

    Returns
    -------
    SensorCamera
        The camera.

    Raises
    ------
    InputError
        If the camera is unknown or its file faulty.
    """
    return load_camera(folder / sensor.camera if sensor.camera.endswith(".toml") else sensor.camera)


def _frames(cube: xr.Dataset, sensor: SensorTable, folder: Path, seed: int) -> Mapping[str, Any]:
    """Raw frames of a picture by a sensor, and developed ones where its mosaic is Bayer's."""
    camera = sensor_camera(sensor, folder)
    cut = cube[["radiance", "standard_error", "surface"]]
    channels = [None] if camera.pattern is not None or len(camera.channels) == 1 else list(camera.channels)
    frames, exposures = [], []
    for number, channel in enumerate(channels):
        usual = auto_exposure(cut, camera, channel)
        for index, factor in enumerate(sensor.exposures):
            exposures.append(usual * factor)
            frames.append(simulate_frame(cut, camera, usual * factor, seed + 31 * number + index, channel))
    name = sensor.name.replace("-", "_")
    along = (f"frame_{name}", "y", "x")
    channel_names = ", ".join(str(channel or "mosaic") for channel in channels for _ in sensor.exposures)
    notes = {"units": "DN", "camera": camera.name, "exposure_s": exposures, "channels": channel_names}
    arrays: dict[str, Any] = {f"raw_{name}": (along, np.stack(frames), notes)}
    try:
        white = scene_white(cut)
        pictures = [raw_to_srgb(frame, camera, s, white) for frame, s in zip(frames, exposures, strict=True)]
    except InputError:
        return arrays
    arrays[f"developed_{name}"] = ((*along, "rgb"), np.stack(pictures), {"colour_space": "sRGB"})
    return arrays


def mean_spectrum(cube: xr.Dataset) -> NDArray[np.float64]:
    """Mean radiance of the pixels without lamps.

    Parameters
    ----------
    cube
        The picture.

    Returns
    -------
    NDArray
        (w,) radiance, W m^-2 sr^-1 nm^-1.
    """
    visible = cube["surface"].values >= 0
    values = cube["radiance"].values
    return np.asarray(values[visible].mean(axis=0, dtype=np.float64) if visible.any() else np.zeros(values.shape[-1]))
