"""Picture of an external renderer, used in place of our rendering.

The cube is read as a rendered image on our wavelengths. Between the cube's wavelengths it follows the shape of our
spectra. A picture from a slightly different camera is the cube changed by what our rendering changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.files import AS_STATED, Declared, declared_for, read_cube, require_used, stated_in, window_of
from cboxlab.rendering.image import RenderedImage, variance_of_neighbours
from cboxlab.rendering.radiosity import LightField, gather
from cboxlab.rendering.visibility import build_tracer, facet_coverage
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .few_batches import pooled_variance

__all__ = ["ExternalPicture", "external_picture", "require_level"]

#: Samples per batch of our pictures from the two cameras: they share their random numbers, so that few suffice.
_SAMPLES = 256

#: Batches of our pictures from the two cameras: from their scatter comes the error of the change.
_BATCHES = 4

#: Samples of our picture for the shape of each pixel's spectrum.
_SHAPE_SAMPLES = 256

#: Share of the largest value below which our spectrum counts as dark: a ratio to it would be noise.
_DARK = 0.01

#: Largest ratio of brightness between picture and capture: beyond it the picture shows another lamp or unit.
_MAX_LEVEL_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class ExternalPicture:
    """A cube of another renderer as a rendered image."""

    #: The picture through ``camera`` on WAVELENGTH_NM.
    image: RenderedImage
    #: The capture's calibrated camera.
    camera: Camera
    #: Our radiosity solution of the same scene.
    light: LightField
    #: File of the cube.
    path: Path
    #: Units and wavelengths that the file does not state.
    declared: Declared = AS_STATED
    #: Whether its noise is estimated from the scatter of neighbouring pixels, for want of standard errors in the file.
    estimated: bool = False

    def through(self, camera: Camera, seed: int) -> RenderedImage:
        """The picture from another camera, changed by as much as our rendering changes.

        Parameters
        ----------
        camera
            The other camera; the picture itself is returned for its own camera.
        seed
            Seed of our two renderings.

        Returns
        -------
        RenderedImage
            Picture with the change as further coefficients and spectra.
        """
        if camera is self.camera:
            return self.image
        before, after = (gather(self.light, c, _SAMPLES, _BATCHES, seed) for c in (self.camera, camera))
        change = np.array_split(after.coefficients - before.coefficients, len(self.image.coefficients))
        halves = np.stack([part.mean(axis=0) for part in change])
        return replace(
            after,
            coefficients=np.concatenate([self.image.coefficients, halves], axis=-1),
            spectra=np.concatenate([self.image.spectra, after.spectra]),
        )


def external_picture(
    path: Path, scene: Scene, camera: Camera, light: LightField, declared: Declared = AS_STATED
) -> ExternalPicture:
    """Cube of an external renderer as a rendered image on WAVELENGTH_NM.

    Its standard errors count as fully correlated between wavelengths. A cube without standard errors has those of the
    scatter of neighbouring pixels. Between its wavelengths the ratio of a pixel to our spectrum is linear.

    Parameters
    ----------
    path
        File of the cube.
    scene
        Scene of the cube, for the surfaces that each pixel sees.
    camera
        Camera of the cube.
    light
        Our solution of the scene on WAVELENGTH_NM.
    declared
        Units and wavelengths that the file does not state.

    Returns
    -------
    ExternalPicture
        The picture through ``camera``.

    Raises
    ------
    InputError
        If the file is a part of a picture, the size is not the camera's, the wavelengths do not span 400 to 700 nm, or
        a radiance is not finite.
    """
    read = read_cube(path, declared)
    require_used(declared, declared_for(read), stated_in(read))
    if (window := window_of(read)) is not None:
        raise InputError(path, f"a part of a picture, {window}", "the complete picture through the capture's camera")
    cube = read.transpose("y", "x", "wavelength", ...)
    wavelength = cube["wavelength"].values.astype(float)
    radiance = cube["radiance"].values.astype(float)
    if radiance.shape[:2] != (camera.height_px, camera.width_px):
        size = f"{radiance.shape[1]} x {radiance.shape[0]} px"
        expected = f"the capture's {camera.width_px} x {camera.height_px} px, through its calibrated camera"
        raise InputError(
            path, size, expected, "A cube of our own render through the capture's camera shows how it looks."
        )
    if wavelength[0] > WAVELENGTH_NM[0] or wavelength[-1] < WAVELENGTH_NM[-1]:
        span = f"wavelengths from {wavelength[0]:g} to {wavelength[-1]:g} nm"
        raise InputError(path, span, "400 to 700 nm: the sensor equation is an integral over them")
    if not np.all(np.isfinite(radiance)):
        raise InputError(path, "radiance that is not finite", "W m^-2 sr^-1 nm^-1 in every pixel")
    tracer = build_tracer(scene)
    coverage = facet_coverage(tracer, camera)
    if "standard_error" in cube:
        standard_error = cube["standard_error"]
        batches = int(standard_error.attrs.get("batches", 0))
        edges = coverage.max(axis=-1) < 1
        error = np.sqrt(pooled_variance(radiance, standard_error.values.astype(float) ** 2, edges, batches))
    else:
        error = np.sqrt(variance_of_neighbours(radiance, radiance, coverage.max(axis=-1) == 1))
    # two batches that far apart have this error of their mean
    values = np.stack([radiance + error, radiance - error])
    image = RenderedImage(
        coefficients=_between(wavelength, values, gather(light, camera, _SHAPE_SAMPLES, 1)),
        spectra=np.eye(WAVELENGTH_NM.size),
        wavelength_nm=WAVELENGTH_NM,
        coverage=coverage,
        facet_surface=tracer.facet_surface,
        surface_names=tuple(surface.name for surface in scene.surfaces),
    )
    return ExternalPicture(image, camera, light, path, declared, "standard_error" not in cube)


def _between(wavelength: NDArray[np.float64], values: NDArray[np.float64], ours: RenderedImage) -> NDArray[np.float32]:
    """Values (b, y, x, w) interpolated to (b, y, x, n) by the shape of our spectra.

    The ratio of a value to our spectrum is linear between the wavelengths of the values. For a pixel that is dark in
    our picture at any wavelength, the mean spectrum replaces the pixel's spectrum. Where the mean is dark, the ratio
    of the next wavelength holds.
    """
    shape = values.shape[1:3]
    spectra, mixing = ours.coefficients[0], ours.spectra
    mean = spectra[ours.surface >= 0].mean(axis=0, dtype=np.float64) @ mixing
    at = _linear(WAVELENGTH_NM, wavelength)
    bright = mean @ at > _DARK * mean.max()
    between = _linear(wavelength[bright], WAVELENGTH_NM)
    interpolated = np.empty((len(values), *shape, WAVELENGTH_NM.size), dtype=np.float32)
    for row in range(shape[0]):  # all rows at once would take a gigabyte at 512 pixels a side
        spectrum = spectra[row] @ mixing
        spectrum = np.where(np.any(spectrum < _DARK * mean, axis=1, keepdims=True), mean, spectrum)
        interpolated[:, row] = (values[:, row][..., bright] / (spectrum @ at)[:, bright] @ between) * spectrum
    return interpolated


def _linear(nodes: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """(nodes, targets) matrix of linear interpolation, constant beyond the ends."""
    return np.stack([np.interp(targets, nodes, row) for row in np.eye(nodes.size)])


def require_level(picture: Path, lamp_scale: float) -> None:
    """Refuse a picture whose brightness cannot be that of the capture.

    Parameters
    ----------
    picture
        File of the picture.
    lamp_scale
        Light of the capture over that of the picture.

    Raises
    ------
    InputError
        If the ratio is beyond a factor of two in either direction.
    """
    if not 1 / _MAX_LEVEL_RATIO < lamp_scale < _MAX_LEVEL_RATIO:
        raise InputError(
            picture,
            f"a picture {1 / lamp_scale:.3g} times as bright as the capture",
            "radiance in W m^-2 sr^-1 nm^-1 under the capture's own lamp",
            "Our own render through the capture's camera is under that lamp.",
        )
