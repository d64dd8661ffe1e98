"""Calibration curves of a linear and of a 12-to-8-bit camera, their residuals beside those of Vora et al. (2001).

    python benchmarks/static_nonlinearity.py

Simulated with the noise that the paper states: dark noise of 0.89 counts (DCS-200, whose dark level moreover
wanders with the exposure, Table II) and 0.476 counts (DCS-420). The DCS-420's table was not printed; a square
root of 12 bits stands in for it. Eight irradiance series at different exposures, each on a scale of its own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cboxlab.calibration.detector.nonlinearity import CalibrationCurve, LightSeries, fit_curve
from cboxlab.rendering.sensor.cameras import load_camera
from numpy.typing import NDArray

EXPOSURES_S = (1 / 125, 1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4, 1 / 2, 1.0)
POINTS = 14
#: Mean absolute, root mean square, largest; counts for the linear camera, fractions of full scale for the other.
PAPER = {"DCS-200": (1.13, 1.45, 4.67), "DCS-420": (0.0015, 0.0021, 0.0072)}


def series(
    camera: Callable[[NDArray[np.float64], float], NDArray[np.float64]], noise: float, seed: int
) -> list[LightSeries]:
    """Irradiance series, one per exposure, in units unknown to each other."""
    generator = np.random.default_rng(seed)
    found = []
    for seconds in EXPOSURES_S:
        light = np.geomspace(0.05, 1, POINTS) * generator.uniform(0.6, 1)
        count = camera(light, seconds) + noise * generator.standard_normal(POINTS)
        inside = (count > 20) & (count < 240)
        unit = generator.uniform(0.1, 10)
        found.append(LightSeries(f"{seconds:.4f} s", unit * light[inside], count[inside], np.full(inside.sum(), noise)))
    return found


def linear_camera(light: NDArray[np.float64], seconds: float) -> NDArray[np.float64]:
    """DCS-200: dark level of the exposure, straight response to 8 bits."""
    return load_camera("dcs200").detector.dark(seconds)[0] + 240 * light


def square_root_camera(light: NDArray[np.float64], seconds: float) -> NDArray[np.float64]:
    """DCS-420 stand-in: dark level 25.03, a square root from 12 bits to 8, rounded down."""
    twelve = np.floor(4095 * np.clip(light, 0, 1))
    return 25.03 + 229.97 * np.sqrt(twelve / 4095)


def row(name: str, curve: CalibrationCurve, in_counts: bool) -> str:
    found, key = curve.statistics, "_dn" if in_counts else ""
    ours = [found[f"{kind}{key}"] for kind in ("mean_absolute", "rms", "largest")]
    form = ".2f" if in_counts else ".4f"
    return "  ".join([f"{name:8}", *(f"{o:{form}} ({p:{form}})" for o, p in zip(ours, PAPER[name], strict=True))])


def main() -> None:
    print("residual: mean absolute, root mean square, largest; in brackets the paper's measured camera")
    linear = fit_curve(series(linear_camera, 0.89, 1), 13.62, knots=2)
    print(row("DCS-200", linear, True), " counts, straight line")
    curve = fit_curve(series(square_root_camera, 0.476, 2), 25.03)
    print(row("DCS-420", curve, False), f" of full scale; a straight line leaves {curve.line_rms:.3f} rms")


if __name__ == "__main__":
    main()
