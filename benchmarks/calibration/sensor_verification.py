"""The sensor simulator against Vora, Farrell, Tietz and Brainard (2001), table by table, and against real frames.

    python benchmarks/calibration/sensor_verification.py [--json] [--frames FOLDER]

Where the paper measured in a laboratory, a stand-in of it is simulated by an independent path
(tests/oracles/verification_chart.py); what was assumed there is printed. The real frames are those of the seven-band
ColorChecker capture.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path

import colour
import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import colour_matching_functions
from cboxlab.calibration.radiometry.spectral_sensitivity import (
    band_constant,
    convex_sets,
    least_squares,
    wiener,
)
from cboxlab.rendering.image.spectral_basis import principal_components, spectral_error, to_basis
from cboxlab.rendering.sensor.cameras import load_camera
from cboxlab.rendering.sensor.colour_correction import (
    chart_reflectances,
    demosaic,
    fit_correction,
    linear_counts,
)
from cboxlab.rendering.sensor.detector import SensorCamera, noisy_counts
from cboxlab.rendering.sensor.simulation import auto_exposure, noiseless_frame, simulate_frame
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from oracles import verification_chart as chart
from oracles import verification_frames as frames

FRAMES = Path(__file__).resolve().parents[3] / "shared" / "real" / "seven-band-colorchecker"
COLUMNS = ("mean", "mean_percent", "rms", "maximum", "maximum_percent")
HEADER = ("mean |error|", "mean %", "rms", "max", "max %")
#: Table I, by exposure: mean, mean %, RMS, maximum, maximum %.
TABLE_1 = {
    "1/8": (1.49, 1.22, 2.59, 9.07, 13.23),
    "1/15": (3.18, 4.03, 4.11, 9.64, 30.99),
    "1/30": (4.96, 7.66, 5.43, 13.21, 24.13),
    "1/60": (3.47, 9.39, 3.66, 6.75, 26.19),
    "1/125": (1.85, 7.22, 1.96, 3.04, 15.16),
}
#: Tables IV (DCS-200), V (DCS-420) and VI (chart, DCS-200), by channel, the same columns.
TABLE_4 = {
    "R": (0.53, 0.65, 1.42, 8.07, 4.22),
    "G": (0.57, 0.55, 0.46, 1.34, 2.65),
    "B": (0.28, 0.62, 0.41, 1.58, 4.20),
}
TABLE_5 = {
    "R": (0.40, 0.51, 0.62, 2.47, 3.69),
    "G": (0.35, 0.55, 0.46, 1.34, 2.65),
    "B": (0.47, 0.66, 0.59, 1.50, 2.63),
}
TABLE_6 = {
    "R": (2.80, 2.63, 3.97, 13.63, 9.97),
    "G": (2.85, 2.41, 4.27, 11.70, 13.63),
    "B": (2.81, 4.68, 3.60, 9.95, 15.80),
}
#: Section IV: mean errors of X, Y, Z over their maxima, and Delta E*ab, mean and maximum.
SECTION_4 = (0.027, 0.0274, 0.0655, 6.6874, 14.79)
#: Error of each light's power and of the shutter, one sigma: what the per cent column of Table IV suggests.
POWER_ERROR = 0.008
ESTIMATES = {
    "constant bands": band_constant,
    "positive Wiener": wiener,
    "smoothest that fits": least_squares,
    "convex sets": lambda readings: convex_sets(readings)[0],
}
DRAWS = 1_000_000


def row(values: dict[str, float]) -> tuple[float, ...]:
    """In the order of Table I."""
    return tuple(values[column] for column in COLUMNS)


def estimated(name: str, run: chart.CalibrationRun) -> SensorCamera:
    """The camera with the sensitivities that its own readings gave."""
    camera = load_camera(name)
    mask = (chart.GRID >= chart.BANDS[0]) & (chart.GRID <= chart.BANDS[-1])
    channels = {
        letter: Spectrum(chart.GRID[mask], wiener(run.readings[letter])[mask] * camera.detector.gain_e_per_dn, "zero")
        for letter in "RGB"
    }
    return dataclasses.replace(camera, channels=channels)


def sensitivity_tables(result: dict) -> dict[str, SensorCamera]:
    """Tables IV and V, the methods compared; the estimated cameras."""
    cameras = {}
    for name in ("dcs200", "dcs420"):
        independent, camera = chart.IndependentCamera.read(name), load_camera(name)
        for error in (0.0, POWER_ERROR):
            run = chart.calibrate(independent, camera, error, np.random.default_rng(1))
            for method, estimate in ESTIMATES.items():
                for index, letter in enumerate("RGB"):
                    sensitivities = estimate(run.readings[letter])
                    fitted = chart.errors(
                        chart.predicted_counts(run, letter, sensitivities, camera), run.recorded[letter]
                    )
                    truth = np.interp(chart.GRID, chart.NM, independent.electrons[index]) / independent.gain
                    inside = (chart.GRID >= 400) & (chart.GRID <= 700)
                    miss = float(np.sqrt(np.mean((sensitivities - truth)[inside] ** 2)) / truth.max())
                    key = f"{name}, {100 * error:g}% of light, {method}, {letter}"
                    result[key] = {**fitted, "rms_from_truth": miss, "readings": run.recorded[letter].size}
        cameras[name] = estimated(name, run)
    return cameras


def chart_tables(camera: SensorCamera, result: dict) -> None:
    """Table I, section IV and Table VI: the DCS-200's chart under tungsten light."""
    generator = np.random.default_rng(2)
    independent = chart.IndependentCamera.read("dcs200")
    light = chart.chart_light(independent)
    cube = chart.as_dataset(chart.measured_cube(light, generator))
    acquired, simulated_table, table_6 = {}, {}, []
    for name, seconds in chart.EXPOSURES.items():
        acquired[name] = independent.record(light, seconds, 400, generator)
        simulated_table[name] = chart.patch_rgb(simulate_frame(cube, camera, seconds, seed=3))
        result[f"table 1, {name}"] = chart.errors(simulated_table[name], acquired[name])
        sharp = chart.patch_rgb(simulate_frame(cube, load_camera("dcs200"), seconds, seed=3))
        result[f"table 1 with the true sensitivities, {name}"] = chart.errors(sharp, acquired[name])
    for name in ("1/30", "1/60"):
        grid, metered = chart.metered(light, generator)
        curves = np.array([curve.at(grid) for curve in camera.channels.values()])
        seconds = chart.EXPOSURES[name]
        counts = seconds * chart.METER_STEP * (metered @ curves.T) / camera.detector.gain_e_per_dn
        table_6.append((counts + camera.detector.dark(seconds)[0], acquired[name]))
    for index, letter in enumerate("RGB"):
        predicted, measured = (np.concatenate([pair[k][:, index] for pair in table_6]) for k in (0, 1))
        result[f"table 6, {letter}"] = chart.errors(predicted, measured)
    result["section 4"] = colour_errors(camera, simulated_table["1/30"], acquired["1/30"])


