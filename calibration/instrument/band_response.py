"""Band responses: filter times lens times quantum efficiency times quanta per joule, on one grid of wavelengths.

Every response in the program is built here, from tables of spectra: those that a capture states (``sensor_equation``),
those of the simulated laboratory, and those that effects of the filters have changed.
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
    "lens_constant",
    "quanta_per_joule",
    "response_factors",
    "rest_curve",
    "sensor_matrix",
    "tabulation_errors",
]

#: The constants with the digits that the capture format prescribes.
PLANCK_J_S = 6.626e-34
SPEED_OF_LIGHT_M_S = 2.998e8


#: The largest step for integrals over wavelength that CIE 15 recommends.
TABLE_STEP_NM = 5.0


def lens_constant(focal_length_mm: float, pixel_pitch_um: float, gain_e_per_dn: float) -> float:
    """C of a lens without losses, mm^2 m^2 / (e-/DN)."""
    return float(np.pi / 4 * focal_length_mm**2 * (pixel_pitch_um * 1e-6) ** 2 / gain_e_per_dn)


def quanta_per_joule(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """F = l / (h c) at wavelengths (any shape, nm)."""
    return np.asarray(wavelength_nm, float) * 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)


@dataclass(frozen=True, eq=False)
class BandResponse:
    """The response of one band to spectral radiance.

    grid : of n wavelengths. response : (n,) F Q T_lens T_i, quanta per joule.
    factor : K = C t / (f_number^2 d^2), DN per (W m^-2 sr^-1 quanta J^-1), for a flat of 1.
    """

    band: str
    grid: WavelengthGrid
    response: NDArray[np.float64]
    factor: float

    @property
    def wavelength_nm(self) -> NDArray[np.float64]:
        """(n,) nm."""
        return self.grid.nm

    @property
    def weights(self) -> NDArray[np.float64]:
        """(n,) DN per (W m^-2 sr^-1 nm^-1): the signal is the sum of weights times radiance."""
        return self.factor * self.response * self.grid.weights

    def signal(self, radiance: ArrayLike) -> NDArray[np.float64]:
        """Signal (...) in DN above dark, for radiance (..., n) in W m^-2 sr^-1 nm^-1 on ``wavelength_nm``."""
        return np.asarray(radiance, float) @ self.weights


def sensor_matrix(responses: tuple[BandResponse, ...]) -> NDArray[np.float64]:
    """(band, wavelength) matrix W: the signals of radiance L (on the common grid) are W L."""
    return np.stack([response.weights for response in responses])


def tabulation_errors(responses: tuple[BandResponse, ...], radiance: Spectrum) -> NDArray[np.float64]:
    """(band,) relative change of the signals of a light source where the integral is taken in coarser steps.

    How large the error of tables, known at some wavelengths only, may be: the trapezoidal rule in steps of
    TABLE_STEP_NM against that of the responses' grid. Large where a spectrum begins or ends within a band.
    """
    grid = responses[0].grid
    coarse = slice(None, None, round(TABLE_STEP_NM / grid.step_nm))
    light = np.stack([response.response for response in responses]) * radiance.at(grid.nm)
    rough = light[:, coarse] @ trapezoidal_weights(grid.nm[coarse])
    return np.asarray(rough / np.maximum(light @ grid.weights, 1e-300) - 1)


@dataclass(frozen=True, eq=False)
class ResponseFactors:
    """The responses of several bands, with the filters separate from the other factors.

    grid : of w wavelengths, INTEGRAL_GRID or one that holds it. transmittance : (band, w) of the filters alone.
    rest : (band, w) F Q T_lens, see ``rest_curve``. factor : (band,) K, see BandResponse.
    """

    bands: tuple[str, ...]
    grid: WavelengthGrid
    transmittance: NDArray[np.float64]
    rest: NDArray[np.float64]
    factor: NDArray[np.float64]

    def responses(self) -> tuple[BandResponse, ...]:
        """The bands' responses on INTEGRAL_GRID; the lens transmits no light outside it."""
        inside = self.grid.part(INTEGRAL_GRID)
        curves = self.rest[:, inside] * self.transmittance[:, inside]
        return tuple(
            BandResponse(band, INTEGRAL_GRID, curve, float(factor))
            for band, curve, factor in zip(self.bands, curves, self.factor, strict=True)
        )


def rest_curve(efficiency: Spectrum, lens: Spectrum, grid: WavelengthGrid = INTEGRAL_GRID) -> NDArray[np.float64]:
    """(w,) F Q T_lens, quanta per joule: a band's response without its filter, 0 outside INTEGRAL_GRID."""
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
    """From the filters' transmittances by band and, in their order, ``rest_curve`` on ``grid`` and K of each."""
    transmittance = np.array([curve.at(grid.nm) for curve in filters.values()])
    return ResponseFactors(tuple(filters), grid, transmittance, np.array(rests), np.array(factors))
