"""Band responses: filter, lens, quantum efficiency and quanta per joule on one grid.

Every response in the program is built here, from tables of spectra: those that a capture states
(``sensor_equation``), those of the simulated laboratory, and those that effects of the filters have changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WavelengthGrid, trapezoidal_weights
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "PLANCK_J_S",
    "SPEED_OF_LIGHT_M_S",
    "BandResponse",
    "ResponseFactors",
    "band_centres",
    "lens_constant",
    "quanta_per_joule",
    "response_factors",
    "rest_curve",
    "sensor_matrix",
    "tabulation_errors",
]

#: Planck constant, J s, with the digits that the capture format prescribes.
PLANCK_J_S = 6.626e-34
#: Speed of light, m/s, with the digits that the capture format prescribes.
SPEED_OF_LIGHT_M_S = 2.998e8


def lens_constant(focal_length_mm: float, pixel_pitch_um: float, gain_e_per_dn: float) -> float:
    """Constant C of a lens without losses, pi / 4 (focal length times pixel pitch)^2 / gain.

    Parameters
    ----------
    focal_length_mm
        Focal length, mm.
    pixel_pitch_um
        Distance of neighbouring pixels, um; square pixels.
    gain_e_per_dn
        Electrons per count, e-/DN.

    Returns
    -------
    float
        C, mm^2 m^2 / (e-/DN).
    """
    return float(np.pi / 4 * focal_length_mm**2 * (pixel_pitch_um * 1e-6) ** 2 / gain_e_per_dn)


def quanta_per_joule(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Photons per joule of light, F = wavelength / (h c).

    Parameters
    ----------
    wavelength_nm
        Wavelengths, any shape, nm.

    Returns
    -------
    NDArray
        Photons per joule, in the same shape.
    """
    return np.asarray(wavelength_nm, float) * 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)


@dataclass(frozen=True, eq=False)
class BandResponse:
    """The response of one band to spectral radiance."""

    #: Identifier of the band.
    band: str
    #: Grid of n wavelengths on which the response is tabulated.
    grid: WavelengthGrid
    #: (n,) F Q T_lens T_filter, quanta per joule.
    response: NDArray[np.float64]
    #: K = C t / (f_number^2 d^2) for a flat of 1, DN per (W m^-2 sr^-1 quanta J^-1).
    factor: float

    @property
    def wavelength_nm(self) -> NDArray[np.float64]:
        """(n,) wavelengths of the grid, nm."""
        return self.grid.nm

    @property
    def weights(self) -> NDArray[np.float64]:
        """(n,) DN per (W m^-2 sr^-1 nm^-1): the signal is the sum of weights times radiance."""
        return self.factor * self.response * self.grid.weights

    def signal(self, radiance: ArrayLike) -> NDArray[np.float64]:
        """Signal of the band for spectral radiance.

        Parameters
        ----------
        radiance
            (..., n) spectral radiance on ``wavelength_nm``, W m^-2 sr^-1 nm^-1.

        Returns
        -------
        NDArray
            (...) signal above dark, DN.
        """
        return np.asarray(radiance, float) @ self.weights


def sensor_matrix(responses: tuple[BandResponse, ...]) -> NDArray[np.float64]:
    """Matrix W of several bands: the signals of radiance L on the common grid are W L.

    Parameters
    ----------
    responses
        Responses of the bands, all on one grid.

    Returns
    -------
    NDArray
        (band, wavelength) weights, DN per (W m^-2 sr^-1 nm^-1).
    """
    return np.stack([response.weights for response in responses])