def colour_errors(camera: SensorCamera, simulated: NDArray, acquired: NDArray) -> dict[str, float]:
    """Section IV: both through one correction to XYZ under D65, trained on the chart's own expected responses."""
    seconds, nm = chart.EXPOSURES["1/30"], np.arange(400.0, 701.0)
    curves = np.array([camera.channels[letter].at(nm) for letter in "RGB"])
    stimuli = chart_reflectances() * chart.planck(nm, chart.TUNGSTEN_K)
    expected = stimuli @ curves.T
    measured, simulated_counts = (linear_counts(counts, camera, seconds) for counts in (acquired, simulated))
    expected *= (expected.ravel() @ measured.ravel()) / (expected.ravel() @ expected.ravel())
    d65 = colour.SDS_ILLUMINANTS["D65"]
    correction = fit_correction(
        expected,
        chart_reflectances(),
        Spectrum(np.array(d65.wavelengths), np.array(d65.values), "zero"),
        1 / 12 + camera.detector.dark(seconds)[1] ** 2,
    )
    pair = correction.xyz(measured), correction.xyz(simulated_counts)
    white = pair[0][18]
    lab = [colour.XYZ_to_Lab(xyz / white[1], colour.XYZ_to_xy(white)) for xyz in pair]
    difference = np.linalg.norm(lab[0] - lab[1], axis=-1)
    relative = np.abs(pair[0] - pair[1]).mean(axis=0) / pair[0].max(axis=0)
    return {
        "X": float(relative[0]),
        "Y": float(relative[1]),
        "Z": float(relative[2]),
        "delta_e_mean": float(difference.mean()),
        "delta_e_maximum": float(difference.max()),
    }


