"""Scene, film and rays of an export, at its wavelengths, and the arrangement of the results."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Lamp, Scene, Surface
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ...visibility import Film, film_for, resampling

__all__ = [
    "ExportSettings",
    "Exported",
    "ExportedLamp",
    "Layout",
    "channel_groups",
    "exported_scene",
    "pixel_means",
    "subpixel_rays",
]

#: Film pixels per camera pixel and axis under distortion: four, so that their means follow a pixel's outline.
_FILM_PIXELS_PER_PIXEL = 4
#: Fewest batches: two, the least whose scatter gives a standard error.
_MIN_BATCHES = 2
#: First word of the random seed of rays; the second is the batch. Fixed, so that an export repeats to the bit.
_RAY_SEED = 0xCB0


@dataclass(frozen=True, eq=False)
class ExportSettings:
    """Wavelengths and sampling of an export."""

    #: (w,) wavelengths of the channels, nm.
    wavelength_nm: NDArray[np.float64]
    #: Samples per pixel and batch.
    samples: int = 64
    #: Independent runs, at least 2; their scatter gives the standard error.
    batches: int = 4
    #: Rays of the ray file per pixel and axis.
    subpixels: int = 4


@dataclass(frozen=True, eq=False)
class Layout:
    """Arrangement of a renderer's results, as the export's ``scene.json`` states it."""

    #: Columns of the camera's image, px.
    width_px: int
    #: Rows of the camera's image, px.
    height_px: int
    #: Columns of the pinhole film, px; see ``Exported.film``.
    film_width_px: int
    #: Rows of the pinhole film, px.
    film_height_px: int
    #: Whether any lamp of the scene reflects.
    lamp_reflects: bool
    #: Wavelengths and sampling.
    settings: ExportSettings

    @property
    def channels(self) -> int:
        """Number of wavelengths."""
        return self.settings.wavelength_nm.size


@dataclass(frozen=True, eq=False)
class ExportedLamp:
    """A lamp at the export's wavelengths."""

    #: The lamp of the scene.
    lamp: Lamp
    #: Name in files and materials: "lamp" for the first, then "lamp-1" and so on.
    key: str
    #: (w,) radiance, W m^-2 sr^-1 nm^-1.
    radiance: NDArray[np.float64]
    #: (w,) reflectance, 0 to 1.
    reflectance: NDArray[np.float64]

    @property
    def surface(self) -> Surface:
        """Emitting surface."""
        return self.lamp.surface


@dataclass(frozen=True, eq=False)
class Exported:
    """A scene prepared for other renderers."""

    #: Scene to render: diffuse surfaces, uniform Lambertian lamps.
    scene: Scene
    #: Camera of the export.
    camera: Camera
    #: Pixels of a pinhole without distortion. They are the camera's where it has none; otherwise they are four times
    #: finer, and the film holds the camera's whole image.
    film: Film
    #: Wavelengths and sampling.
    settings: ExportSettings
    #: (material, w) reflectances, rows in the order of ``scene.materials``.
    reflectances: NDArray[np.float64]
    #: Lamps at the export's wavelengths, at least one.
    lamps: tuple[ExportedLamp, ...]
    #: Most reflections between lamp and camera; None for no limit.
    max_bounces: int | None

    @property
    def layout(self) -> Layout:
        """Arrangement of the results."""
        width, height = (int(n) for n in self.film.size)
        size = self.camera.width_px, self.camera.height_px, width, height
        return Layout(*size, self.lamp_reflects, self.settings)

    @property
    def lamp_reflects(self) -> bool:
        """Whether any lamp reflects."""
        return any(lamp.lamp.reflects for lamp in self.lamps)

    @property
    def with_black_lamps(self) -> Exported:
        """The same export with lamps of reflectance zero, for renderers whose lamps cannot reflect."""
        scene = self.scene.with_lamps(lambda lamp: replace(lamp, reflectance=lamp.reflectance.scaled(0.0)))
        return replace(self, scene=scene, lamps=_lamps(scene, self.settings.wavelength_nm))

    @property
    def film_samples(self) -> int:
        """Samples per film pixel and batch, at least 1, in proportion to its area."""
        return max(1, round(self.settings.samples * (self.camera.focal_length_px / self.film.scale) ** 2))

    @property
    def subpixel_samples(self) -> int:
        """Samples per ray of the ray file, at least 1."""
        return max(1, round(self.settings.samples / self.settings.subpixels**2))

    @property
    def axes(self) -> NDArray[np.float64]:
        """(4, 4) camera to world, with camera axes x to the left, y up, z forward."""
        axes = np.eye(4)
        axes[:3, :3] = self.camera.rotation.T @ np.diag([-1.0, -1.0, 1.0])
        axes[:3, 3] = self.camera.position_mm
        return axes


