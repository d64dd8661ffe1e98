"""The 2001 verification run again on a stand-in for its laboratory: a ColorChecker under tungsten light.

'Acquired' frames come from an independent path: spectra by 1 nm, the published sensitivities read here, sums, Poisson
and normal draws, rounding, all in this file. Simulated frames come from a measured 31-band cube through the simulator.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass

import colour
import numpy as np
import xarray as xr
from cboxlab.calibration.radiometry.spectral_sensitivity import NarrowBandReadings
from cboxlab.rendering.sensor.cameras import PACKAGED
from cboxlab.rendering.sensor.detector import SensorCamera
from numpy.typing import NDArray

NM = np.arange(380.0, 731.0)
BANDS = np.arange(400.0, 701.0, 10.0)
EXPOSURES = {"1/8": 1 / 8, "1/15": 1 / 15, "1/30": 1 / 30, "1/60": 1 / 60, "1/125": 1 / 125}
#: A slide projector's halogen lamp, K; pixels a side of a patch whose middle is read.
TUNGSTEN_K, PATCH_PX = 3200.0, 40
#: The hyperspectral camera: full width at half maximum of its filters, nm; gain, e-/DN; read noise, e-; 12 bits.
FILTER_FWHM, GAIN, READ_E, FULL = 10.0, 12.0, 10.0, 4095
#: The spectroradiometer (PR-650 class): bandwidth and sampling, nm; repeatability of a sample.
METER_FWHM, METER_STEP, METER_SIGMA = 8.0, 4.0, 0.005


def planck(wavelength_nm: NDArray, kelvin: float) -> NDArray[np.float64]:
    """Spectral radiance over that at 550 nm."""
    x = 1.4387769e7 / kelvin
    return (550 / wavelength_nm) ** 5 * np.expm1(x / 550) / np.expm1(x / wavelength_nm)


def reflectances() -> NDArray[np.float64]:
    """(24, NM) of the chart: BabelColor's averages."""
    chart = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.array([np.interp(NM, patch.wavelengths, patch.values) for patch in chart])


def bell(centre_nm: float, width_nm: float) -> NDArray[np.float64]:
    """A Gaussian pass band on NM, area 1."""
    curve = np.exp(-4 * np.log(2) * ((NM - centre_nm) / width_nm) ** 2)
    return curve / curve.sum()


@dataclass(frozen=True, eq=False)
class IndependentCamera:
    """The camera file, read without the simulator. electrons : (R G B, NM) e- s^-1 per W m^-2 sr^-1 nm^-1."""

    electrons: NDArray[np.float64]
    gain: float
    exposures: NDArray[np.float64]
    dark_dn: NDArray[np.float64]
    sigma_dn: NDArray[np.float64]
    square_root_from: float | None

    @staticmethod
    def read(name: str) -> IndependentCamera:
        """dcs200 or dcs420."""
        data = tomllib.loads((PACKAGED / f"{name}.toml").read_text(encoding="utf-8"))
        table = np.loadtxt(PACKAGED / "dcs200.csv", delimiter=",", skiprows=1)
        curves = np.array([np.interp(NM, table[:, 0], column) / NM for column in table[:, 1:].T])
        grid_nm = np.arange(380.0, 781.0)
        peak = max((np.interp(grid_nm, table[:, 0], column) / grid_nm).max() for column in table[:, 1:].T)
        solid = np.pi / 4 * (data["optics"]["pixel_pitch_um"] * 1e-6) ** 2 / data["optics"]["working_f_number"] ** 2
        quanta = NM * 1e-9 / (6.626e-34 * 2.998e8)
        scale = data["sensitivity"]["peak_quantum_efficiency"] / peak * solid
        dark = data["dark"]
        return IndependentCamera(
            scale * quanta * curves,
            data["detector"]["gain_e_per_dn"],
            np.array(dark["exposure_s"]),
            np.array(dark["mean_dn"]),
            np.array(dark["sigma_dn"]),
            data.get("nonlinearity", {}).get("square_root_from_dn"),
        )

    def record(
        self, light: NDArray, exposure_s: float, draws: int, generator: np.random.Generator
    ) -> NDArray[np.float64]:
        """(..., 3) mean counts of ``draws`` pixels of each channel for light (..., NM), W m^-2 sr^-1 nm^-1."""
        electrons = exposure_s * (light @ self.electrons.T)
        pixels = generator.poisson(electrons[..., None], (*electrons.shape, draws)) / self.gain
        mean = np.interp(exposure_s, self.exposures, self.dark_dn)
        sigma = np.sqrt(np.interp(exposure_s, self.exposures, self.sigma_dn**2))
        linear = pixels + mean + sigma * generator.standard_normal(pixels.shape)
        return np.clip(np.rint(self.nonlinear(linear)), 0, 255).mean(axis=-1)

    def nonlinear(self, linear_dn: NDArray) -> NDArray[np.float64]:
        """F: of the DCS-420 a square root."""
        if self.square_root_from is None:
            return linear_dn
        return 255 * np.sqrt(np.clip(linear_dn, 0, None) / self.square_root_from)


