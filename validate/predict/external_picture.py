"""Another renderer's picture in place of ours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.rendering.files import AS_STATED, Declared, declared_for, read_cube, require_used, stated_in
from cboxlab.rendering.image import RenderedImage, variance_of_neighbours
from cboxlab.rendering.radiosity import LightField, gather
from cboxlab.rendering.visibility import build_tracer, facet_coverage
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = ["ExternalPicture", "external_picture", "require_level"]

#: Of our pictures from the two cameras; they share their random numbers.
_SAMPLES, _BATCHES = 256, 4

#: Of our picture, for the shape of each pixel's spectrum; part of its largest value below which it is dark.
_SHAPE_SAMPLES, _DARK = 256, 0.01

#: A picture that many times as bright as the capture shows another lamp.
_WRONG_LEVEL = 2.0


@dataclass(frozen=True, eq=False)
class ExternalPicture:
    """image : through ``camera``. light : the same scene's, solved by us. path : the file that it was read from.
    declared : what that file does not state. estimated : whether its noise is that of neighbouring pixels' scatter.
    """

    image: RenderedImage
    camera: Camera
    light: LightField
    path: Path
    declared: Declared = AS_STATED
    estimated: bool = False

    def through(self, camera: Camera, seed: int) -> RenderedImage:
        """The picture from another camera: changed by as much as ours changes."""
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
    """The cube at ``path`` as a rendered image on WAVELENGTH_NM.

    scene, camera : what it shows and through which camera, for what each pixel sees. Its standard errors count as fully
    correlated between wavelengths; where it has none they are those of the scatter of neighbouring pixels.
    light : our solution of the scene on WAVELENGTH_NM; between its wavelengths a pixel's ratio to our spectrum there
    is linear. declared : what the file does not state.

    Raises InputError for another size than the camera's, or wavelengths that do not span 400 to 700 nm.
    """
    read = read_cube(path, declared)
    require_used(declared, declared_for(read), stated_in(read))
    cube = read.transpose("y", "x", "wavelength", ...)
    wavelength = cube["wavelength"].values.astype(float)
    radiance = cube["radiance"].values.astype(float)
    if radiance.shape[:2] != (camera.height_px, camera.width_px):
        found = f"{radiance.shape[1]} x {radiance.shape[0]} px"
        expected = f"the capture's {camera.width_px} x {camera.height_px} px, through its calibrated camera"
        raise InputError(
            path, found, expected, "A cube of our own render through the capture's camera shows how it looks."
        )
    if wavelength[0] > WAVELENGTH_NM[0] or wavelength[-1] < WAVELENGTH_NM[-1]:
        found = f"wavelengths from {wavelength[0]:g} to {wavelength[-1]:g} nm"
        raise InputError(path, found, "400 to 700 nm: the sensor equation is an integral over them")
    if not np.all(np.isfinite(radiance)):
        raise InputError(path, "radiance that is not finite", "W m^-2 sr^-1 nm^-1 in every pixel")
    tracer = build_tracer(scene)
    coverage = facet_coverage(tracer, camera)
    if "standard_error" in cube:
        error = cube["standard_error"].values.astype(float)
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
    """(b, y, x, n) on WAVELENGTH_NM of values (b, y, x, w), whose ratio to our picture's spectra is linear between.

    A pixel that is dark in our picture at any wavelength has its mean spectrum in place of its own. Where that is dark
    the ratio is that of the next wavelength.
    """
    shape = values.shape[1:3]
    spectra, mixing = ours.coefficients[0], ours.spectra
    mean = spectra[ours.surface >= 0].mean(axis=0, dtype=np.float64) @ mixing
    at = _linear(WAVELENGTH_NM, wavelength)
    lit = mean @ at > _DARK * mean.max()
    between = _linear(wavelength[lit], WAVELENGTH_NM)
    found = np.empty((len(values), *shape, WAVELENGTH_NM.size), dtype=np.float32)
    for row in range(shape[0]):  # all rows at once would take a gigabyte at 512 pixels a side
        own = spectra[row] @ mixing
        own = np.where(np.any(own < _DARK * mean, axis=1, keepdims=True), mean, own)
        found[:, row] = (values[:, row][..., lit] / (own @ at)[:, lit] @ between) * own
    return found


def _linear(given: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """(given, wanted) linear interpolation, constant beyond the ends."""
    return np.stack([np.interp(wanted, given, row) for row in np.eye(given.size)])


def require_level(picture: Path, lamp_scale: float) -> None:
    """Raises InputError where the lamp had to be scaled out of all reason to fit the capture."""
    if not 1 / _WRONG_LEVEL < lamp_scale < _WRONG_LEVEL:
        raise InputError(
            picture,
            f"a picture {1 / lamp_scale:.3g} times as bright as the capture",
            "radiance in W m^-2 sr^-1 nm^-1 under the capture's own lamp",
            "Our own render through the capture's camera is under that lamp.",
        )