def colour_from_truth(result: dict) -> None:
    """Delta E*ab of the chart as each camera sees it, demosaiced and corrected to XYZ, against its true XYZ."""
    nm = np.arange(400.0, 701.0)
    light = chart.chart_light(chart.IndependentCamera.read("dcs200"))[:, 20:321:10]
    cube = chart.as_dataset(np.repeat(light[:, None], chart.PATCH_PX**2, axis=1))
    tungsten, table = Spectrum(nm, chart.planck(nm, chart.TUNGSTEN_K), "zero"), colour.SDS_ILLUMINANTS["D65"]
    d65 = Spectrum(np.array(table.wavelengths), np.array(table.values), "zero")
    observer = colour_matching_functions()
    for name in ("dcs200", "dcs420", "nikon-d5100", "sony-a7r2"):
        camera = load_camera(name)
        seconds = auto_exposure(cube, camera)
        white_dn = float(linear_counts(camera.detector.full_scale_dn, camera, seconds))
        training, test_spectra = (
            demosaic(linear_counts(frame, camera, seconds), camera, white_dn).reshape(
                24, chart.PATCH_PX, chart.PATCH_PX, 3
            )[:, 10:-10, 10:-10]
            for frame in (noiseless_frame(cube, camera, seconds), simulate_frame(cube, camera, seconds, seed=4))
        )
        variance = camera.detector.dark(seconds)[1] ** 2 + training.mean() / camera.detector.gain_e_per_dn
        for target, white in (("the lamp", tungsten), ("D65", d65)):
            truth = (chart_reflectances() * white.at(nm)) @ observer.T / (white.at(nm) @ observer[1])
            fitted = fit_correction(training.mean(axis=(1, 2)), chart_reflectances(), white, variance)
            at = colour.XYZ_to_xy(white.at(nm) @ observer.T)
            true_lab = colour.XYZ_to_Lab(truth, at)
            patches = colour.XYZ_to_Lab(fitted.xyz(test_spectra.mean(axis=(1, 2))), at) - true_lab
            pixels = colour.XYZ_to_Lab(fitted.xyz(test_spectra), at) - true_lab[:, None, None]
            of_patches = np.linalg.norm(patches, axis=-1)
            result[f"{camera.name}, XYZ under {target}"] = {
                "patches": float(of_patches.mean()),
                "largest": float(of_patches.max()),
                "pixels": float(np.linalg.norm(pixels, axis=-1).mean()),
            }


def photon_count(result: dict) -> None:
    """Expected DN as ISETCam and its port pyisetcam 0.1.0 reckon them, over ours, on the chart.

    Photons s^-1 m^-2 nm^-1 at the sensor times quantum efficiency, summed over whole wavelength bins, times area and
    time, as volts over the voltage swing times 2^n - 1. pyisetcam itself is on no package index and needs Python
    3.12: this is its sensor's arithmetic, written here from its description.
    """
    camera, bits = load_camera("dcs200"), 8
    light = chart.chart_light(chart.IndependentCamera.read("dcs200"))[:, 20:321]
    area, joule = (camera.pixel_pitch_um * 1e-6) ** 2, 6.62607015e-34 * 299792458.0
    square = 4 * camera.f_number**2
    for name, step, cone in (
        ("1 nm samples, irradiance = pi L / (4 N^2)", 1, square),
        ("1 nm samples, irradiance = pi L / (1 + 4 N^2)", 1, 1 + square),
        ("10 nm samples, whole bins at both ends", 10, square),
    ):
        nm, spectra = np.arange(400.0, 701.0, step), light[:, ::step]
        quanta = np.pi / square * area * nm * 1e-9 / (6.626e-34 * 2.998e8)
        efficiency = np.array([camera.channels[letter].at(nm) for letter in "RGB"]) / quanta
        electrons = (spectra * nm * 1e-9 / joule * np.pi / cone) @ efficiency.T * step * area / 60
        swing = (2**bits - 1) * camera.detector.gain_e_per_dn
        theirs = electrons / swing * (2**bits - 1)
        radiance = np.repeat(np.repeat(spectra[:, None], 2, axis=0), 2, axis=1)
        cube = xr.Dataset({"radiance": (("y", "x", "wavelength"), radiance)}, coords={"wavelength": nm})
        frame = noiseless_frame(cube, camera, 1 / 60) - camera.detector.dark(1 / 60)[0]
        ours = np.stack([frame[::2, 0], frame[::2, 1], frame[1::2, 1]], axis=-1)
        result[name] = {"largest - 1": float(np.abs(theirs / ours - 1).max())}