def chart_light(camera: IndependentCamera) -> NDArray[np.float64]:
    """(24, NM) radiance of the patches: the lamp so bright that white reads 90% of full scale in 1/30 s."""
    light = reflectances() * planck(NM, TUNGSTEN_K)
    top = 0.9 * 255 if camera.square_root_from is None else 0.81 * camera.square_root_from
    return light * (top - camera.dark_dn[-1]) * camera.gain * 30 / (light[18] @ camera.electrons.T).max()


def metered(light: NDArray, generator: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What the spectroradiometer says of light (..., NM): its wavelengths and readings."""
    grid = np.arange(NM[0], NM[-1] + 1, METER_STEP)
    signal = light @ np.array([bell(centre, METER_FWHM) for centre in grid]).T
    return grid, signal * (1 + METER_SIGMA * generator.standard_normal(signal.shape))


def measured_cube(light: NDArray, generator: np.random.Generator) -> NDArray[np.float64]:
    """(24, PATCH_PX^2, 31) radiance by the hyperspectral camera as in section III-B.

    Each band is exposed to 80% of full scale, dark-subtracted, and scaled so that the white patch's mean is what the
    spectroradiometer says there.
    """
    grid, reference = metered(light[18], generator)
    cube = np.empty((len(light), PATCH_PX**2, BANDS.size))
    for k, centre in enumerate(BANDS):
        signal = light @ bell(centre, FILTER_FWHM)
        electrons = 0.8 * FULL * GAIN * signal / signal.max()
        electrons_drawn = generator.poisson(electrons[:, None], (len(light), PATCH_PX**2))
        counts = (
            np.rint(electrons_drawn / GAIN + 100 + READ_E / GAIN * generator.standard_normal(electrons_drawn.shape))
            - 100
        )
        cube[..., k] = counts * np.interp(centre, grid, reference) / counts[18].mean()
    return np.maximum(cube, 0.0)


def as_dataset(cube: NDArray) -> xr.Dataset:
    """(24, PATCH_PX^2, 31) as a picture of patches below each other."""
    radiance = cube.reshape(24 * PATCH_PX, PATCH_PX, BANDS.size)
    return xr.Dataset({"radiance": (("y", "x", "wavelength"), radiance)}, coords={"wavelength": BANDS})


def patch_rgb(frame: NDArray) -> NDArray[np.float64]:
    """(24, 3) mean R, G, B of an RGGB frame of ``as_dataset``, over the middle half of each patch."""
    patches = frame.astype(float).reshape(24, PATCH_PX, PATCH_PX)
    low, high = PATCH_PX // 4, 3 * PATCH_PX // 4
    middle = patches[:, low:high, low:high]
    red, blue = middle[:, ::2, ::2], middle[:, 1::2, 1::2]
    green = np.concatenate([middle[:, ::2, 1::2], middle[:, 1::2, ::2]], axis=1)
    return np.stack([plane.mean(axis=(1, 2)) for plane in (red, green, blue)], axis=-1)


def errors(predicted: NDArray, measured: NDArray) -> dict[str, float]:
    """The columns of Table I."""
    error = np.abs(predicted - measured)
    percent = 100 * error / measured
    return {
        "mean": float(error.mean()),
        "mean_percent": float(percent.mean()),
        "rms": float(np.sqrt(np.mean(error**2))),
        "maximum": float(error.max()),
        "maximum_percent": float(percent.max()),
    }


@dataclass(frozen=True, eq=False)
class CalibrationRun:
    """A calibration with narrow-band lights. readings : by channel. recorded : counts and their exposures and dark."""

    readings: dict[str, NarrowBandReadings]
    recorded: dict[str, NDArray]
    exposure_s: dict[str, NDArray]


GRID = np.arange(390.0, 711.0, 5.0)
LIGHT_FWHM = 10.0
PIXELS_READ = 1000
#: Of the brightest light in the channel that sees it best, DN/s: even the faintest is read within 8 s.
BRIGHTEST_DN_S = 2000.0
#: Of each light, at its longest exposures that do not clip.
READINGS = 3
DIAL = np.array([1 / 125, 1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0, 8.0])


def calibrate(
    camera: IndependentCamera, simulated: SensorCamera, power_error: float, generator: np.random.Generator
) -> CalibrationRun:
    """Readings of 31 monochromatic lights at up to READINGS exposures each.

    Of every light the spectrum is known but for a relative error of its power, ``power_error``, one sigma, in which the
    shutter's error is meant to be included. Only counts of 20 to 240 are used. simulated : for F and the dark level.
    """
    lights = np.array([bell(centre, LIGHT_FWHM) for centre in BANDS]) * planck(BANDS, TUNGSTEN_K)[:, None]
    lights *= BRIGHTEST_DN_S * camera.gain / (lights @ camera.electrons.T).max()
    if camera.square_root_from is not None:
        lights *= camera.square_root_from / 255
    detector = simulated.detector
    readings, recorded, exposures = {}, {}, {}
    for index, letter in enumerate("RGB"):
        counts, used, spectra = [], [], []
        for light in lights:
            trials = [
                (seconds, float(camera.record(light, seconds, PIXELS_READ, generator)[index])) for seconds in DIAL
            ]
            usable = [(seconds, value) for seconds, value in trials if 20 <= value <= 240]
            if camera.square_root_from is not None:  # its dark level is 25
                usable = [(seconds, value) for seconds, value in usable if value >= 45]
            for seconds, value in usable[-READINGS:]:
                measured_light = light * (1 + power_error * generator.standard_normal())
                counts.append(value)
                used.append(seconds)
                spectra.append(np.interp(GRID, NM, np.convolve(measured_light, np.ones(5) / 5, "same")) * seconds)
        values, seconds_used = np.array(counts), np.array(used)
        dark = np.array([detector.dark(seconds)[0] for seconds in seconds_used])
        response = detector.linearise(values) - dark
        slope = np.gradient(detector.linearise(np.arange(256.0)))[np.rint(values).astype(int)]
        pixel = np.sqrt(response / camera.gain + detector.dark(1.0)[1] ** 2 + slope**2 / 12)
        sigma = np.hypot(pixel / np.sqrt(PIXELS_READ), power_error * response)
        readings[letter] = NarrowBandReadings(GRID, np.array(spectra), response, sigma)
        recorded[letter], exposures[letter] = values, seconds_used
    return CalibrationRun(readings, recorded, exposures)


def predicted_counts(
    run: CalibrationRun, letter: str, sensitivity: NDArray[np.float64], simulated: SensorCamera
) -> NDArray[np.float64]:
    """Counts that an estimate foretells for the lights it was made from."""
    detector = simulated.detector
    dark = np.array([detector.dark(seconds)[0] for seconds in run.exposure_s[letter]])
    return np.asarray(detector.record(run.readings[letter].predicted(sensitivity) + dark), np.float64)
