"""``cboxlab.render``: a spectral cube of a model, everything before filters and sensor."""

from __future__ import annotations

import hashlib
import pickle
import shutil
from collections.abc import Iterator, Sequence
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
from cboxlab.utils.arguments import (
    MAX_SEED,
    described,
    require_progress,
    require_type,
    required_number,
    required_path,
    required_whole_number,
)
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress, ProgressReporter, share
from cboxlab.utils.table import Table
from numpy.typing import ArrayLike, NDArray

from ..predict import transported
from .inputs import ModelLike, as_model
from .photometry_table import photometry_table
from .provenance import provenance
from .result import Result
from .strip_files import load_strip, store_strip

__all__ = ["CubeFile", "CubeResult", "CubeSettings", "render", "render_file"]

#: Largest size of a cube that is rendered at once, bytes of all passes; a larger one is rendered by strips of rows.
#: The final gather stores up to four times as many numbers for a pixel as there are wavelengths, and averages need
#: double precision.
LARGEST_IN_MEMORY = 2**28

#: Figures of a cube that are stored with a finished strip.
_FIGURES = ("standard_error", "standard_error_99", "firefly_pixels")
#: Samples per pixel and batch, at most: more take longer than the precision of sums allows.
_MAX_SAMPLES = 2**24
#: Pixels of a side of the published camera, at most: a picture has at most 2^28 pixels.
_MAX_SIDE_PX = 2**14
#: Attribute of a finished strip that holds the sums over its surfaces, as text.
_SUMS = "surface_sums"


@dataclass(frozen=True, eq=False)
class CubeSettings:
    """Wavelengths and precision of the rendering of a cube."""

    #: (w,) ascending wavelengths, nm.
    wavelength_nm: NDArray[np.float64]
    #: Relative standard error that ``percentile`` of the pixels and wavelengths have at most.
    noise: float = 0.003
    #: Percentile of the errors to which ``noise`` applies, 0 to 100.
    percentile: float = 50.0
    #: Samples per pixel and batch, in place of ``noise``; None to render until ``noise`` is reached.
    samples: int | None = None
    #: Seed of the random numbers; None for the model's.
    seed: int | None = None
    #: Address of a Dask scheduler whose workers share the passes; None to render in this process.
    scheduler: str | None = None
    #: Command that the cube states as its origin.
    command: str = "cboxlab.render"


@dataclass(frozen=True, eq=False, repr=False)
class CubeResult(Result):
    """Spectral cube of a model, with its errors and photometry."""

    #: ``radiance`` and ``standard_error`` (y, x, wavelength), W m^-2 sr^-1 nm^-1, and the surface at each pixel.
    cube: xr.Dataset
    #: Name of the model.
    model: str
    #: Relative standard error of the median pixel and wavelength.
    standard_error: float
    #: Relative standard error that 99 of 100 pixels and wavelengths have at most.
    standard_error_99: float
    #: Number of pixels whose light comes mostly from a single pass, so that their error is understated.
    firefly_pixels: int
    #: Identifiers of the model's effects that act after the light leaves the scene, and are not in the cube.
    left_out: tuple[str, ...]
    #: Luminance, chromaticity and illuminance by surface; None if the wavelengths do not suffice.
    photometry: Photometry | None = None

    def to_dict(self) -> dict[str, Any]:
        """Size, wavelengths, errors and photometry, without the radiance.

        Returns
        -------
        dict
            Ready for JSON; the radiance is in ``cube``.
        """
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
        """Write the cube.

        Parameters
        ----------
        folder
            Folder of cube.nc, or the file itself if its ending is .nc, .exr, .hdr or .png.

        Returns
        -------
        tuple of Path
            The one file.
        """
        path = required_path("folder", folder)
        path = path if path.suffix.lower() in WRITABLE else path / "cube.nc"
        write_cube(path, self.cube)
        return (path,)

    def lines(self) -> list[str]:
        """Size, wavelengths, mean luminance and errors, then remarks.

        Returns
        -------
        list of str
            The sentences.
        """
        size = self.cube.sizes["x"], self.cube.sizes["y"]
        return _lines(self.model, size, self.cube["wavelength"].values, self.photometry, self.notes())

    def tables(self) -> list[Table]:
        """Photometry of each surface.

        Returns
        -------
        list of Table
            One table; none if the wavelengths do not suffice for luminances.
        """
        return [] if self.photometry is None else [photometry_table(self.photometry)]

    def notes(self) -> list[str]:
        """Errors of the cube, and what it lacks.

        Returns
        -------
        list of str
            One sentence each.
        """
        if self.standard_error_99 == 0:
            return ["The camera sees no lit surface."]
        lines = [
            f"Relative standard error: {self.standard_error:.2%} in the median pixel, "
            f"{self.standard_error_99:.2%} or less in 99 of 100 pixels."
        ]
        if self.firefly_pixels:
            lines.append(
                f"Pixels whose light comes mostly from a single pass (fireflies): {self.firefly_pixels}. Their error "
                "is understated."
            )
        if self.left_out:
            lines.append(f"Effects of the camera, which are not in the cube: {', '.join(self.left_out)}.")
        reason = why_no_luminance(self.cube["wavelength"].values)
        if reason is not None:
            lines.append(reason)
        elif self.photometry is not None and self.photometry.illuminance_lx is None:
            lines.append("No illuminances: they need Lambertian surfaces and no effects of light transport.")
        return lines


