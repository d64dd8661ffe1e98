"""Real raw frames predicted: the ColorChecker of the seven-band capture, every band, exposure and Bayer pixel.

The camera's counts follow from the patches' spectra, the filters, the published ratios of the channels, the light's
fall-off (a cubic in the logarithm, fitted to the white paper of one frame per band) and one scale per band (fitted
to the channel of that frame that the filter is meant for). Neither the lamp's spectrum nor the camera's absolute
sensitivity was published.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.capture.capture import Capture, load_capture
from cboxlab.calibration.capture.mosaic import band_channels
from cboxlab.rendering.sensor.detector import Detector, SensorCamera
from cboxlab.rendering.sensor.simulation import expected_electrons, noiseless_frame
from cboxlab.scenes.spectra import Spectrum, read_spectra
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

PATTERN = ("GB", "RG")
#: Bayer pixels by their place in the pattern.
PIXELS = {"G (blue row)": (0, 0), "B": (0, 1), "R": (1, 0), "G (red row)": (1, 1)}
WHITE_PAPER = 26
#: Half of the window about a filter's peak in which its transmittance is above its noise, nm.
WINDOW_NM = 15.0
CLIPPED_DN = 250.0
#: Percentages are of counts from here up: below, rounding to whole counts is more than 10%.
FAINTEST_DN = 5.0
#: What the frames themselves say and the dark frames, cut off at 0, cannot: see the measurements' own page.
BLACK_DN, LATE_S = -0.30, 0.56e-3
#: How much further to the red the filters pass than their curves say, by band.
SHIFTS_NM = {"f500": 1.0, "f550": 3.0, "f600": 4.0}


@dataclass(frozen=True)
class Assumptions:
    """What is believed next to the published numbers."""

    black_dn: float = 0.0
    late_s: float = 0.0
    shifts_nm: dict[str, float] | None = None
    own_ratios: bool = False


@dataclass(frozen=True, eq=False)
class Cells:
    """One number per patch, band, exposure and Bayer pixel, all (n,)."""

    band: NDArray
    exposure_s: NDArray
    pixel: NDArray
    patch: NDArray
    strong: NDArray
    clipped: NDArray
    measured: NDArray
    predicted: NDArray

    def selected_by(self, keep: NDArray[np.bool_]) -> Cells:
        """Those for which ``keep`` holds."""
        return Cells(*(values[keep] for values in vars(self).values()))


def statistics(cells: Cells) -> dict[str, float]:
    """The columns of Table I, DN of 255 and per cent."""
    error = np.abs(cells.predicted - cells.measured)
    bright = cells.measured >= FAINTEST_DN
    percent = 100 * error[bright] / cells.measured[bright]
    return {
        "count": float(error.size),
        "mean": float(error.mean()),
        "mean_percent": float(percent.mean()),
        "rms": float(np.sqrt(np.mean(error**2))),
        "maximum": float(error.max()),
        "maximum_percent": float(percent.max()),
    }


def window(filter_curve: Spectrum, shift_nm: float) -> Spectrum:
    """The pass band alone, moved; by 1 nm, 0 at its ends."""
    peak = filter_curve.wavelength_nm[np.argmax(filter_curve.values)]
    grid = np.arange(peak - WINDOW_NM, peak + WINDOW_NM + 0.5)
    return Spectrum(grid + shift_nm, filter_curve.at(grid), "zero")


def shading(capture: Capture, frame: NDArray, pixel: tuple[int, int]) -> NDArray[np.float64]:
    """(y, x) the light's fall-off by the white paper: a cubic of its logarithm, 1 in the middle."""
    v, u = np.indices(frame.shape)
    x, y = u / frame.shape[1] - 0.5, v / frame.shape[1] - 0.5
    basis = np.stack([x**j * y**k for j in range(4) for k in range(4 - j)], axis=-1)
    paper = (capture.labels() == WHITE_PAPER) & (frame < CLIPPED_DN) & (frame > 2)
    paper &= (v % 2 == pixel[0]) & (u % 2 == pixel[1])
    coefficients = np.linalg.lstsq(basis[paper], np.log(frame[paper]), rcond=None)[0]
    coefficients[0] = 0.0
    return np.exp(basis @ coefficients)


def frames_of(capture: Capture) -> list[tuple[str, float, NDArray]]:
    """Band, exposure and frame (y, x) of everything photographed."""
    tables = [(band.id, band) for band in capture.manifest.band]
    tables += [(bracket.band, bracket) for bracket in capture.manifest.bracket]  # type: ignore[misc]
    return [(name, table.exposure_s, capture.frames(table)[0].astype(float)) for name, table in tables]