def exported_scene(scene: Scene, camera: Camera, settings: ExportSettings, max_bounces: int | None = None) -> Exported:
    """Scene prepared for other renderers, restricted to physics that all of them share.

    Parameters
    ----------
    scene
        Scene with Lambertian surfaces and uniform Lambertian lamps.
    camera
        Camera of the export.
    settings
        Wavelengths and sampling.
    max_bounces
        Most reflections between lamp and camera; None for no limit.

    Returns
    -------
    Exported
        The scene with its spectra at the export's wavelengths, and the film.

    Raises
    ------
    InputError
        If a surface is not Lambertian or has a texture, or if there is a medium. If a lamp's radiance varies over its
        area or with direction. If there are fewer than two batches.
    """
    where = f"scene {scene.name}"
    scene.require_diffuse("Only diffuse scenes can be exported.")
    if any(lamp.edge_ratio != 1.0 or lamp.exponent or lamp.pattern is not None for lamp in scene.lamps):
        raise InputError(
            where, "a lamp whose radiance varies over its area or with direction", "a uniform Lambertian lamp"
        )
    if settings.batches < _MIN_BATCHES:
        raise InputError("batches", str(settings.batches), "at least 2, whose scatter gives the error")
    wavelength = settings.wavelength_nm
    reflectances = scene.reflectances(wavelength)[: len(scene.materials)]
    film = film_for(camera, 1 if camera.is_pinhole else _FILM_PIXELS_PER_PIXEL)
    return Exported(scene, camera, film, settings, reflectances, _lamps(scene, wavelength), max_bounces)


def _lamps(scene: Scene, wavelength_nm: NDArray[np.float64]) -> tuple[ExportedLamp, ...]:
    """Lamps of a scene with their spectra at ``wavelength_nm``."""
    return tuple(
        ExportedLamp(
            lamp,
            f"lamp-{index}" if index else "lamp",
            lamp.radiance.at(wavelength_nm),
            lamp.reflectance.at(wavelength_nm),
        )
        for index, lamp in enumerate(scene.lamps)
    )


def channel_groups(channels: int, most: int) -> list[NDArray[np.int64]]:
    """Groups of neighbouring channels, for renderers with a limit on channels per run.

    Parameters
    ----------
    channels
        Number of channels, at least 1.
    most
        Largest number of channels of a group.

    Returns
    -------
    list of NDArray
        Indices of the channels of each group, in order.
    """
    return np.array_split(np.arange(channels), -(-channels // most))


def subpixel_rays(exported: Exported, batch: int) -> NDArray[np.float32]:
    """One random ray in each of s x s parts of every pixel (stratified sampling).

    Parameters
    ----------
    exported
        The export, whose settings give s.
    batch
        Number of the batch, from 0; each has its own random numbers.

    Returns
    -------
    NDArray
        (height * s, width * s, 6) origin, mm, and unit direction, little-endian float32.

    Raises
    ------
    InputError
        If the camera's distortion leaves a pixel without a ray.
    """
    camera, s = exported.camera, exported.settings.subpixels
    generator = np.random.default_rng([_RAY_SEED, batch])
    shape = (camera.height_px * s, camera.width_px * s)
    row, column = np.indices(shape)
    v, u = ((i + generator.random(shape)) / s - 0.5 for i in (row, column))
    directions = camera.directions(u, v)
    if not np.isfinite(directions).all():
        raise InputError("camera.k1", f"{camera.k1:g}", "a distortion that gives every pixel a ray")
    origins = np.broadcast_to(camera.position_mm, directions.shape)
    return np.concatenate([origins, directions], axis=-1).astype("<f4")


def pixel_means(exported: Exported) -> tuple[NDArray, NDArray, NDArray] | None:
    """Sparse matrix of means over camera pixels from film pixels, as coordinates.

    Parameters
    ----------
    exported
        The export, whose film is finer than the camera's pixels.

    Returns
    -------
    tuple of NDArray or None
        Camera pixels (rows) and film pixels (columns), both in row-major order, and weights. None for a camera
        without distortion, whose pixels are those of the film.
    """
    if exported.camera.is_pinhole:
        return None
    matrix = resampling(exported.film, exported.camera).tocoo()
    row, column = matrix.coords
    return row.astype(np.int32), column.astype(np.int32), matrix.data.astype(np.float64)