def _lines(
    model: str, size_px: tuple[int, int], grid: NDArray[np.float64], photometry: Photometry | None, notes: Sequence[str]
) -> list[str]:
    """Sentences of a cube: size and wavelengths, mean luminance, notes."""
    luminance = []
    if photometry is not None:
        mean, (x, y) = photometry.picture.luminance, photometry.picture.chromaticity
        luminance = [f"Mean luminance {mean:.4g} cd/m², x {x:.4f}, y {y:.4f}, {photometry.range_text}."]
    width, height = size_px
    return [
        f"Spectral cube of {model}: {width} x {height} px, {grid.size} wavelengths from {grid[0]:g} to {grid[-1]:g} nm",
        *luminance,
        *(f"• {note}" for note in notes),
    ]


@dataclass(frozen=True, eq=False)
class _Job:
    """A model ready to be rendered."""

    model: Model
    scene: Scene
    #: Camera, with the model's effects on it.
    camera: Camera
    max_bounces: int | None
    settings: CubeSettings

    def first_pass(self, camera: Camera, index: int = 0) -> RenderJob:
        """First pass of the picture or of a strip; strips differ in random numbers, not in patches."""
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
        """Cube of the picture or strip that begins with a pass."""
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
        origin = provenance(self.model, self.camera, first.seed, s.command)
        figures = relative_error(image), relative_error(image, 99.0), int(fireflies(image).sum())
        sums = None if why_no_luminance(s.wavelength_nm) else surface_sums(image)
        return self.result(labelled_cube(image).assign_attrs(origin), *figures, sums)

    def strip(self, camera: Camera, index: int, progress: Progress, folder: Path) -> CubeResult:
        """Strip number ``index``, from ``folder`` or rendered and stored there."""
        first, s = self.first_pass(camera, index), self.settings
        effects = [(e.id, e.values, e.effect.file and e.effect.file.read_bytes()) for e in self.model.effects]
        key = hashlib.sha256(pickle.dumps((first, s.samples, s.noise, s.percentile, effects, _SUMS))).hexdigest()
        path = folder / f"{index}"
        cube = load_strip(path, key)
        if cube is not None:
            progress.part(1.0)
            error, error_99, pixels = (cube.attrs.pop(name) for name in _FIGURES)
            text = cube.attrs.pop(_SUMS)
            sums = SurfaceSums.from_text(text) if text else None
            return self.result(cube, float(error), float(error_99), int(pixels), sums)
        strip = self.picture(first, progress, None)
        figures = {name: getattr(strip, name) for name in _FIGURES}
        figures[_SUMS] = "" if strip.photometry is None else strip.photometry.sums.text()
        store_strip(path, key, strip.cube.assign_attrs(figures))
        return strip

    def with_illuminance(self, result: CubeResult) -> CubeResult:
        """Result with illuminances, if the scene is diffuse and no effect changes light transport."""
        changed = any(effect.stage == "transport" for effect in self.model.effects)
        if result.photometry is None or changed or not self.scene.diffuse or not variant.compiled():
            return result
        seed = self.first_pass(self.camera).seed
        illuminance_lx = surface_illuminance(self.scene, self.settings.wavelength_nm, self.max_bounces, seed=seed)
        return replace(result, photometry=replace(result.photometry, illuminance_lx=illuminance_lx))

    def result(
        self,
        cube: xr.Dataset,
        standard_error: float,
        standard_error_99: float,
        firefly_pixels: int,
        sums: SurfaceSums | None,
    ) -> CubeResult:
        """Result of a cube of this model."""
        later = tuple(e.id for e in self.model.effects if e.stage in stages_between("filter", "counts"))
        light = None if sums is None else Photometry(sums, self.settings.wavelength_nm)
        return CubeResult(cube, self.model.name, standard_error, standard_error_99, firefly_pixels, later, light)