def tabulation_errors(
    responses: tuple[BandResponse, ...], radiance: Spectrum, steps_nm: Sequence[float]
) -> NDArray[np.float64]:
    """Relative change of each band's signal where the integral is taken in the steps of a table.

    Estimates the error of tables with few wavelengths: the trapezoidal rule in their steps against that of the
    responses' grid. The error is large where a spectrum begins or ends within a band.

    Parameters
    ----------
    responses
        Responses of the bands, all on one grid.
    radiance
        Spectral radiance of the light source; its scale cancels.
    steps_nm
        (band,) step of each band's table, nm.

    Returns
    -------
    NDArray
        (band,) coarse signal over fine signal, minus 1; 0 for tables as fine as the grid.
    """
    grid, errors = responses[0].grid, []
    for response, step_nm in zip(responses, steps_nm, strict=True):
        coarse = slice(None, None, max(round(step_nm / grid.step_nm), 1))
        light = response.response * radiance.at(grid.nm)
        rough = light[coarse] @ trapezoidal_weights(grid.nm[coarse])
        errors.append(rough / max(float(light @ grid.weights), 1e-300) - 1)
    return np.array(errors)


@dataclass(frozen=True, eq=False)
class ResponseFactors:
    """The responses of several bands, with the filters separate from the other factors."""

    #: Identifiers of the bands.
    bands: tuple[str, ...]
    #: Grid of w wavelengths: INTEGRAL_GRID or a wider one that contains it.
    grid: WavelengthGrid
    #: (band, w) transmittance of the filters alone.
    transmittance: NDArray[np.float64]
    #: (band, w) F Q T_lens, quanta per joule, see ``rest_curve``.
    rest: NDArray[np.float64]
    #: (band,) K, see ``BandResponse.factor``.
    factor: NDArray[np.float64]

    def responses(self) -> tuple[BandResponse, ...]:
        """The responses of the bands on INTEGRAL_GRID; the lens transmits no light outside it.

        Returns
        -------
        tuple
            One BandResponse per band, in the order of ``bands``.
        """
        inside = self.grid.part(INTEGRAL_GRID)
        curves = self.rest[:, inside] * self.transmittance[:, inside]
        return tuple(
            BandResponse(band, INTEGRAL_GRID, curve, float(factor))
            for band, curve, factor in zip(self.bands, curves, self.factor, strict=True)
        )


def rest_curve(efficiency: Spectrum, lens: Spectrum, grid: WavelengthGrid = INTEGRAL_GRID) -> NDArray[np.float64]:
    """Response of a band without its filter, F Q T_lens.

    Parameters
    ----------
    efficiency
        Quantum efficiency of the sensor, 0 to 1.
    lens
        Transmittance of the lens, 0 to 1.
    grid
        Grid of w wavelengths.

    Returns
    -------
    NDArray
        (w,) quanta per joule, 0 outside INTEGRAL_GRID.
    """
    inside = grid.part(INTEGRAL_GRID)
    wavelength = grid.nm[inside]
    rest = np.zeros(grid.count)
    rest[inside] = quanta_per_joule(wavelength) * efficiency.at(wavelength) * lens.at(wavelength)
    return rest


def response_factors(
    filters: Mapping[str, Spectrum],
    rests: Sequence[NDArray[np.float64]],
    factors: Sequence[float],
    grid: WavelengthGrid = INTEGRAL_GRID,
) -> ResponseFactors:
    """Tabulate the filters of several bands next to their other factors.

    Parameters
    ----------
    filters
        By band, the transmittance of its filter.
    rests
        (w,) ``rest_curve`` of each band on ``grid``, in the order of ``filters``.
    factors
        K of each band, see ``BandResponse.factor``.
    grid
        Grid of w wavelengths.

    Returns
    -------
    ResponseFactors
        The bands in the order of ``filters``.
    """
    transmittance = np.array([curve.at(grid.nm) for curve in filters.values()])
    return ResponseFactors(tuple(filters), grid, transmittance, np.array(rests), np.array(factors))


def band_centres(responses: Sequence[BandResponse]) -> tuple[float, ...]:
    """Mean wavelength of every band's response.

    Parameters
    ----------
    responses
        Responses of the bands.

    Returns
    -------
    tuple
        (band,) wavelengths, nm.
    """
    weights = np.stack([r.response for r in responses], axis=-1)
    return tuple(float(nm) for nm in (responses[0].wavelength_nm @ weights) / weights.sum(axis=0))
