"""What is constant on one capture's way from radiance to counts: responses, flats, reference, darks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.band_images import Mask
from cboxlab.calibration.calibrate import Calibration
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.manifest import FlatTable, ReferenceTable
from cboxlab.calibration.mosaic import channel_mask
from cboxlab.calibration.sensor_equation import (
    PLANCK_J_S,
    SPEED_OF_LIGHT_M_S,
    WAVELENGTH_NM,
    missing_keys,
    optical_factor,
)
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray

from .effects import BandCurves

__all__ = ["CURVE_NM", "Sensing", "field_sine_squared", "sensing"]

#: (421,) nm, the grid of the filters' curves. It reaches beyond the integral's 400 to 700 nm, where the rest
#: of the response is 0, so that a shifted filter finds its own table there.
CURVE_NM = np.arange(380.0, 801.0)

#: Field angles at which responses are known, even in the sine squared from the axis to the image's corner.
FIELD_ANGLES = 9

# How far beyond its corner the angles reach, so that a camera refitted a little stays inside.
_MARGIN = 1.02


@dataclass(frozen=True, eq=False)
class Sensing:
    """A capture's constants. Arrays (band,) and (band, y, x) in the manifest's order.

    curves : the responses without effects, for the measured C. flat_radiance, reference_radiance :
    (band, 301) of the uniform sources on WAVELENGTH_NM, 1 where not stated. flat : the measured response,
    1 on average over ``usable``. good : pixels from which C was measured. flat_level : mean of the flat above
    dark, DN, 0 where there is none. reference_factor : C t / (f_number^2 d^2) of the reference frames.
    reference_weight : of this band in the mean C, 0 without a reference. dark_* : DN. exposure_* : s.
    minutes : from the first frame's beginning to the middle of the band's frames. full_scale : DN.
    """

    curves: BandCurves
    flat_radiance: NDArray[np.float64]
    reference_radiance: NDArray[np.float64]
    flat: NDArray[np.float64]
    usable: NDArray[np.bool_]
    good: NDArray[np.bool_]
    flat_level: NDArray[np.float64]
    reference_factor: NDArray[np.float64]
    reference_weight: NDArray[np.float64]
    dark_scene: NDArray[np.float64]
    dark_flat: NDArray[np.float64]
    dark_reference: NDArray[np.float64]
    exposure_scene: NDArray[np.float64]
    exposure_flat: NDArray[np.float64]
    exposure_reference: NDArray[np.float64]
    minutes: NDArray[np.float64]
    full_scale: float


def field_sine_squared(camera: Camera) -> NDArray[np.float64]:
    """(y, x) sine squared of the angle between each pixel's ray and the optical axis; NaN without a ray."""
    directions = camera.directions(*np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)))
    return 1.0 - (directions @ camera.rotation[2]) ** 2


def _curves(calibration: Calibration, constant: float, camera: Camera) -> BandCurves:
    """Raises InputError where tables are missing."""
    capture = calibration.capture
    lens = capture.manifest.lens.transmittance
    filters, rest, factor = [], [], []
    quanta = CURVE_NM * 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
    inside = (CURVE_NM >= WAVELENGTH_NM[0]) & (CURVE_NM <= WAVELENGTH_NM[-1])
    for band in capture.manifest.band:
        efficiency = capture.quantum_efficiency(
            None if calibration.channels is None else calibration.channels[band.id]
        )
        known = optical_factor(capture, band)
        if lens is None or efficiency is None or band.transmittance is None or known is None:
            found = f"no {', '.join(missing_keys(capture))}"
            expected = "these keys, without which a render predicts no counts"
            raise InputError(capture.folder / "capture.toml", found, expected)
        filters.append(capture.light(band.transmittance).at(CURVE_NM))
        rest.append(quanta * efficiency.at(CURVE_NM) * capture.light(lens).at(CURVE_NM) * inside)
        factor.append(constant * known)
    sine_squared = np.linspace(0.0, 1.0, FIELD_ANGLES) * _MARGIN * np.nanmax(field_sine_squared(camera))
    transmittance = np.tile(np.array(filters), (FIELD_ANGLES, 1, 1))
    return BandCurves(
        capture.band_ids, CURVE_NM, transmittance, sine_squared, np.array(rest), np.array(factor)
    )


