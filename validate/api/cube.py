"""``cboxlab.render``: a spectral cube of a model, everything before filters and sensor."""

from __future__ import annotations

import hashlib
import pickle
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.calibration.capture import Capture
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.device import variant
from cboxlab.rendering.files import WRITABLE, strip_cameras, write_cube, write_strips
from cboxlab.rendering.integrators import (
    BATCHES,
    MOST_PASSES,
    RenderJob,
    fireflies,
    relative_error,
    render_passes,
    render_to_precision,
)
from cboxlab.rendering.model import Model, labelled_cube, model_cube_inputs, view_of
from cboxlab.rendering.photometry import (
    Photometry,
    SurfaceSums,
    surface_illuminance,
    surface_sums,
    why_no_luminance,
)
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress, ProgressReporter, share
from numpy.typing import ArrayLike, NDArray

from ..predict import transported
from .inputs import ModelLike, as_model
from .kept_strips import keep_strip, kept_strip
from .provenance import provenance
from .result import Result

__all__ = ["CubeFile", "CubeResult", "CubeSettings", "render", "render_file"]

#: Bytes of all passes of a cube from which on it is rendered by strips of rows. The final gather keeps up to four times
#: as many numbers for a pixel as there are wavelengths, and averages need double precision.
LARGEST_IN_MEMORY = 2**28

#: What is told of a cube, and kept with a finished strip; the sums over its surfaces are kept as text.
_TOLD = ("standard_error", "standard_error_99", "firefly_pixels")
_SUMS = "surface_sums"


@dataclass(frozen=True, eq=False)
class CubeSettings:
    """How a cube is rendered.

    wavelength_nm : (w,), ascending. noise : relative standard error that ``percentile`` of the pixels and wavelengths
    have at most. samples : per pixel and batch, in place of noise. seed : None for the model's. scheduler : address of
    a Dask scheduler whose workers share the passes. command : what the cube says of how it was made.
    """

    wavelength_nm: NDArray[np.float64]
    noise: float = 0.003
    percentile: float = 50.0
    samples: int | None = None
    seed: int | None = None
    scheduler: str | None = None
    command: str = "cboxlab.render"


@dataclass(frozen=True, eq=False, repr=False)
class CubeResult(Result):
    """cube : radiance and its standard error (y, x, wavelength), and the surface that each pixel sees.

    standard_error, standard_error_99 : relative, of the median pixel and of 99 of 100 pixels. firefly_pixels : those
    that owe much to a single pass, so that their error is understated. left_out : effects that act behind the scene.
    photometry : luminance, chromaticity and illuminance by surface; None where the wavelengths do not suffice.
    """

    cube: xr.Dataset
    model: str
    standard_error: float
    standard_error_99: float
    firefly_pixels: int
    left_out: tuple[str, ...]
    photometry: Photometry | None = None

    def to_dict(self) -> dict[str, Any]:
        """Size, wavelengths and errors; the radiance itself is in ``cube``."""
        return {
            "model": self.model,
            "width_px": self.cube.sizes["x"],
            "height_px": self.cube.sizes["y"],
            "wavelength_nm": self.cube["wavelength"].values.tolist(),
            "relative_standard_error": {"median": self.standard_error, "p99": self.standard_error_99},
            "firefly_pixels": self.firefly_pixels,
            "left_out": list(self.left_out),
            "photometry": None if self.photometry is None else self.photometry.to_dict(),
        }

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """cube.nc (NetCDF) in a folder; or, given a file with a cube's ending, that file (.nc, .exr, .hdr, .png)."""
        place = Path(folder)
        path = place if place.suffix.lower() in WRITABLE else place / "cube.nc"
        write_cube(path, self.cube)
        return (path,)

    def lines(self) -> list[str]:
        """Size, wavelengths and errors, then what is not in the cube."""
        grid = self.cube["wavelength"].values
        head = (
            f"Spectral cube of {self.model}: {self.cube.sizes['x']} x {self.cube.sizes['y']} px, {grid.size} "
            f"wavelengths from {grid[0]:g} to {grid[-1]:g} nm"
        )
        light = []
        if self.photometry is not None:
            luminance, (x, y) = self.photometry.picture.luminance, self.photometry.picture.chromaticity
            light = [f"mean luminance {luminance:.4g} cd/m², x {x:.4f}, y {y:.4f}, {self.photometry.range_text}"]
        return [head, *light, *self.notes()]

    def notes(self) -> list[str]:
        """Errors and what is not in the cube."""
        if self.standard_error_99 == 0:
            return ["the camera sees no lit surface"]
        lines = [f"standard error {self.standard_error:.2%} (median), {self.standard_error_99:.2%} (99 of 100 pixels)"]
        if self.firefly_pixels:
            lines.append(
                f"pixels that owe much to a single pass (fireflies): {self.firefly_pixels}; their error is understated"
            )
        if self.left_out:
            lines.append(f"not in a cube, since they act behind the scene: {', '.join(self.left_out)}")
        why = why_no_luminance(self.cube["wavelength"].values)
        if why is not None:
            lines.append(why)
        elif self.photometry is not None and self.photometry.illuminance_lx is None:
            lines.append("no illuminances: they are those of Lambertian surfaces without effects of light transport")
        return lines


