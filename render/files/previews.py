"""Preview pictures: sRGB from spectral cubes and from raw mosaics."""

from __future__ import annotations

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import OBSERVER_RANGE_NM, colour_matching_functions
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..image import LAMP, from_basis
from ..sensor import SensorCamera, chart_reflectances, demosaic, integration_weights, linear_counts

__all__ = ["cube_to_linear_srgb", "cube_to_srgb", "raw_to_srgb", "scene_white", "xyz_weights"]

#: Weight of the white patch in the colour fit, so that white is reproduced exactly.
_WHITE_WEIGHT = 1e3

#: Reflectance for which the noise in the colour fit is computed.
_GREY = 0.2

#: Range of previews, nm: that of photographs, see WAVELENGTH_NM.
_PREVIEW_NM = (float(WAVELENGTH_NM[0]), float(WAVELENGTH_NM[-1]))

#: Fraction of full scale that is shown as white; auto_exposure puts the brightest surfaces there.
_WHITE_LEVEL = 0.8


def scene_white(cube: xr.Dataset) -> Spectrum:
    """White of a picture: the mean spectrum of the visible lamp, else equal energy.

    Parameters
    ----------
    cube
        Cube, or coefficients of one.

    Returns
    -------
    Spectrum
        At the wavelengths of the cube.
    """
    wavelength = cube["wavelength"].values
    lamp = cube["surface"].values == LAMP if "surface" in cube else np.zeros((1, 1), bool)
    if not lamp.any():
        return Spectrum(wavelength, np.ones(wavelength.size))
    lamp_rows = np.flatnonzero(lamp.any(axis=1))
    part = cube.isel(y=lamp_rows)
    radiance = (part if "radiance" in part else from_basis(part))["radiance"].transpose("y", "x", "wavelength")
    return Spectrum(wavelength, np.asarray(radiance.values[lamp[lamp_rows]].mean(axis=0), float))