def _minutes(capture: Capture) -> NDArray[np.float64]:
    """(band,) to the middle of each band's frames; without ``start_s`` a band follows the last at once."""
    readout, free, middles = capture.manifest.camera.readout_s, 0.0, []
    for band in capture.manifest.band:
        start = free if band.start_s is None else band.start_s
        period = band.exposure_s + readout
        middles.append(start + (len(band.frames) - 1) / 2 * period + band.exposure_s / 2)
        free = start + len(band.frames) * period
    return np.array(middles) / 60.0


@dataclass(frozen=True, eq=False)
class _Band:
    flat: FlatTable | None
    reference: ReferenceTable | None
    weight: float
    flat_radiance: NDArray[np.float64]
    reference_radiance: NDArray[np.float64]


def _sources(calibration: Calibration, band: str) -> _Band:
    """The uniform sources of a band; the first table counts where there are several."""
    capture = calibration.capture
    flat = next(iter(capture.flats(band)), None)
    radiometry = calibration.radiometry
    measured = [w for c, w in zip(radiometry.by_band, radiometry.weights, strict=True) if c.band == band]
    reference = next(iter(capture.references(band)), None) if measured else None
    ones = np.ones_like(WAVELENGTH_NM)
    named = next((table.radiance for table in capture.references(band)), None)
    own = ones if named is None else capture.light(named).at(WAVELENGTH_NM)
    uniform = own if flat is None or flat.radiance is None else capture.light(flat.radiance).at(WAVELENGTH_NM)
    return _Band(flat, reference, float(sum(measured)), uniform, own)


def _channels(calibration: Calibration) -> NDArray[np.bool_]:
    """(band, y, x) the pixels of each band's channel; all of them without a mosaic."""
    capture, mosaic = calibration.capture, calibration.capture.manifest.mosaic
    if calibration.channels is None or mosaic is None:
        return np.ones((len(capture.band_ids), *capture.shape), bool)
    letters = [calibration.channels[band] for band in capture.band_ids]
    return np.stack([channel_mask(mosaic.pattern, capture.shape, letter) for letter in letters])


def sensing(calibration: Calibration, camera: Camera) -> Sensing:
    """The constants of a capture. camera : for the range of field angles.

    Raises InputError where the capture lacks what a prediction of counts takes.
    """
    capture, constant = calibration.capture, calibration.radiometry.constant
    if constant is None:
        found = "neither usable reference frames nor focal length, pixel pitch and gain"
        raise InputError(capture.folder / "capture.toml", found, "one of them, for the constant C")
    bands = calibration.bands
    unusable = Mask.HOT | Mask.DEAD | Mask.VIGNETTED
    mask = bands.images["mask"].values
    flats = [bands.flats[band] for band in capture.band_ids]
    usable = ~np.stack([flat.saturated for flat in flats]) & _channels(calibration)
    sources = [_sources(calibration, band) for band in capture.band_ids]
    exposures = {
        "scene": np.array([band.exposure_s for band in capture.manifest.band]),
        "flat": np.array([s.flat.exposure_s if s.flat else 1.0 for s in sources]),
        "reference": np.array([s.reference.exposure_s if s.reference else 1.0 for s in sources]),
    }
    sound = (mask & unusable) == 0

    def dark(of: str) -> NDArray[np.float64]:
        levels = zip(exposures[of], sound, strict=True)
        return np.array([float(calibration.dark.at(t)[s].mean()) if s.any() else 0.0 for t, s in levels])

    factors = [0.0 if s.reference is None else optical_factor(capture, s.reference) or 0.0 for s in sources]
    return Sensing(
        curves=_curves(calibration, constant, camera),
        flat_radiance=np.stack([s.flat_radiance for s in sources]),
        reference_radiance=np.stack([s.reference_radiance for s in sources]),
        flat=np.stack([flat.response for flat in flats]),
        usable=usable,
        good=usable & sound,
        flat_level=np.array([flat.mean_dn if np.isfinite(flat.mean_dn) else 0.0 for flat in flats]),
        reference_factor=constant * np.array(factors),
        reference_weight=np.array([s.weight for s in sources]),
        dark_scene=dark("scene"),
        dark_flat=dark("flat"),
        dark_reference=dark("reference"),
        exposure_scene=exposures["scene"],
        exposure_flat=exposures["flat"],
        exposure_reference=exposures["reference"],
        minutes=_minutes(capture),
        full_scale=float(capture.saturation_dn),
    )
