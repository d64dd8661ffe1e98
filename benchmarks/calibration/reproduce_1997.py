"""Figures 1 to 6 of Pattanaik et al. (1997) from one command, on anybody's capture or on a simulated camera.

    python benchmarks/calibration/reproduce_1997.py [CAPTURE] [--out FOLDER]

Without CAPTURE a PXL 1300L is simulated: the box through seven filters, and an integrating sphere at several
exposure times, f-numbers, image distances and levels. The figures are those that ``cbox calibrate`` draws:
response.png (1 to 4), filters.png (5 and 6).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.result.calibrate import Calibration, calibrate_capture
from cboxlab.calibration.result.write import write_calibration
from cboxlab.rendering.files.raw_files import write_raw
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.synthetic.capture_writer import sphere_spectrum, unit_factors
from cboxlab.rendering.synthetic.photographer import CaptureSettings, Shot, photograph, pixel_maps
from cboxlab.validation.synthetic.model_capture import perturbed_camera, write_model_capture

SIZE, SEED = 64, 1997
BAND = "f550"
TIMES = (0.1, 0.2, 0.4, 0.7, 1.0)
F_NUMBERS = (5.6, 8.0, 11.0, 16.0, 22.0)
DISTANCES_MM = (36.6, 40.0, 45.0, 50.0, 58.0)
LEVELS = (0.1, 0.2, 0.4, 0.7, 1.0)


def add_series(folder: Path) -> None:
    """Append [[reference]] tables of the sphere, one setting varied at a time, and the darks they need."""
    settings = CaptureSettings()
    response = next(r for r in unit_factors(settings, SIZE).responses() if r.band == BAND)
    field = np.full((SIZE, SIZE), response.signal(sphere_spectrum().values))
    # The same draws as the capture's own: these are the pixels of one camera.
    first = np.random.default_rng(np.random.SeedSequence(SEED).spawn(5)[0])
    maps = pixel_maps(perturbed_camera(SIZE, SEED), settings, first)
    longest = 0.6 * settings.full_scale_dn / float(field.max() * maps.flat.max())
    half = 0.3 * longest
    plan = [(t * longest, 8.0, 36.6, 1.0) for t in TIMES]
    plan += [(half, f, 36.6, 1.0) for f in F_NUMBERS]
    plan += [(half, 8.0, d, 1.0) for d in DISTANCES_MM]
    plan += [(half, 8.0, 36.6, level) for level in LEVELS]
    sphere = sphere_spectrum()
    columns = np.column_stack([sphere.wavelength_nm, *(level * sphere.values for level in LEVELS)])
    header = ",".join(["wavelength_nm", *(f"level{level:g}" for level in LEVELS)])
    np.savetxt(folder / "spectra" / "levels.csv", columns, "%.8g", ",", header=header, comments="")
    generator, text, darks = np.random.default_rng(SEED + 1), "", set()
    for number, (seconds, f_number, distance, level) in enumerate(plan):
        seconds = float(f"{seconds:.3g}")
        factor = level * (settings.f_number / f_number) ** 2 * (settings.image_distance_mm / distance) ** 2
        shots = [Shot("reference", BAND, seconds, 1)]
        if seconds not in darks:
            darks.add(seconds)
            shots.append(Shot("dark", None, seconds, 2))
        for path, counts in photograph(shots, lambda shot, f=factor: f * field, maps, settings, generator).items():
            name = path.replace("frames/", f"frames/series{number}-")
            write_raw(folder / name, counts)
            if "dark" not in name:
                text += (
                    f'\n[[reference]]\nband = "{BAND}"\nradiance = "spectra/levels.csv:level{level:g}"\n'
                    f"exposure_s = {seconds}\nf_number = {f_number}\nimage_distance_mm = {distance}\n"
                    f"frames = {json.dumps([name])}\n"
                )
        if len(shots) > 1:
            names = [p.replace("frames/", f"frames/series{number}-") for p in shots[1].paths]
            text += f"\n[[dark]]\nexposure_s = {seconds}\nframes = {json.dumps(names)}\n"
    manifest = folder / "capture.toml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + text, encoding="utf-8")


def simulated(folder: Path) -> Path:
    """A capture of the published box by a simulated PXL 1300L, with the sphere's series."""
    write_model_capture(folder, Model(), perturbed_camera(SIZE, SEED), CaptureSettings(), SEED, relative_error=3e-3)
    add_series(folder)
    return folder


def report(calibration: Calibration) -> None:
    """The paper's section 2.4 in numbers."""
    for series in calibration.sensor.responses:
        fit = series.fit
        print(
            f"{series.band} {series.source}: {fit.verdict}; slope {fit.slope:.5g} +- {fit.slope_sigma:.2g}, "
            f"chi2 {fit.chi2:.1f} for {fit.setting.size - 1}, p {fit.probability:.2f}"
        )
    scale = calibration.radiometry
    if scale.constant is not None:
        sigma = "" if scale.sigma is None else f" +- {scale.sigma:.2g}"
        print(f"C {scale.constant:.6g}{sigma}, nominal {scale.nominal:.6g} mm^2 m^2 DN/e-")
    transfer, curve = calibration.sensor.transfer, calibration.sensor.curve
    if transfer is not None:
        print(
            f"K {transfer.gain_dn_per_e:.5f} +- {transfer.gain_sigma:.2g} DN/e-, "
            f"sigma_d {transfer.dark_noise_e:.2f} +- {transfer.dark_noise_sigma:.2g} e-, "
            f"DSNU {transfer.dsnu_e:.2f} +- {transfer.dsnu_sigma:.2g} e-, "
            f"PRNU {100 * transfer.prnu:.2f} +- {100 * transfer.prnu_sigma:.2g} %"
        )
    if curve is not None:
        print(f"calibration curve: {curve.statistics}, straight line rms {curve.line_rms:.5f}")
    if calibration.colour is not None:
        print(calibration.colour.reason)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", nargs="?", type=Path)
    parser.add_argument("--out", type=Path, default=Path("reproduction-1997"))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.capture or simulated(Path(scratch) / "pxl1300l")
        calibration = calibrate_capture(load_capture(folder))
        written = write_calibration(calibration, arguments.out)
    report(calibration)
    print(f"Figures 1 to 4: response.png, 5 and 6: filters.png, in {arguments.out} ({len(written)} files)")


if __name__ == "__main__":
    main()
