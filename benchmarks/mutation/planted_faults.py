"""Do the tests find faults? Plants one at a time in a copy of the sources and runs the tests that should fail.

    python benchmarks/mutation/planted_faults.py                 # all of them
    python benchmarks/mutation/planted_faults.py optics-axis ddof  # some, by name

Prints a table: the fault, whether it was found, by which test. Exit code 1 if one escapes. Each entry below is
text of a source file that must occur there exactly once, so that a moved line is noticed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: Folder and package inside cboxlab.
ROOMS = {"scenes": "scenes", "calibration": "calibration", "render": "rendering", "validate": "validation"}
#: Copied next to the rooms: what the tests read.
READ_BY_TESTS = (
    "tests",
    "benchmarks",
    "docs",
    "pyproject.toml",
    "README.md",
    "CONTRIBUTING.md",
    "Makefile",
    "LICENSE",
)


@dataclass(frozen=True)
class Fault:
    """kind : in the field's words. text, planted : of the source file. tests : paths below ``tests``, in order."""

    name: str
    kind: str
    file: str
    text: str
    planted: str
    tests: tuple[str, ...]


FAULTS = (
    Fault(
        "distortion-sign",
        "sign of the radial distortion",
        "scenes/camera.py",
        "radial = 1.0 + self.k1",
        "radial = 1.0 - self.k1",
        ("scenes",),
    ),
    Fault(
        "wavelength-shift",
        "a spectrum read 2 nm aside",
        "scenes/spectra.py",
        "np.interp(wavelength, self.wavelength_nm",
        "np.interp(wavelength + 2.0, self.wavelength_nm",
        ("scenes",),
    ),
    Fault(
        "half-pixel",
        "half pixel: pixel (0, 0) at its corner",
        "render/visibility/tracer.py",
        "start_x = (column - 0.5 - centre_x) / f",
        "start_x = (column - centre_x) / f",
        ("render/integrators", "render/radiosity"),
    ),
    Fault(
        "lamp-cosine",
        "cosine at the lamp left out of its sampled light",
        "render/radiosity/lamp.py",
        "weight = dr.select(facing, cosine * lamp_cosine *",
        "weight = dr.select(facing, cosine *",
        ("render/radiosity", "render/integrators"),
    ),
    Fault(
        "exchange-transposed",
        "form factors transposed",
        "render/radiosity/solution.py",
        "return rho * (exchange.form_factors @ light.astype(np.float32))",
        "return rho * (exchange.form_factors.T @ light.astype(np.float32))",
        ("render/radiosity",),
    ),
    Fault(
        "fresnel",
        "Fresnel's reflectance of one polarisation",
        "render/perturbation/coat.py",
        "return 0.5 * a * (1 + b)",
        "return a",
        ("render/perturbation", "render/effects"),
    ),
    Fault(
        "survival",
        "Russian roulette without its weight",
        "render/integrators/path_tracer.py",
        "            weight * raised,\n",
        "            weight,\n",
        ("render/integrators", "render/radiosity"),
    ),
    Fault(
        "read-noise-gain",
        "read noise in electrons taken for DN",
        "render/sensor/detector.py",
        "electrons += np.asarray(dark_sigma_dn) *",
        "electrons += np.asarray(dark_sigma_dn) / detector.gain_e_per_dn *",
        ("render/sensor",),
    ),
    Fault(
        "f-number",
        "light by the inverse f-number, not its square",
        "render/sensor/detector.py",
        "factor = (self.f_number / f_number) ** 2",
        "factor = self.f_number / f_number",
        ("render/sensor",),
    ),
    Fault(
        "optics-axis",
        "rows and columns of the field height",
        "render/sensor/optics.py",
        "v = np.arange(rows.start, rows.stop)[:, None] - y",
        "v = np.arange(rows.start, rows.stop)[:, None] - x",
        ("render/sensor",),
    ),
    Fault(
        "ddof",
        "degrees of freedom of a pixel's repeats",
        "calibration/correction/noise_line.py",
        "counts.var(axis=0, ddof=1)[good]",
        "counts.var(axis=0)[good]",
        ("calibration/correction", "calibration/result/test_calibrate.py"),
    ),
    Fault(
        "flat-dark",
        "the bias for the flat's own dark frame",
        "calibration/correction/correction.py",
        "above_dark = stack.mean(axis=0) - dark.at(table.exposure_s)",
        "above_dark = stack.mean(axis=0) - dark.bias",
        ("calibration/correction", "calibration/result/test_calibrate.py"),
    ),
    Fault(
        "flat-exposure",
        "the dark of the band's exposure for the flat's",
        "calibration/correction/correction.py",
        "above_dark = stack.mean(axis=0) - dark.at(table.exposure_s)",
        "above_dark = stack.mean(axis=0) - dark.at(capture.band(band).exposure_s)",
        ("calibration/correction",),
    ),
    Fault(
        "fall-off",
        "fall-off left in the photo-response non-uniformity",
        "calibration/detector/photon_transfer.py",
        "weight = float(mean[good].mean()) / np.maximum(smooth, 1.0)",
        "weight = np.ones(mean.shape)",
        ("calibration/detector",),
    ),
    Fault(
        "gain-sigma",
        "the gain's sigma without the dark's share",
        "calibration/detector/photon_transfer.py",
        "np.sqrt(1 / np.sum(weight * x**2) + (common * dark.temporal_sigma) ** 2)",
        "np.sqrt(1 / np.sum(weight * x**2))",
        ("calibration/detector",),
    ),
    Fault(
        "dark-fit-freedom",
        "divisor of the dark fit's excess scatter",
        "calibration/detector/dark_fit.py",
        "freedom if beyond else 0.0",
        "time.size if beyond else 0.0",
        ("calibration/detector",),
    ),
    Fault(
        "dark-rate-noise",
        "noise of a dark rate without its lever",
        "calibration/correction/dark.py",
        "noise = frame_variance / length",
        "noise = frame_variance / repeats.sum()",
        ("calibration/correction", "calibration/result/test_calibrate.py"),
    ),
    Fault(
        "quanta",
        "energy for quanta in the sensor equation",
        "calibration/instrument/band_response.py",
        "return np.asarray(wavelength_nm, float) * 1e-9",
        "return 0 * np.asarray(wavelength_nm, float) + 555e-9",
        ("calibration/radiometry",),
    ),
    Fault(
        "common-error",
        "sign of what all bands have in common",
        "calibration/radiometry/uncertainty.py",
        "+ share @ share *",
        "- share @ share *",
        ("calibration/radiometry",),
    ),
    Fault(
        "rounding",
        "the variance of rounding left in the read noise",
        "calibration/detector/photon_transfer.py",
        "read = dark.temporal - ROUNDING_VARIANCE",
        "read = dark.temporal",
        ("calibration/detector",),
    ),
    Fault(
        "colour-variance",
        "XYZ variances by the weights, not their squares",
        "calibration/colour/colorimetry.py",
        "np.tensordot(matrix**2, variance, 1)",
        "np.tensordot(np.abs(matrix), variance, 1)",
        ("calibration/colour",),
    ),
    Fault(
        "turn-unit",
        "radians for degrees in the camera's derivative",
        "calibration/geometry/camera_jacobian.py",
        "@ _left_jacobian(np.radians(values[3:6])) * np.radians(1.0)",
        "@ _left_jacobian(np.radians(values[3:6]))",
        ("calibration/geometry",),
    ),
    Fault(
        "fit-freedom",
        "degrees of freedom of the camera's fit",
        "calibration/geometry/camera_fit.py",
        "freedom = 2 * int(in_use.sum()) - model.count",
        "freedom = 2 * int(in_use.sum())",
        ("calibration/geometry",),
    ),
    Fault(
        "lamp-prior",
        "the prior of the lamp's power left out of the estimate",
        "validate/compare/nuisances.py",
        "(float(weight @ measured[used]) + prior) / information",
        "float(weight @ measured[used]) / information",
        ("validate/compare",),
    ),
    Fault(
        "chi2-freedom",
        "fitted parameters not taken off the degrees of freedom",
        "validate/compare/comparison.py",
        "values.size * self.freedom",
        "values.size",
        ("validate/compare/test_compare.py", "validate/compare"),
    ),
    Fault(
        "prior-row",
        "sign of the priors' rows of the linear model",
        "validate/diagnose/linear_model/model.py",
        "residual[count:] = priors @",
        "residual[count:] = -priors @",
        ("validate/diagnose/test_linear_model.py", "validate/diagnose"),
    ),
    Fault(
        "heldout-split",
        "held-out pixels that take part in the fit",
        "validate/diagnose/alternatives.py",
        "heldout_gain += _gain(residual[outside], predicted[outside], amplitude)",
        "heldout_gain += _gain(residual[inside], predicted[inside], amplitude)",
        ("validate/diagnose/test_heldout.py", "validate/diagnose"),
    ),
    Fault(
        "shift-sign",
        "pass bands that move to longer wavelengths",
        "render/effects/filter_shift.py",
        "wavelength_at_normal_nm = grid / np.sqrt",
        "wavelength_at_normal_nm = grid * np.sqrt",
        ("render/effects",),
    ),
    Fault(
        "haze-distance",
        "inverse distance for inverse square between cells of air",
        "render/perturbation/haze.py",
        "(4 * np.pi * away**2)",
        "(4 * np.pi * away)",
        ("render/effects", "render/perturbation"),
    ),
    Fault(
        "frame-times",
        "a band's time without its repeats",
        "validate/predict/sensing.py",
        "start + (len(band.frames) - 1) / 2 * period",
        "start",
        ("validate/predict",),
    ),
)


