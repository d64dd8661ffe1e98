"""The sensor equation: what a count means.

For a band, before noise and rounding (capture format, version 1; Pattanaik et al. 1997, eqs. 2 and 3),

    DN = K flat(u, v) Int F(l) Q(l) T_lens(l) T_i(l) L(l) dl + dark(t),   K = C t / (f_number^2 d^2),

with F(l) = l / (h c) in quanta per joule (l in m), L in W m^-2 sr^-1 nm^-1, dl in nm, t in s, d in the
unit of the focal length (mm here) and C = (pi / 4) focal_length^2 pixel_area / gain for the nominal lens.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.errors import InputError
from numpy.typing import ArrayLike, NDArray

from .capture import Capture
from .manifest import BandTable, BracketTable

__all__ = [
    "PLANCK_J_S",
    "SPEED_OF_LIGHT_M_S",
    "WAVELENGTH_NM",
    "BandResponse",
    "band_responses",
    "missing_keys",
    "nominal_constant",
    "optical_factor",
    "response_curve",
    "sensor_matrix",
    "trapezoidal_weights",
]

#: The constants to the digits that the capture format fixes.
PLANCK_J_S = 6.626e-34
SPEED_OF_LIGHT_M_S = 2.998e8

#: (301,) the grid of every integral: 400 to 700 nm by 1 nm. The lens passes nothing outside.
WAVELENGTH_NM = np.arange(400.0, 701.0)


def trapezoidal_weights(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) nm: the sum of weights times samples is the integral of their straight-line interpolation."""
    steps = np.diff(wavelength_nm)
    weights = np.zeros_like(wavelength_nm)
    weights[:-1] += steps / 2
    weights[1:] += steps / 2
    return weights


@dataclass(frozen=True, eq=False)
class BandResponse:
    """How one band answers spectral radiance.

    wavelength_nm : (n,) nm. response : (n,) F Q T_lens T_i, quanta per joule.
    factor : K = C t / (f_number^2 d^2), DN per (W m^-2 sr^-1 quanta J^-1), for a flat of 1.
    """

    band: str
    wavelength_nm: NDArray[np.float64]
    response: NDArray[np.float64]
    factor: float

    @property
    def weights(self) -> NDArray[np.float64]:
        """(n,) DN per (W m^-2 sr^-1 nm^-1): the signal is their sum with radiance on ``wavelength_nm``."""
        return self.factor * self.response * trapezoidal_weights(self.wavelength_nm)

    def signal(self, radiance: ArrayLike) -> NDArray[np.float64]:
        """Signal (...) in DN, above dark, of radiance (..., n) in W m^-2 sr^-1 nm^-1 on ``wavelength_nm``."""
        return np.asarray(radiance, float) @ self.weights


def sensor_matrix(responses: tuple[BandResponse, ...]) -> NDArray[np.float64]:
    """(band, wavelength) W, so that the signals are W L for radiance L on the common grid."""
    return np.stack([response.weights for response in responses])


def nominal_constant(capture: Capture) -> float | None:
    """C of the nominal lens, mm^2 m^2 / (e-/DN); None without focal length, pixel pitch or gain."""
    camera, focal = capture.manifest.camera, capture.manifest.lens.focal_length_mm
    if camera.pixel_pitch_um is None or camera.gain_e_per_dn is None or focal is None:
        return None
    pixel_area = (camera.pixel_pitch_um * 1e-6) ** 2
    return float(np.pi / 4 * focal**2 * pixel_area / camera.gain_e_per_dn)


def optical_factor(capture: Capture, table: BandTable | BracketTable) -> float | None:
    """t / (f_number^2 d^2) in s mm^-2; None where the table states no f-number or image distance."""
    f_number, distance = capture.f_number(table), capture.image_distance_mm(table)
    if f_number is None or distance is None:
        return None
    return table.exposure_s / (f_number**2 * distance**2)


def response_curve(
    capture: Capture, band: BandTable, channel: str | None = None
) -> NDArray[np.float64] | None:
    """(301,) F Q T_lens T_i on WAVELENGTH_NM, quanta per joule; None where one of the factors is not stated.

    channel : "R", "G" or "B" of a sensor with a mosaic.
    """
    lens = capture.manifest.lens.transmittance
    efficiency = capture.quantum_efficiency(channel)
    if lens is None or efficiency is None or band.transmittance is None:
        return None
    quanta = WAVELENGTH_NM * 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
    curves = (efficiency, capture.light(lens), capture.light(band.transmittance))
    return quanta * np.prod([curve.at(WAVELENGTH_NM) for curve in curves], axis=0)


def missing_keys(capture: Capture) -> tuple[str, ...]:
    """The keys that ``band_responses`` would need and the manifest does not have."""
    manifest, missing = capture.manifest, []
    if manifest.camera.quantum_efficiency is None:
        missing.append("camera.quantum_efficiency")
    if manifest.lens.transmittance is None:
        missing.append("lens.transmittance")
    for index, band in enumerate(manifest.band):
        for key in ("transmittance", "f_number", "image_distance_mm"):
            if getattr(band, key) is None:
                missing.append(f"band[{index}] ({band.id}).{key}")
    return tuple(missing)


def band_responses(
    capture: Capture, constant: float, channels: Mapping[str, str] | None = None
) -> tuple[BandResponse, ...]:
    """The responses of all bands, in the manifest's order, for C = ``constant`` (one for all bands).

    channels : by band, the channel of a sensor with a mosaic.

    Raises InputError naming the keys that are missing (see ``missing_keys``).
    """
    responses = []
    for band in capture.manifest.band:
        curve = response_curve(capture, band, None if channels is None else channels[band.id])
        factor = optical_factor(capture, band)
        if curve is None or factor is None:
            raise InputError(
                capture.folder / "capture.toml",
                f"no {', '.join(missing_keys(capture))}",
                "these keys, without which counts have no absolute meaning",
            )
        responses.append(BandResponse(band.id, WAVELENGTH_NM, curve, constant * factor))
    return tuple(responses)
