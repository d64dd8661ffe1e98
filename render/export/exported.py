"""What all formats of an export share: the scene at its wavelengths, the film, the rays, the layout of results."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Lamp, Scene, Surface
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..visibility import Film, film_for, resampling

__all__ = [
    "ExportSettings",
    "Exported",
    "ExportedLamp",
    "Layout",
    "exported_scene",
    "groups_of",
    "pixel_means",
    "subpixel_rays",
]

#: Film pixels per pixel and axis of a camera with distortion.
_FINE = 4


@dataclass(frozen=True, eq=False)
class ExportSettings:
    """wavelength_nm : (w,) channels. samples : per pixel and batch. batches : independent runs, at least 2, whose
    scatter gives the error. subpixels : rays per pixel and axis in the ray file."""

    wavelength_nm: NDArray[np.float64]
    samples: int = 64
    batches: int = 4
    subpixels: int = 4


@dataclass(frozen=True, eq=False)
class Layout:
    """How results are arranged, as the export's ``scene.json`` says.

    film_width_px, film_height_px : of the pinhole film, see ``Exported.film``. lamp_reflects : whether any does.
    """

    width_px: int
    height_px: int
    film_width_px: int
    film_height_px: int
    lamp_reflects: bool
    settings: ExportSettings

    @property
    def channels(self) -> int:
        """Number of wavelengths."""
        return self.settings.wavelength_nm.size


@dataclass(frozen=True, eq=False)
class ExportedLamp:
    """A lamp at the export's wavelengths. radiance : (w,) W m^-2 sr^-1 nm^-1. reflectance : (w,).

    key : "lamp" for the first, then "lamp-1" and so on, for the names of files and of materials.
    """

    lamp: Lamp
    key: str
    radiance: NDArray[np.float64]
    reflectance: NDArray[np.float64]

    @property
    def surface(self) -> Surface:
        """Its surface."""
        return self.lamp.surface


@dataclass(frozen=True, eq=False)
class Exported:
    """A scene made ready for other renderers.

    reflectances : (material, w), rows as ``scene.materials``. lamps : at least one. film : pixels of a pinhole without
    distortion, those of the camera where it has none, else four times finer and wide enough for the camera's image.
    max_bounces : reflections between lamp and camera, None for no limit.
    """

    scene: Scene
    camera: Camera
    film: Film
    settings: ExportSettings
    reflectances: NDArray[np.float64]
    lamps: tuple[ExportedLamp, ...]
    max_bounces: int | None

    @property
    def layout(self) -> Layout:
        """The arrangement of the results."""
        width, height = (int(n) for n in self.film.size)
        size = self.camera.width_px, self.camera.height_px, width, height
        return Layout(*size, self.lamp_reflects, self.settings)

    @property
    def lamp_reflects(self) -> bool:
        """Whether any lamp reflects."""
        return any(one.lamp.reflects for one in self.lamps)

    @property
    def with_black_lamps(self) -> Exported:
        """The same with lamps that reflect nothing, for renderers in which none does."""
        scene = self.scene.with_lamps(lambda lamp: replace(lamp, reflectance=lamp.reflectance.scaled(0.0)))
        return replace(self, scene=scene, lamps=_lamps(scene, self.settings.wavelength_nm))

    @property
    def film_samples(self) -> int:
        """Samples per film pixel."""
        return max(1, round(self.settings.samples * (self.camera.focal_length_px / self.film.scale) ** 2))

    @property
    def subpixel_samples(self) -> int:
        """Samples per ray of the ray file."""
        return max(1, round(self.settings.samples / self.settings.subpixels**2))

    @property
    def axes(self) -> NDArray[np.float64]:
        """(4, 4) camera to world, with axes x to the left, y up, z forward."""
        axes = np.eye(4)
        axes[:3, :3] = self.camera.rotation.T @ np.diag([-1.0, -1.0, 1.0])
        axes[:3, 3] = self.camera.position_mm
        return axes


def exported_scene(scene: Scene, camera: Camera, settings: ExportSettings, max_bounces: int | None = None) -> Exported:
    """Raises InputError for what not all renderers have alike: anything but Lambertian surfaces and a plain lamp."""
    where = f"scene {scene.name}"
    if not scene.diffuse:
        raise InputError(
            where,
            "surfaces that are not Lambertian or have a texture, or a medium",
            "a diffuse scene for an export",
        )
    if any(lamp.edge_ratio != 1.0 or lamp.exponent or lamp.pattern is not None for lamp in scene.lamps):
        raise InputError(
            where, "a lamp whose radiance varies over its area or with direction", "a uniform Lambertian lamp"
        )
    if settings.batches < 2:
        raise InputError("batches", str(settings.batches), "at least 2, whose scatter gives the error")
    wavelength = settings.wavelength_nm
    reflectances = scene.reflectances(wavelength)[: len(scene.materials)]
    film = film_for(camera, 1 if camera.is_pinhole else _FINE)
    return Exported(scene, camera, film, settings, reflectances, _lamps(scene, wavelength), max_bounces)


def _lamps(scene: Scene, wavelength_nm: NDArray[np.float64]) -> tuple[ExportedLamp, ...]:
    return tuple(
        ExportedLamp(
            lamp,
            f"lamp-{index}" if index else "lamp",
            lamp.radiance.at(wavelength_nm),
            lamp.reflectance.at(wavelength_nm),
        )
        for index, lamp in enumerate(scene.lamps)
    )


def groups_of(channels: int, most: int) -> list[NDArray[np.int64]]:
    """The channels in groups of at most ``most``, for renderers that carry so many at once."""
    return np.array_split(np.arange(channels), -(-channels // most))


def subpixel_rays(exported: Exported, batch: int) -> NDArray[np.float32]:
    """(y * s, x * s, 6) origin and unit direction of one ray at random in each of s x s parts of every pixel.

    Raises InputError where the camera's distortion leaves a pixel without a ray.
    """
    camera, s = exported.camera, exported.settings.subpixels
    generator = np.random.default_rng([0xCB0, batch])
    shape = (camera.height_px * s, camera.width_px * s)
    row, column = np.indices(shape)
    v, u = ((i + generator.random(shape)) / s - 0.5 for i in (row, column))
    directions = camera.directions(u, v)
    if not np.isfinite(directions).all():
        raise InputError("camera.k1", f"{camera.k1:g}", "a distortion that gives every pixel a ray")
    origins = np.broadcast_to(camera.position_mm, directions.shape)
    return np.concatenate([origins, directions], axis=-1).astype("<f4")


def pixel_means(exported: Exported) -> tuple[NDArray, NDArray, NDArray] | None:
    """Rows, columns and weights of the means over camera pixels from film pixels; None where they are the same."""
    if exported.camera.is_pinhole:
        return None
    matrix = resampling(exported.film, exported.camera).tocoo()
    row, column = matrix.coords
    return row.astype(np.int32), column.astype(np.int32), matrix.data.astype(np.float64)
