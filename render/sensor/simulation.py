"""Simulated recording of a spectral cube: expected electrons and counts, frames with noise.

Every frame has a seed, and each block of rows a separate random stream. The fixed pattern uses the camera's seed, so
that it is the same in every frame.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..image import LAMP
from .charge import spill_columns
from .detector import Detector, SensorCamera, digitise, quantise, shot_noise
from .light import BLOCK_ROWS, frame_shape, rate_blocks

__all__ = ["auto_exposure", "expected_electrons", "noiseless_frame", "simulate_frame"]


def _require_exposure(exposure_s: float) -> None:
    """Raise InputError for an exposure that is not above 0."""
    if not (np.isfinite(exposure_s) and exposure_s > 0):
        raise InputError("exposure", f"{exposure_s:g} s", "a time above 0")


def _rate(cube: xr.Dataset, camera: SensorCamera, channel: str | None) -> NDArray[np.float64]:
    """(y, x) electrons per second."""
    rate = np.empty(frame_shape(cube))
    for rows, block in rate_blocks(cube, camera, channel):
        rate[rows] = block
    return rate


def expected_electrons(
    cube: xr.Dataset, camera: SensorCamera, exposure_s: float, channel: str | None = None
) -> NDArray[np.float64]:
    """Expected photoelectrons, without dark charge, full well and fixed pattern.

    Parameters
    ----------
    cube
        Radiance (y, x, wavelength) as in ``RenderedImage.cube``, or coefficients (``spectral_basis``).
    camera
        The camera.
    exposure_s
        Exposure, s.
    channel
        The filter, for a camera without mosaic that has several.

    Returns
    -------
    NDArray
        (y, x) electrons.

    Raises
    ------
    InputError
        If the exposure is not above 0, and as ``rate_blocks``.
    """
    _require_exposure(exposure_s)
    rate = _rate(cube, camera, channel)
    rate *= exposure_s
    return rate


def noiseless_frame(
    cube: xr.Dataset, camera: SensorCamera, exposure_s: float, channel: str | None = None
) -> NDArray[np.float64]:
    """Counts without noise and rounding: F of the expected input, clipped to the bit depth.

    Parameters
    ----------
    cube, camera, exposure_s, channel
        As ``expected_electrons``.

    Returns
    -------
    NDArray
        (y, x) counts, DN.

    Raises
    ------
    InputError
        As ``expected_electrons``.
    """
    electrons = expected_electrons(cube, camera, exposure_s, channel)
    detector = camera.detector
    if detector.full_well_e is not None:
        if detector.blooms:
            electrons = spill_columns(electrons, detector.full_well_e)[0]
        electrons = np.minimum(electrons, detector.full_well_e)
    counts = detector.record(electrons / detector.gain_e_per_dn + detector.dark(exposure_s)[0])
    return np.clip(counts, 0, detector.full_scale_dn)


def simulate_frame(
    cube: xr.Dataset, camera: SensorCamera, exposure_s: float, seed: int, channel: str | None = None
) -> NDArray[np.uint16]:
    """One raw frame.

    Memory is needed for one block of the cube and for the frame; with blooming also for the frame's electrons.

    Parameters
    ----------
    cube, camera, exposure_s
        As ``expected_electrons``.
    seed
        Seed of the frame's noise; the same seed gives the same frame.
    channel
        As ``expected_electrons``.

    Returns
    -------
    NDArray
        (y, x) counts, DN.

    Raises
    ------
    InputError
        As ``expected_electrons``.
    """
    _require_exposure(exposure_s)
    detector, shape = camera.detector, frame_shape(cube)
    counts = np.empty(shape, np.uint16)
    charge = np.empty(shape) if detector.blooms else None
    streams = [np.random.default_rng([seed, start]) for start in range(0, shape[0], BLOCK_ROWS)]
    for (rows, rate), stream in zip(rate_blocks(cube, camera, channel), streams, strict=True):
        electrons = shot_noise(rate * exposure_s * _sensitivity(detector, rows, shape), stream)
        if charge is None:
            counts[rows] = _counted(electrons, detector, exposure_s, rows, stream)
        else:
            charge[rows] = electrons
    if charge is not None:
        if detector.full_well_e is not None:
            charge = spill_columns(charge, detector.full_well_e)[0]
        for start, stream in zip(range(0, shape[0], BLOCK_ROWS), streams, strict=True):
            rows = slice(start, min(start + BLOCK_ROWS, shape[0]))
            counts[rows] = _counted(charge[rows], detector, exposure_s, rows, stream)
    return counts


def _sensitivity(detector: Detector, rows: slice, shape: tuple[int, int]) -> NDArray[np.float64] | float:
    """Relative sensitivity of each pixel, (rows, x), or 1 without a pattern."""
    if not detector.sensitivity_spread:
        return 1.0
    draws = np.random.default_rng([detector.pattern_seed, rows.start, 0])
    normal = draws.standard_normal((rows.stop - rows.start, shape[1]))
    return np.maximum(1 + detector.sensitivity_spread * normal, 0.0)


def _counted(
    electrons: NDArray[np.float64],
    detector: Detector,
    exposure_s: float,
    rows: slice,
    stream: np.random.Generator,
) -> NDArray[np.uint16]:
    """Counts of a block's electrons (rows, x)."""
    mean, sigma = detector.dark(exposure_s)
    level: NDArray[np.float64] | float = mean
    if detector.offset_spread_dn:
        draws = np.random.default_rng([detector.pattern_seed, rows.start, 1])
        level = mean + detector.offset_spread_dn * draws.standard_normal(electrons.shape)
    return quantise(digitise(electrons, level, sigma, detector, stream), detector.bit_depth)


def auto_exposure(cube: xr.Dataset, camera: SensorCamera, channel: str | None = None, level: float = 0.7) -> float:
    """Exposure that brings bright pixels outside the lamp to a part of full scale.

    Needed for cubes of relative radiance.

    Parameters
    ----------
    cube, camera, channel
        As ``expected_electrons``.
    level
        99th percentile of the counts outside the lamp over full scale.

    Returns
    -------
    float
        Exposure, s.

    Raises
    ------
    InputError
        If the cube has no light outside the lamp, and as ``rate_blocks``.
    """
    detector = camera.detector
    rate = _rate(cube, camera, channel)
    if "surface" in cube and np.any(cube["surface"].values != LAMP):
        rate = rate[cube["surface"].values != LAMP]
    bright = float(np.percentile(rate, 99))
    if bright <= 0:
        raise InputError("cube: radiance", "no light outside the lamp", "light, to choose an exposure")
    target_dn = float(detector.linearise(level * detector.full_scale_dn))
    exposure = target_dn * detector.gain_e_per_dn / bright
    for _ in range(20):  # converges fast, since the dark level changes slowly with the exposure
        exposure = max(target_dn - detector.dark(exposure)[0], 1.0) * detector.gain_e_per_dn / bright
    return exposure
