"""The band responses as seen at field angles: filters pass other wavelengths off the axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.instrument import BandResponse, ResponseFactors
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import WavelengthGrid
from numpy.typing import NDArray

__all__ = ["BandCurves", "field_shares", "field_sine_squared", "over_field"]

#: Field angles at which responses are known, even in the sine squared from the axis to the image's corner.
FIELD_ANGLES = 9

#: Largest sine squared of the angles over that of the corner: a camera that is fitted again stays inside.
_MARGIN = 1.02


@dataclass(frozen=True, eq=False)
class BandCurves:
    """Value of the filter stage: the band responses, factored, at several field angles.

    Effects of this stage act in every frame through the filter, flats and reference too.
    """

    #: Names of the bands.
    bands: tuple[str, ...]
    #: Grid of w wavelengths.
    grid: WavelengthGrid
    #: (angle, band, w) transmittance of the filters alone.
    transmittance: NDArray[np.float64]
    #: (angle,) sines squared of the field angles, ascending from 0.
    sine_squared: NDArray[np.float64]
    #: (band, w) F Q T_lens.
    rest: NDArray[np.float64]
    #: (band,) K.
    factor: NDArray[np.float64]

    @property
    def wavelength_nm(self) -> NDArray[np.float64]:
        """(w,) nm."""
        return self.grid.nm

    def responses(self, angle: int = 0) -> tuple[BandResponse, ...]:
        """Band responses at one field angle, on the integral's grid.

        Parameters
        ----------
        angle
            Index of the field angle; 0 is the axis.

        Returns
        -------
        tuple of BandResponse
            One response a band.
        """
        transmittance = self.transmittance[angle]
        return ResponseFactors(self.bands, self.grid, transmittance, self.rest, self.factor).responses()


def field_sine_squared(camera: Camera) -> NDArray[np.float64]:
    """Sine squared of the angle between each pixel's ray and the optical axis.

    Parameters
    ----------
    camera
        The camera.

    Returns
    -------
    NDArray
        (y, x) sines squared; NaN for a pixel without a ray.
    """
    directions = camera.directions(*np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)))
    return 1.0 - (directions @ camera.rotation[2]) ** 2


def over_field(factors: ResponseFactors, camera: Camera) -> BandCurves:
    """Responses at FIELD_ANGLES from the axis to the corner of the image, the same at all.

    Parameters
    ----------
    factors
        Factored responses on the axis.
    camera
        Camera whose corner is the largest angle.

    Returns
    -------
    BandCurves
        Value of the filter stage without effects.
    """
    sine_squared = np.linspace(0.0, 1.0, FIELD_ANGLES) * _MARGIN * np.nanmax(field_sine_squared(camera))
    transmittance = np.tile(factors.transmittance, (FIELD_ANGLES, 1, 1))
    return BandCurves(factors.bands, factors.grid, transmittance, sine_squared, factors.rest, factors.factor)


def field_shares(curves: BandCurves, camera: Camera) -> NDArray[np.float64]:
    """Shares of the field angles in each pixel's signal.

    The shares are those of a cubic spline in the squared sine of the angle, in which the shift of a pass band is nearly
    linear. Pixels beyond the largest angle of the curves, and those without a ray, have the shares of that angle, since
    a cubic grows fast outside its knots.

    Parameters
    ----------
    curves
        Responses at field angles.
    camera
        The camera.

    Returns
    -------
    NDArray
        (angle, y, x) shares; (1, 1, 1) where the responses are the same at all angles.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    if np.ptp(curves.transmittance, axis=0).max() == 0:
        return np.ones((1, 1, 1))
    knots = curves.sine_squared
    sine_squared = np.nan_to_num(np.minimum(field_sine_squared(camera), knots[-1]), nan=knots[-1])
    return np.moveaxis(CubicSpline(knots, np.eye(knots.size))(sine_squared), -1, 0)
