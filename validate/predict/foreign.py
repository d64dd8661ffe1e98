"""Another renderer's picture in place of ours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.render.files import AS_STATED, Declared, declared_for, read_cube, require_used
from cboxlab.render.image import RenderedImage
from cboxlab.render.radiosity import LightField, gather
from cboxlab.render.visibility import build_tracer, facet_coverage
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

__all__ = ["ForeignPicture", "foreign_picture", "require_level"]

#: Of our pictures from the two cameras; they share their random numbers.
_SAMPLES, _BATCHES = 256, 4

#: Of our picture's mean spectrum; part of its largest value below which it is dark.
_MEAN_SAMPLES, _DARK = 16, 1e-3

#: A picture that many times as bright as the capture shows another lamp.
_WRONG_LEVEL = 2.0


@dataclass(frozen=True, eq=False)
class ForeignPicture:
    """image : through ``camera``. light : the same scene's, solved by us. path : the file that it was read from."""

    image: RenderedImage
    camera: Camera
    light: LightField
    path: Path

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


def foreign_picture(
    path: Path, scene: Scene, camera: Camera, declared: Declared = AS_STATED, light: LightField | None = None
) -> RenderedImage:
    """The cube at ``path`` as a rendered image on WAVELENGTH_NM.

    scene, camera : what it shows and through which camera, for what each pixel sees. Its standard errors, where it
    has any, count as fully correlated between wavelengths. declared : what the file does not state. light : our
    solution of the scene on WAVELENGTH_NM; between its wavelengths the cube's ratio to our mean spectrum is linear.
    None : the cube itself is, which is off by several per cent where the lamp's spectrum bends.

    Raises InputError for another size than the camera's, or wavelengths that do not span 400 to 700 nm.
    """
    read = read_cube(path, declared)
    require_used(declared, declared_for(read))
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
    error = (
        cube["standard_error"].values.astype(float) if "standard_error" in cube else np.zeros_like(radiance)
    )
    # two batches that far apart have this error of their mean
    batches = np.stack([radiance + error, radiance - error]).astype(np.float32)
    tracer = build_tracer(scene)
    return RenderedImage(
        coefficients=batches,
        spectra=_between(wavelength, np.ones(WAVELENGTH_NM.size) if light is None else _mean(light, camera)),
        wavelength_nm=WAVELENGTH_NM,
        coverage=facet_coverage(tracer, camera),
        facet_surface=tracer.facet_surface,
        surface_names=tuple(surface.name for surface in scene.surfaces),
    )


def _mean(light: LightField, camera: Camera) -> NDArray[np.float64]:
    """(n,) mean spectrum of our picture on WAVELENGTH_NM, the lamp's pixels left out."""
    image = gather(light, camera, _MEAN_SAMPLES, 1)
    return np.asarray(
        image.coefficients[0][image.surface >= 0].mean(axis=0, dtype=np.float64) @ image.spectra
    )


def _between(wavelength: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """(w, n) spectra on WAVELENGTH_NM of cubes that are 1 at one of their wavelengths, by ratios to a reference (n,).

    Where the reference is dark the ratio is that of the next wavelength.
    """
    here = np.interp(wavelength, WAVELENGTH_NM, reference)
    lit = np.flatnonzero(here > _DARK * here.max())
    found = np.zeros((wavelength.size, WAVELENGTH_NM.size))
    for index in lit:
        ratio = (lit == index) / here[index]
        found[index] = np.interp(WAVELENGTH_NM, wavelength[lit], ratio) * reference
    return found


def require_level(picture: Path, lamp_scale: float) -> None:
    """Raises InputError where the lamp had to be scaled out of all reason to fit the capture."""
    if not 1 / _WRONG_LEVEL < lamp_scale < _WRONG_LEVEL:
        raise InputError(
            picture,
            f"a picture {1 / lamp_scale:.3g} times as bright as the capture",
            "radiance in W m^-2 sr^-1 nm^-1 under the capture's own lamp",
            "Our own render through the capture's camera is under that lamp.",
        )