def _adapted(xyz: NDArray[np.float64], white_xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear sRGB of XYZ (..., 3), with the white adapted to D65 by the Bradford transform."""
    from colour import XYZ_to_sRGB, XYZ_to_xy  # slow to import, and only needed here

    return np.asarray(XYZ_to_sRGB(xyz, XYZ_to_xy(white_xyz), "Bradford", apply_cctf_encoding=False))


def xyz_weights(
    wavelength_nm: NDArray[np.float64], within_nm: tuple[float, float] = OBSERVER_RANGE_NM
) -> NDArray[np.float64]:
    """Weights from radiance samples to X, Y, Z, without luminous efficacy.

    Samples over a shorter range than visible light give the contribution of that range.

    Parameters
    ----------
    wavelength_nm
        (w,) wavelengths of the samples, nm, ascending.
    within_nm
        Range beyond which nothing is added, nm.

    Returns
    -------
    NDArray
        (w, 3) weights.

    Raises
    ------
    InputError
        If the samples lie outside visible light.
    """
    low, high = max(wavelength_nm[0], within_nm[0]), min(wavelength_nm[-1], within_nm[1])
    if not high > low:
        raise InputError("cube: wavelength", f"{wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm", "visible light")
    grid = np.union1d(np.arange(np.ceil(low), np.floor(high) + 1), [low, high])
    rows = colour_matching_functions(grid)
    return np.stack([integration_weights(Spectrum(grid, row, "zero"), wavelength_nm) for row in rows], -1)


def _encoded(linear: NDArray[np.float64]) -> NDArray[np.uint8]:
    """8-bit sRGB values of linear sRGB, clipped to 0 to 1."""
    from colour import cctf_encoding

    return np.rint(np.asarray(cctf_encoding(np.clip(linear, 0, 1))) * 255).astype(np.uint8)


def cube_to_linear_srgb(cube: xr.Dataset, white: Spectrum | None = None) -> NDArray[np.float64]:
    """Linear sRGB of a cube.

    Parameters
    ----------
    cube
        The cube.
    white
        Light that becomes neutral; None for ``scene_white``.

    Returns
    -------
    NDArray
        (y, x, 3); the 99.5th percentile of luminance outside the lamp is 1. Pixels of no finite radiance are 0, and
        all are for a cube without light.
    """
    wavelength = cube["wavelength"].values.astype(float)
    weights = xyz_weights(wavelength, _PREVIEW_NM)
    radiance = cube["radiance"].transpose("y", "x", "wavelength").values
    measured = np.isfinite(radiance).all(axis=-1)
    if not measured.any():
        return np.zeros((*measured.shape, 3))
    xyz = (radiance if measured.all() else np.where(measured[..., None], radiance, 0.0)) @ weights
    used = measured & (cube["surface"].values != LAMP) if "surface" in cube else measured
    brightest = float(np.percentile(xyz[..., 1][used if used.any() else measured], 99.5))
    if brightest <= 0:
        return np.zeros(xyz.shape)
    white_xyz = (white or scene_white(cube)).at(wavelength) @ weights
    return _adapted(xyz / brightest, white_xyz)


def cube_to_srgb(cube: xr.Dataset, white: Spectrum | None = None) -> NDArray[np.uint8]:
    """8-bit sRGB picture of a cube, see ``cube_to_linear_srgb``.

    Parameters
    ----------
    cube
        The cube.
    white
        As ``cube_to_linear_srgb``.

    Returns
    -------
    NDArray
        (y, x, 3) uint8.
    """
    return _encoded(cube_to_linear_srgb(cube, white))


def raw_to_srgb(
    counts: NDArray[np.uint16], camera: SensorCamera, exposure_s: float, white: Spectrum
) -> NDArray[np.uint8]:
    """8-bit sRGB picture of a raw frame with a 2 x 2 mosaic of R, G and B; grey without mosaic.

    1. Subtract the dark level, invert the response curve F.
    2. Balance for the illuminant ``white``.
    3. Interpolate the mosaic bilinearly (OpenCV).
    4. Apply a colour matrix of least mean square error (noise included) over the ColorChecker under that illuminant.
    5. Encode as sRGB.

    Parameters
    ----------
    counts
        (y, x) counts, DN.
    camera
        Camera of the frame.
    exposure_s
        Exposure, s.
    white
        Illuminant of the scene.

    Returns
    -------
    NDArray
        (y, x, 3) uint8.

    Raises
    ------
    InputError
        If the mosaic is of another kind.
    """
    linear = linear_counts(counts, camera, exposure_s)
    span = _WHITE_LEVEL * float(linear_counts(camera.detector.full_scale_dn, camera, exposure_s))
    if camera.pattern is None:
        return _encoded(np.repeat(linear[..., None] / span, 3, axis=-1))
    demosaiced = demosaic(linear, camera, span) / span
    matrix, balance = _colour_matrix(camera, exposure_s, span, white)
    return _encoded(np.clip(demosaiced * balance, 0, 1) @ matrix.T)


def _colour_matrix(
    camera: SensorCamera, exposure_s: float, span_dn: float, white: Spectrum
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colour matrix (3, 3) from balanced camera values to linear sRGB, and the balance (3,).

    The balance makes white (1, 1, 1). The fit also minimises the noise of a mid-grey after the matrix, so that a weak
    channel is not amplified too much. span_dn : counts above dark of white in the strongest channel.
    """
    reflectance = chart_reflectances()
    light = white.at(WAVELENGTH_NM)
    stimuli = np.vstack([reflectance, np.ones(WAVELENGTH_NM.size)]) * light
    sensitivity = np.stack([camera.channels[letter].at(WAVELENGTH_NM) for letter in "RGB"])
    response = stimuli @ sensitivity.T
    xyz = stimuli @ colour_matching_functions().T
    target = _adapted(xyz / xyz[-1, 1], xyz[-1])
    balance = response[-1].max() / response[-1]
    level = span_dn / balance
    detector = camera.detector
    variance = detector.dark(exposure_s)[1] ** 2 + 1 / 12 + _GREY * level / detector.gain_e_per_dn
    noise = np.diag(np.sqrt(len(reflectance) * variance) / level)
    weight = np.append(np.ones(len(reflectance)), _WHITE_WEIGHT)[:, None]
    inputs = np.vstack([weight * response / response[-1], noise])
    matrix = np.linalg.lstsq(inputs, np.vstack([weight * target, np.zeros((3, 3))]), rcond=None)[0].T
    return matrix, balance
