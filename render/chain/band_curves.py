"""The band responses as seen at field angles: filters pass other wavelengths off the axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.instrument import BandResponse, ResponseFactors
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import WavelengthGrid
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

__all__ = ["BandCurves", "field_shares", "field_sine_squared", "over_field"]

#: Field angles at which responses are known, even in the sine squared from the axis to the image's corner.
FIELD_ANGLES = 9

# How far beyond its corner the angles reach, so that a camera refitted a little stays inside.
_MARGIN = 1.02


@dataclass(frozen=True, eq=False)
class BandCurves:
    """What the filter stage changes: the band responses, factored, as seen at field angles.

    grid : of w wavelengths. transmittance : (angle, band, w) of the filters alone, at the sines squared of the
    field angle ``sine_squared`` (angle,), ascending from 0. rest : (band, w) F Q T_lens. factor : (band,) K.
    Effects of this stage act in every frame through the filter, flats and reference too.
    """

    bands: tuple[str, ...]
    grid: WavelengthGrid
    transmittance: NDArray[np.float64]
    sine_squared: NDArray[np.float64]
    rest: NDArray[np.float64]
    factor: NDArray[np.float64]

    @property
    def wavelength_nm(self) -> NDArray[np.float64]:
        """(w,) nm."""
        return self.grid.nm

    def responses(self, angle: int = 0) -> tuple[BandResponse, ...]:
        """The band responses at one of the field angles, on the integral's grid."""
        transmittance = self.transmittance[angle]
        return ResponseFactors(self.bands, self.grid, transmittance, self.rest, self.factor).responses()


def field_sine_squared(camera: Camera) -> NDArray[np.float64]:
    """(y, x) sine squared of the angle between each pixel's ray and the optical axis; NaN without a ray."""
    directions = camera.directions(*np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)))
    return 1.0 - (directions @ camera.rotation[2]) ** 2


def over_field(factors: ResponseFactors, camera: Camera) -> BandCurves:
    """The responses at FIELD_ANGLES from the axis to the corner of the camera's image, filters alike at all."""
    sine_squared = np.linspace(0.0, 1.0, FIELD_ANGLES) * _MARGIN * np.nanmax(field_sine_squared(camera))
    transmittance = np.tile(factors.transmittance, (FIELD_ANGLES, 1, 1))
    return BandCurves(factors.bands, factors.grid, transmittance, sine_squared, factors.rest, factors.factor)


def field_shares(curves: BandCurves, camera: Camera) -> NDArray[np.float64]:
    """(angle, y, x) shares of the field angles in each pixel's signal; (1, 1, 1) where they are alike.

    A cubic spline in the sine squared, in which a pass band's shift is nearly linear. Pixels beyond the largest of
    the curves' angles, and those without a ray, have its shares: a cubic grows fast outside its knots.
    """
    if np.ptp(curves.transmittance, axis=0).max() == 0:
        return np.ones((1, 1, 1))
    knots = curves.sine_squared
    place = np.nan_to_num(np.minimum(field_sine_squared(camera), knots[-1]), nan=knots[-1])
    return np.moveaxis(CubicSpline(knots, np.eye(knots.size))(place), -1, 0)