def predict(folder: Path, assumed: Assumptions) -> Cells:
    """Measured and predicted patch means of the whole capture."""
    capture = load_capture(folder)
    filters = read_spectra(folder / "spectra" / "filters.csv", "zero")
    ratios = read_spectra(folder / "spectra" / "channel-ratios.csv")
    labels, reflectance = capture.labels(), capture.label_reflectances()
    spectra = {label.label: reflectance[label.column] for label in capture.label_names() if label.column in reflectance}
    regions = {label: binary_erosion(labels == label, iterations=4) for label in spectra}
    frames, strongest = frames_of(capture), band_channels(capture)
    assert strongest is not None
    rows = []
    for index, band in enumerate(capture.band_ids):
        nominal = 400.0 + 50 * index
        ratio = {
            "R": float(ratios["red_over_green"].at(nominal)),
            "G": 1.0,
            "B": float(ratios["blue_over_green"].at(nominal)),
        }
        strong = strongest[band]
        exposures = [(seconds, frame - assumed.black_dn) for name, seconds, frame in frames if name == band]
        if assumed.own_ratios:
            ratio = measured_ratios(exposures, regions, strong, assumed.late_s)
        strong_pixel = "G (red row)" if strong == "G" else strong
        curve = window(filters[band], (assumed.shifts_nm or {}).get(band, 0.0))
        base_s = capture.band(band).exposure_s
        base = next(frame for name, seconds, frame in frames if name == band and seconds == base_s)
        fall_off = shading(capture, base - assumed.black_dn, PIXELS[strong_pixel])
        camera = camera_of(curve, ratio, assumed)
        cube = chart(fall_off, labels, spectra, curve)
        first = patch_means(expected_electrons(cube, camera, 1.0), regions, PIXELS[strong_pixel])
        mean_counts = patch_means(base, regions, PIXELS[strong_pixel]) - assumed.black_dn
        usable = mean_counts < CLIPPED_DN - 10
        scale = float(mean_counts[usable] @ first[usable] / (first[usable] @ first[usable]))
        for name, seconds, frame in frames:
            if name != band:
                continue
            expected = noiseless_frame(cube, camera, scale * (seconds + assumed.late_s) / (base_s + assumed.late_s))
            for pixel, offset in PIXELS.items():
                measured, forecast = patch_means(frame, regions, offset), patch_means(expected, regions, offset)
                brightest = patch_means(frame, regions, offset, np.max)
                for k, label in enumerate(regions):
                    rows.append(
                        (
                            band,
                            seconds,
                            pixel,
                            label,
                            pixel[0] == strong,
                            brightest[k] >= CLIPPED_DN,
                            measured[k],
                            forecast[k],
                        )
                    )
    return Cells(*(np.array(column) for column in zip(*rows, strict=True)))


def measured_ratios(
    frames: list[tuple[float, NDArray]], regions: dict[int, NDArray], strong: str, late_s: float
) -> dict[str, float]:
    """The channels' ratios to the strong one: medians over patches and exposures, neither faint nor clipped."""
    ratios_by_channel: dict[str, list[NDArray]] = {letter: [] for letter in "RGB"}
    for seconds, frame in frames:
        for pixel, offset in PIXELS.items():
            mean, top = patch_means(frame, regions, offset), patch_means(frame, regions, offset, np.max)
            rate = np.where((mean > FAINTEST_DN / 2) & (top < CLIPPED_DN), mean, np.nan) / (seconds + late_s)
            ratios_by_channel[pixel[0]].append(rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a channel that is faint everywhere has no median
        rates = {letter: np.nanmedian(np.array(rows), axis=0) for letter, rows in ratios_by_channel.items()}
        ratios = {letter: float(np.nanmedian(rate / rates[strong])) for letter, rate in rates.items()}
    return {letter: value if np.isfinite(value) else 0.0 for letter, value in ratios.items()}


def camera_of(curve: Spectrum, ratio: dict[str, float], assumed: Assumptions) -> SensorCamera:
    """The camera behind one filter, in counts: 1 DN is an electron, and white gives its own channel 1 DN in 1 s."""
    unit = np.trapezoid(curve.values, curve.wavelength_nm)
    channels = {letter: curve.scaled(value / unit) for letter, value in ratio.items()}
    detector = Detector(1.0, 8, np.ones(1), np.full(1, assumed.black_dn), np.zeros(1))
    return SensorCamera("Flea3", channels, PATTERN, detector, "published ratios")


def chart(fall_off: NDArray, labels: NDArray, label_spectra: dict[int, Spectrum], curve: Spectrum) -> xr.Dataset:
    """The chart as a cube over one filter's pass band; paper and what is unknown are white."""
    spectra = np.ones((256, curve.wavelength_nm.size))
    for label, reflectance in label_spectra.items():
        spectra[label] = reflectance.at(curve.wavelength_nm)
    radiance = fall_off[..., None] * spectra[labels]
    return xr.Dataset({"radiance": (("y", "x", "wavelength"), radiance)}, coords={"wavelength": curve.wavelength_nm})


def patch_means(
    frame: NDArray, regions: dict[int, NDArray], offset: tuple[int, int], how=np.mean
) -> NDArray[np.float64]:
    """(patch,) of the Bayer pixels at one place."""
    lattice = (slice(offset[0], None, 2), slice(offset[1], None, 2))
    return np.array([how(frame[lattice][region[lattice]]) for region in regions.values()])


STEPS = {
    "published numbers alone": Assumptions(),
    "+ black level and shutter by the frames": Assumptions(BLACK_DN, LATE_S),
    "+ filters moved to the red": Assumptions(BLACK_DN, LATE_S, SHIFTS_NM),
    "+ channel ratios by the frames": Assumptions(BLACK_DN, LATE_S, SHIFTS_NM, own_ratios=True),
}


def split(cells: Cells) -> tuple[float, float]:
    """Relative error, rms: the part common to all exposures of a patch in a band, and what is left next to it."""
    strong_cells = cells.selected_by(cells.strong & ~cells.clipped & (cells.measured >= FAINTEST_DN))
    error = np.log(strong_cells.predicted / strong_cells.measured)
    common, rest = [], []
    for key in set(zip(strong_cells.band.tolist(), strong_cells.patch.tolist(), strict=True)):
        group_error = error[(strong_cells.band == key[0]) & (strong_cells.patch == key[1])]
        common += [group_error.mean()] * group_error.size
        rest += list(group_error - group_error.mean())
    return float(np.sqrt(np.mean(np.square(common)))), float(np.sqrt(np.mean(np.square(rest))))