def _job(model: ModelLike, camera: Camera | Capture | str | Path, settings: CubeSettings) -> _Job:
    """Job of a model seen by a camera; a capture gives its calibrated camera and measured lamp."""
    checked = as_model(model)
    view, lamp = view_of(camera)
    return _Job(checked, *model_cube_inputs(checked, view, lamp), settings)


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
    """Render a spectral cube of a model; repeatable by ``seed``.

    Parameters
    ----------
    model
        A model, a scene, a model file, a scene file, or the name of a packaged scene. None for the published box.
    wavelengths
        (w,) ascending wavelengths, nm; None for 400 to 700 nm by 10 nm.
    size
        Pixels per side, for the published camera.
    camera
        In place of the published camera: a camera, a camera file (.json), or a capture or its folder. A capture gives
        its calibrated camera and its measured lamp.
    noise
        Relative standard error that ``percentile`` of the pixels and wavelengths have at most.
    percentile
        Percentile of the errors to which ``noise`` applies, 0 to 100.
    samples
        Samples per pixel and batch, in place of ``noise``.
    seed
        Seed of the random numbers; None for the model's.
    scheduler
        Address of a Dask scheduler whose workers share the passes; None to render in this process.
    progress
        Receiver of stages and of the completed share.

    Returns
    -------
    CubeResult
        Radiance with standard errors, and photometry.

    Raises
    ------
    InputError
        If an input is faulty.

    Examples
    --------
    >>> import cboxlab
    >>> cube = cboxlab.render("cornell-box", wavelengths=[450, 550, 650], size=16, samples=4)
    >>> dict(cube.cube["radiance"].sizes)
    {'y': 16, 'x': 16, 'wavelength': 3}
    """
    grid = _grid(np.arange(400.0, 701.0, 10.0) if wavelengths is None else wavelengths)
    require_progress(progress)
    if scheduler is not None:
        require_type("scheduler", scheduler, str, "the address of a Dask scheduler")
    settings = CubeSettings(
        grid,
        required_number("noise", noise, above=0.0),
        required_number("percentile", percentile, least=0.0, most=100.0),
        None if samples is None else required_whole_number("samples", samples, 1, _MAX_SAMPLES),
        None if seed is None else required_whole_number("seed", seed, 0, MAX_SEED),
        scheduler,
    )
    side = required_whole_number("size", size, 1, _MAX_SIDE_PX)
    job = _job(model, cornell_camera(side) if camera is None else camera, settings)
    return job.with_illuminance(job.picture(job.first_pass(job.camera), progress, None))


def _grid(wavelengths: ArrayLike) -> NDArray[np.float64]:
    """(w,) checked wavelengths, nm."""
    expected = "ascending numbers above 0, in nm"
    try:
        values = np.atleast_1d(np.asarray(wavelengths, np.float64))
    except (TypeError, ValueError, OverflowError):
        raise InputError("wavelengths", described(wavelengths), expected) from None
    if (
        values.ndim != 1
        or not values.size
        or not np.isfinite(values).all()
        or values[0] <= 0
        or (np.diff(values) <= 0).any()
    ):
        raise InputError("wavelengths", described(wavelengths), expected)
    return values