@dataclass(frozen=True, eq=False)
class _Job:
    """A model made ready. camera : with the model's own effects on it."""

    model: Model
    scene: Scene
    camera: Camera
    max_bounces: int | None
    settings: CubeSettings

    def first_pass(self, camera: Camera, index: int = 0) -> RenderJob:
        """Of the picture, or of its strip number ``index``: with random numbers of its own, but the same patches."""
        seed = self.model.render.seed if self.settings.seed is None else self.settings.seed
        return RenderJob(
            self.scene,
            camera,
            self.settings.wavelength_nm,
            seed=seed,
            max_bounces=self.max_bounces,
            first_batch=MOST_PASSES * index,
        )

    def picture(self, first: RenderJob, progress: Progress, checkpoint: Path | None) -> CubeResult:
        """The picture, or the strip, that begins with a pass."""
        s = self.settings
        if s.samples is None:
            image = render_to_precision(
                first, s.noise, progress=progress, percentile=s.percentile, checkpoint=checkpoint, scheduler=s.scheduler
            )
        else:
            image = render_passes(replace(first, samples=s.samples, batches=BATCHES), progress)
        if any(effect.stage == "transport" for effect in self.model.effects):
            progress.stage("effects of light transport")
        image = transported(image, self.scene, first.camera, self.model.effects, first.seed, self.max_bounces)
        own = provenance(self.model, self.camera, first.seed, s.command)
        told = relative_error(image), relative_error(image, 99.0), int(fireflies(image).sum())
        sums = None if why_no_luminance(s.wavelength_nm) else surface_sums(image)
        return self.result(labelled_cube(image).assign_attrs(own), *told, sums)

    def strip(self, camera: Camera, index: int, progress: Progress, folder: Path) -> CubeResult:
        """Strip number ``index``, from ``folder`` if it was finished there before, else rendered and kept there."""
        first, s = self.first_pass(camera, index), self.settings
        effects = [(e.id, e.values, e.effect.file and e.effect.file.read_bytes()) for e in self.model.effects]
        key = hashlib.sha256(pickle.dumps((first, s.samples, s.noise, s.percentile, effects, _SUMS))).hexdigest()
        place = folder / f"{index}"
        cube = kept_strip(place, key)
        if cube is not None:
            progress.part(1.0)
            error, error_99, pixels = (cube.attrs.pop(name) for name in _TOLD)
            text = cube.attrs.pop(_SUMS)
            sums = SurfaceSums.from_text(text) if text else None
            return self.result(cube, float(error), float(error_99), int(pixels), sums)
        found = self.picture(first, progress, None)
        told = {name: getattr(found, name) for name in _TOLD}
        told[_SUMS] = "" if found.photometry is None else found.photometry.sums.text()
        keep_strip(place, key, found.cube.assign_attrs(told))
        return found

    def lit(self, result: CubeResult) -> CubeResult:
        """With the illuminances, where radiosity gives them: of a diffuse scene without effects of light transport."""
        changed = any(effect.stage == "transport" for effect in self.model.effects)
        if result.photometry is None or changed or not self.scene.diffuse or not variant.compiled():
            return result
        seed = self.first_pass(self.camera).seed
        found = surface_illuminance(self.scene, self.settings.wavelength_nm, self.max_bounces, seed=seed)
        return replace(result, photometry=replace(result.photometry, illuminance_lx=found))

    def result(
        self,
        cube: xr.Dataset,
        standard_error: float,
        standard_error_99: float,
        firefly_pixels: int,
        sums: SurfaceSums | None,
    ) -> CubeResult:
        """A cube of this model, and what is told of it."""
        later = tuple(e.id for e in self.model.effects if e.stage in stages_between("filter", "counts"))
        light = None if sums is None else Photometry(sums, self.settings.wavelength_nm)
        return CubeResult(cube, self.model.name, standard_error, standard_error_99, firefly_pixels, later, light)


def _job(model: ModelLike, camera: Camera | Capture | str | Path, settings: CubeSettings) -> _Job:
    chosen = as_model(model)
    view, lamp = view_of(camera)
    return _Job(chosen, *model_cube_inputs(chosen, view, lamp), settings)