def statistics_of_draws(results: dict[str, dict]) -> None:
    """A million draws against theory, in standard errors, and photon transfer."""
    camera = load_camera("sony-a7r2")
    detector, generator = camera.detector, np.random.default_rng(5)
    dark, sigma = detector.dark(1.0)
    means, variances = [], []
    for electrons in (0.0, 30.0, 1000.0, 30_000.0):
        counts = noisy_counts(np.full(DRAWS, electrons), dark, sigma, detector, generator)
        mean, variance = (
            dark + electrons / detector.gain_e_per_dn,
            electrons / detector.gain_e_per_dn**2 + sigma**2,
        )
        fourth = 2 * variance**2 + electrons / detector.gain_e_per_dn**4
        results["draws"][f"{electrons:g} e-"] = {
            "mean": float((counts.mean() - mean) / np.sqrt(variance / DRAWS)),
            "variance": float((counts.var(ddof=1) - variance) / np.sqrt(fourth / DRAWS)),
        }
        means.append(counts.mean() - dark)
        variances.append(counts.var(ddof=1))
    weight = 1 / np.array(variances)
    slope, floor = np.polyfit(means, variances, 1, w=weight)
    results["transfer"]["Sony ILCE-7RM2"] = {
        "gain found": float(1 / slope),
        "gain put in": detector.gain_e_per_dn,
        "sigma found": float(np.sqrt(floor)),
        "sigma put in": sigma,
    }


def bases(result: dict) -> None:
    """Cubes as coefficients: spectral error and error of the counts by number of components."""
    camera = load_camera("dcs200")
    light = chart.chart_light(chart.IndependentCamera.read("dcs200"))[:, 20:321:10]
    cube = chart.as_dataset(np.repeat(light[:, None], chart.PATCH_PX**2, axis=1))
    full = noiseless_frame(cube, camera, 1 / 30)
    for count in (3, 5, 8, 12, 31):
        coefficients = to_basis(cube, principal_components(cube, count))
        error = np.abs(noiseless_frame(coefficients, camera, 1 / 30) - full).max()
        result[f"{count} components"] = {"spectral": spectral_error(cube, coefficients), "largest, DN": float(error)}


def real_frames(folder: Path, result: dict) -> None:
    """The predicted frames: by what was assumed, then with all of it by exposure and by band."""
    for name, assumed in frames.STEPS.items():
        cells = frames.predict(folder, assumed)
        result[f"{name}: all"] = frames.statistics(cells)
        result[f"{name}: the filter's own channel, not clipped"] = frames.statistics(
            cells.selected_by(cells.strong & ~cells.clipped)
        )
        if name == next(iter(frames.STEPS)):
            for seconds in np.unique(cells.exposure_s):
                result[f"{name}: {seconds:g} s"] = frames.statistics(cells.selected_by(cells.exposure_s == seconds))
    for band in dict.fromkeys(cells.band.tolist()):
        for pixel in frames.PIXELS:
            keep = (cells.band == band) & (cells.pixel == pixel) & ~cells.clipped
            keep &= cells.measured >= frames.FAINTEST_DN
            if keep.sum() > 3:
                selected = cells.selected_by(keep)
                bias = float(100 * np.mean(selected.predicted / selected.measured - 1))
                result[f"{band}, {pixel}"] = {**frames.statistics(selected), "bias_percent": bias}
    common, rest = frames.split(cells)
    result["same at every exposure"], result["changing with exposure"] = {"rms": common}, {"rms": rest}