@dataclass(frozen=True, eq=False)
class CubeFile:
    """Summary of a cube that was written to a file."""

    #: Width, px.
    width_px: int
    #: Height, px.
    height_px: int
    #: Errors of the cube, and what it lacks: one sentence each.
    notes: tuple[str, ...]
    #: Luminance, chromaticity and illuminance by surface; None if the wavelengths do not suffice.
    photometry: Photometry | None
    #: Name of the model.
    model: str
    #: (w,) ascending wavelengths, nm.
    wavelength_nm: NDArray[np.float64]

    def lines(self) -> list[str]:
        """Sentences as of ``CubeResult``.

        Returns
        -------
        list of str
            Size and wavelengths first.
        """
        size = self.width_px, self.height_px
        return _lines(self.model, size, self.wavelength_nm, self.photometry, self.notes)

    def tables(self) -> list[Table]:
        """Tables as of ``CubeResult``.

        Returns
        -------
        list of Table
            Photometry of each surface; none if the wavelengths do not suffice for luminances.
        """
        return [] if self.photometry is None else [photometry_table(self.photometry)]


def render_file(
    path: Path,
    model: ModelLike,
    camera: Camera | Capture | Path,
    settings: CubeSettings,
    progress: Progress = NO_PROGRESS,
) -> CubeFile:
    """Render a cube into a file, by strips of rows if it is large.

    An interrupted rendering continues if it is called again. It continues after the last finished pass, which is stored
    as PATH.passes next to the file, or after the last finished strip, in the folder PATH.strips.

    Parameters
    ----------
    path
        File of the cube: .nc, .exr, .hdr or .png.
    model, camera
        As of ``render``.
    settings
        Wavelengths and precision.
    progress
        Receiver of stages and of the completed share.

    Returns
    -------
    CubeFile
        Size, notes and photometry.

    Raises
    ------
    InputError
        If an input is faulty.
    """
    job = _job(model, camera, settings)
    width, height = job.camera.width_px, job.camera.height_px
    if BATCHES * 4 * width * height * settings.wavelength_nm.size <= LARGEST_IN_MEMORY:
        passes = path.with_name(f"{path.name}.passes")
        result = job.picture(job.first_pass(job.camera), progress, passes)
        write_cube(path, result.cube)
        passes.unlink(missing_ok=True)
        return _summary(job.with_illuminance(result), width, height)
    folder = path.with_name(f"{path.name}.strips")
    parts, done = strip_cameras(job.camera), list[CubeResult]()
    progress.stage("rendering")
    unnamed = ProgressReporter(lambda _, part: progress.part(part))  # without the stages of each strip

    def strips() -> Iterator[xr.Dataset]:
        for index, part in enumerate(parts):
            strip_progress = share(unnamed, index / len(parts), (index + 1) / len(parts))
            strip = job.strip(part, index, strip_progress, folder)
            done.append(replace(strip, cube=strip.cube[["wavelength"]]))  # the wavelengths alone
            yield strip.cube

    if path.suffix.lower() == ".nc":
        write_strips(path, height, strips())
    else:
        write_cube(path, xr.concat(strips(), "y", data_vars="minimal", combine_attrs="override"))
    shutil.rmtree(folder, ignore_errors=True)  # the same command in another process may remove it, too
    return _summary(job.with_illuminance(_combined(done)), width, height)


def _summary(result: CubeResult, width_px: int, height_px: int) -> CubeFile:
    """Summary of a written cube."""
    grid = result.cube["wavelength"].values
    return CubeFile(width_px, height_px, tuple(result.notes()), result.photometry, result.model, grid)


def _combined(strips: list[CubeResult]) -> CubeResult:
    """Figures of a cube from its strips: median of the median errors, largest 99 % error."""
    lights = [strip.photometry for strip in strips if strip.photometry is not None]
    return replace(
        strips[0],
        standard_error=float(np.median([strip.standard_error for strip in strips])),
        standard_error_99=max(strip.standard_error_99 for strip in strips),
        firefly_pixels=sum(strip.firefly_pixels for strip in strips),
        photometry=replace(lights[0], sums=reduce(add, (light.sums for light in lights))) if lights else None,
    )