def plant(fault: Fault, tree: Path) -> None:
    """Change one text of one file of the copy. Raises ValueError where it is not there exactly once."""
    path = tree / fault.file
    source = path.read_text(encoding="utf-8")
    if source.count(fault.text) != 1:
        raise ValueError(f"{fault.name}: {fault.file} holds {source.count(fault.text)} times: {fault.text}")
    path.write_text(source.replace(fault.text, fault.planted), encoding="utf-8")


def copy_tree(folder: Path) -> None:
    """The sources as a package tree: the rooms, links to them in ``tree/cboxlab``, and what the tests read."""
    (folder / "tree" / "cboxlab").mkdir(parents=True)
    if (ROOT.parent / "shared").is_dir():
        (folder.parent / "shared").symlink_to(ROOT.parent / "shared")
    ignore = shutil.ignore_patterns("__pycache__")
    for name in (*ROOMS, "cboxlab", *READ_BY_TESTS):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=ignore)
        elif source.exists():
            shutil.copy2(source, folder / name)
    links = {package: folder / room for room, package in ROOMS.items()}
    links |= {path.name: path for path in (folder / "cboxlab").glob("*")}
    for name, path in links.items():
        (folder / "tree" / "cboxlab" / name).symlink_to(path)


def run_tests(folder: Path, paths: Sequence[str], limit_s: float | None = None) -> str | None:
    """The first test of the copy that fails; None if all pass.

    Raises RuntimeError where pytest could not run, subprocess.TimeoutExpired after the limit.
    """
    # without a safe path Python would look into the current folder first, whose cboxlab has no rooms
    settings = {**os.environ, "PYTHONPATH": str(folder / "tree"), "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-n", "0", "-rfE", *paths]
    result = subprocess.run(
        command, cwd=folder, env=settings, capture_output=True, text=True, check=False, timeout=limit_s
    )
    if result.returncode == 0:
        return None
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", result.stdout, re.MULTILINE)
    if failed is None and result.returncode != 1:
        raise RuntimeError(f"pytest {' '.join(paths)}: {result.stdout[-2000:]}{result.stderr[-2000:]}")
    return failed.group(1) if failed else "(a failure without a name)"


def first_failure(folder: Path, tests: tuple[str, ...]) -> str | None:
    """The first test that fails; None if all pass. Raises RuntimeError where pytest could not run."""
    for path in tests:
        failure = run_tests(folder, [f"tests/{path}"])
        if failure is not None:
            return failure
    return None


def main(names: list[str]) -> int:
    unknown = set(names) - {fault.name for fault in FAULTS}
    if unknown:
        print(f"no such fault: {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    faults = [fault for fault in FAULTS if not names or fault.name in names]
    escaped = 0
    for number, fault in enumerate(faults, 1):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / ROOT.name
            copy_tree(folder)
            plant(fault, folder)
            failure = first_failure(folder, fault.tests)
        escaped += failure is None
        verdict = "ESCAPED" if failure is None else "found by " + failure
        print(f"{number:2d}  {fault.name:20s} {fault.kind:58s} {verdict}", flush=True)
    print(f"{len(faults) - escaped} of {len(faults)} found")
    return 1 if escaped else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