def render(
    model: ModelLike = None,
    *,
    wavelengths: ArrayLike | None = None,
    size: int = 256,
    camera: Camera | Capture | str | Path | None = None,
    noise: float = 0.003,
    percentile: float = 50.0,
    samples: int | None = None,
    seed: int | None = None,
    scheduler: str | None = None,
    progress: Progress = NO_PROGRESS,
) -> CubeResult:
    """A spectral cube of a model, repeatable by ``seed``.

    model : a Model, a model file or a packaged scene's name; the published box where None. wavelengths : (w,) nm,
    ascending; 400 to 700 by 10 where None. size : pixels a side, of the published camera. camera : in its place a
    Camera, a camera file (.json), or a capture (or its folder), whose calibrated camera and measured lamp are taken.
    noise : relative standard error that ``percentile`` of the pixels and wavelengths have at most. samples : per pixel
    and batch, in place of noise. seed : the model's where None. scheduler : address of a Dask scheduler whose workers
    share the passes.

    Raises InputError for faulty input.
    """
    grid = _grid(np.arange(400.0, 701.0, 10.0) if wavelengths is None else wavelengths)
    if not noise > 0:
        raise InputError("noise", repr(noise), "a relative standard error above 0")
    settings = CubeSettings(grid, noise, percentile, samples, seed, scheduler)
    job = _job(model, cornell_camera(size) if camera is None else camera, settings)
    return job.lit(job.picture(job.first_pass(job.camera), progress, None))


def _grid(wavelengths: ArrayLike) -> NDArray[np.float64]:
    values = np.atleast_1d(np.asarray(wavelengths, np.float64))
    if (
        values.ndim != 1
        or not values.size
        or not np.isfinite(values).all()
        or values[0] <= 0
        or (np.diff(values) <= 0).any()
    ):
        raise InputError("wavelengths", repr(wavelengths), "ascending numbers above 0, in nm")
    return values


@dataclass(frozen=True, eq=False)
class CubeFile:
    """What is told of a cube in a file. photometry : as in ``CubeResult``."""

    width_px: int
    height_px: int
    notes: tuple[str, ...]
    photometry: Photometry | None


def render_file(
    path: Path,
    model: ModelLike,
    camera: Camera | Capture | Path,
    settings: CubeSettings,
    progress: Progress = NO_PROGRESS,
) -> CubeFile:
    """Render a cube into a file, by strips of rows where it is large.

    Interrupted, it goes on when called again: from its last finished pass, kept beside the file as PATH.passes, or its
    last finished strip, kept in the folder PATH.strips.
    """
    job = _job(model, camera, settings)
    width, height = job.camera.width_px, job.camera.height_px
    if BATCHES * 4 * width * height * settings.wavelength_nm.size <= LARGEST_IN_MEMORY:
        kept = path.with_name(f"{path.name}.passes")
        result = job.picture(job.first_pass(job.camera), progress, kept)
        write_cube(path, result.cube)
        kept.unlink(missing_ok=True)
        return _told(job.lit(result), width, height)
    folder = path.with_name(f"{path.name}.strips")
    parts, done = strip_cameras(job.camera), list[CubeResult]()
    progress.stage("rendering")
    unnamed = ProgressReporter(lambda _, part: progress.part(part))  # not every strip's own stages

    def strips() -> Iterator[xr.Dataset]:
        for index, part in enumerate(parts):
            own = share(unnamed, index / len(parts), (index + 1) / len(parts))
            strip = job.strip(part, index, own, folder)
            done.append(replace(strip, cube=strip.cube[["wavelength"]]))  # the wavelengths alone
            yield strip.cube

    if path.suffix.lower() == ".nc":
        write_strips(path, height, strips())
    else:
        write_cube(path, xr.concat(strips(), "y", data_vars="minimal", combine_attrs="override"))
    shutil.rmtree(folder, ignore_errors=True)  # the same command beside this one may remove it, too
    return _told(job.lit(_of_strips(done)), width, height)


def _told(result: CubeResult, width: int, height: int) -> CubeFile:
    return CubeFile(width, height, tuple(result.notes()), result.photometry)


def _of_strips(strips: list[CubeResult]) -> CubeResult:
    """What is told of a cube by strips: the middle strip's median error, the worst strip's 99 of 100 pixels."""
    lights = [strip.photometry for strip in strips if strip.photometry is not None]
    return replace(
        strips[0],
        standard_error=float(np.median([strip.standard_error for strip in strips])),
        standard_error_99=max(strip.standard_error_99 for strip in strips),
        firefly_pixels=sum(strip.firefly_pixels for strip in strips),
        photometry=replace(lights[0], sums=reduce(add, (light.sums for light in lights))) if lights else None,
    )