def line(name: str, *cells: object) -> None:
    """One line of a table."""
    print(f"{name:66s}" + "".join(f"{c:>13.3g}" if isinstance(c, float | int) else f"{c!s:>13s}" for c in cells))


def show(title: str, results: dict, papers: dict[str, tuple[float, ...]]) -> None:
    """Rows of Table I's columns, the paper's below ours."""
    print(f"\n{title}")
    line("", *HEADER)
    for name, values in results.items():
        line(name, *row(values))
        if name in papers:
            line("    the paper", *papers[name])


def report(results: dict[str, dict]) -> None:
    """Print every table."""
    tables, estimates = results["chart"], results["sensitivities"]
    print(
        f"Assumed: lamp {chart.TUNGSTEN_K:g} K, white at 90% of full scale in 1/30 s, filters "
        f"{chart.FILTER_FWHM:g} nm wide, spectroradiometer {chart.METER_FWHM:g} nm wide with "
        f"{100 * chart.METER_SIGMA:g}% per sample; light and shutter of the calibration {100 * POWER_ERROR:g}%."
    )
    for prefix, papers in (
        ("table 1, ", TABLE_1),
        ("table 1 with the true sensitivities, ", {}),
        ("table 6, ", TABLE_6),
    ):
        selected = {name.removeprefix(prefix): v for name, v in tables.items() if name.startswith(prefix)}
        show(prefix.strip(", ").capitalize() + ": errors in DN of 255", selected, papers)
    print("\nSection IV: mean error of X, Y, Z over their maxima, Delta E*ab mean and maximum")
    line("ours", *tables["section 4"].values())
    line("    the paper", *SECTION_4)
    for name, papers in (("dcs200", TABLE_4), ("dcs420", TABLE_5)):
        for error in (0.0, POWER_ERROR):
            print(f"\nTable {'IV' if name == 'dcs200' else 'V'}: {name}, lights known to {100 * error:g}%")
            line("", *HEADER, "from truth")
            for key, values in estimates.items():
                if not key.startswith(f"{name}, {100 * error:g}% "):
                    continue
                line(key.split("of light, ")[1], *row(values), f"{100 * values['rms_from_truth']:.2f}%")
                if error and "Wiener" in key:
                    line("    the paper", *papers[key[-1]])
    if "frames" in results:
        print("\nReal frames: 16 patches, 7 bands, 7 exposures, 4 Bayer pixels; errors in DN of 255")
        line("", *HEADER, "cells")
        for name, values in results["frames"].items():
            if "count" in values:
                line(
                    name,
                    *row(values),
                    *(
                        f"{v:+.1f}%" if k == "bias_percent" else v
                        for k, v in values.items()
                        if k in ("count", "bias_percent")
                    ),
                )
            else:
                line(f"relative error {name}", values["rms"])
    for title, key in (
        ("Chart under tungsten, demosaiced and corrected: Delta E*ab against truth", "colour"),
        ("Expected DN by counting photons, as ISETCam does, over ours", "photons"),
        ("A million draws: mean and variance minus theory, in standard errors", "draws"),
        ("Photon transfer: e-/DN and DN, found and put in", "transfer"),
        ("The chart in a basis of its principal components", "bases"),
    ):
        print(f"\n{title}")
        line("", *next(iter(results[key].values())))
        for name, values in results[key].items():
            line(name, *values.values())


def main() -> None:
    """Print the tables, or all of them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--frames", type=Path, default=FRAMES, help="the seven-band ColorChecker capture")
    arguments = parser.parse_args()
    results: dict[str, dict] = {
        "sensitivities": {},
        "chart": {},
        "colour": {},
        "photons": {},
        "draws": {},
        "transfer": {},
        "bases": {},
    }
    cameras = sensitivity_tables(results["sensitivities"])
    chart_tables(cameras["dcs200"], results["chart"])
    colour_from_truth(results["colour"])
    photon_count(results["photons"])
    statistics_of_draws(results)
    bases(results["bases"])
    if arguments.frames.is_dir():
        results["frames"] = {}
        real_frames(arguments.frames, results["frames"])
    if arguments.json:
        print(json.dumps(results, indent=1))
        return
    report(results)
    if "frames" not in results:
        print(f"\nReal frames left out: no folder {arguments.frames.name} (--frames)")


if __name__ == "__main__":
    main()
