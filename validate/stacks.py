"""Two pictures of several planes against each other: spectral cubes, maps, or the band images of captures.

Plane by plane the relative difference (A - B) / B and, where a side states standard errors, the mean of
squared residuals over their variance. A side that states none is then taken as exact, and a note says so.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.calibrate import calibrate
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.sensor_equation import optical_factor
from cboxlab.render.cube_files import READABLE, read_cube
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.files import replacing
from numpy.typing import NDArray

from .maps import read_map, write_map

__all__ = [
    "PlaneRow",
    "Stack",
    "StackComparison",
    "WorstPixel",
    "compare_stacks",
    "read_stack",
    "write_comparison",
]

#: Pixels listed as the worst.
WORST_PIXELS = 5


@dataclass(frozen=True, eq=False)
class Stack:
    """Planes of one picture. values : (plane, y, x), NaN where unknown. variance : the same shape, or None.

    batches : independent batches whose scatter gave the variance; 0 where it is known better than that.
    """

    source: Path
    names: tuple[str, ...]
    values: NDArray[np.float64]
    variance: NDArray[np.float64] | None
    unit: str
    batches: int = 0

    def chosen(self, names: Sequence[str]) -> Stack:
        """The planes of these names, in their order."""
        index = [self.names.index(name) for name in names]
        variance = None if self.variance is None else self.variance[index]
        return Stack(self.source, tuple(names), self.values[index], variance, self.unit, self.batches)


@dataclass(frozen=True)
class PlaneRow:
    """One plane. relative_mean, relative_rms : of (A - B) / B over pixels where B is above 0, else NaN.

    chi2_per_pixel : mean of (A - B)^2 / (variance of A + variance of B); None where no variance is known.
    """

    name: str
    pixels: int
    mean_first: float
    mean_second: float
    relative_mean: float
    relative_rms: float
    chi2_per_pixel: float | None


@dataclass(frozen=True)
class WorstPixel:
    """size : the residual over its standard deviation where known, otherwise (A - B) / B in percent."""

    plane: str
    x: int
    y: int
    first: float
    second: float
    size: float


@dataclass(frozen=True, eq=False)
class StackComparison:
    """Outcome of ``compare_stacks``.

    first, second : the planes in common. relative : (plane, y, x), NaN where left out. residual_over_sigma :
    the same shape, None where no variance is known. expected_chi2 : per pixel, if A and B differ by noise
    alone.
    """

    first: Stack
    second: Stack
    rows: tuple[PlaneRow, ...]
    worst: tuple[WorstPixel, ...]
    worst_measure: str
    relative: NDArray[np.float64]
    residual_over_sigma: NDArray[np.float64] | None
    expected_chi2: float
    notes: tuple[str, ...]


def read_stack(path: Path) -> Stack:
    """A cube, a map or a capture. Raises InputError for anything else and for what cannot be read."""
    if path.is_dir():
        return _capture_stack(path)
    if not path.exists():
        raise InputError(path, "no such file or folder", f"a capture folder, or a file {', '.join(READABLE)}")
    if path.suffix.lower() == ".exr":
        channels, units = read_map(path)
        names = tuple(str(name) for name in channels["channel"].values)
        if not any(name.startswith("S0.") for name in names):
            unit = ", ".join(sorted(set(units.values()))) or "the file's own unit"
            return Stack(path, names, channels.values.astype(np.float64), None, unit)
    return _cube_stack(path, read_cube(path))


def _cube_stack(path: Path, cube: xr.Dataset) -> Stack:
    order = "wavelength", "y", "x"
    variance, batches = None, 0
    if "standard_error" in cube:
        variance = cube["standard_error"].transpose(*order).values.astype(np.float64) ** 2
        batches = int(cube["standard_error"].attrs.get("batches", 0))
    names = tuple(f"{w:.10g} nm" for w in cube["wavelength"].values)
    values = cube["radiance"].transpose(*order).values.astype(np.float64)
    return Stack(path, names, values, variance, "W m^-2 sr^-1 nm^-1", batches)


def _capture_stack(folder: Path) -> Stack:
    """Corrected signals over exposure / (f_number^2 image_distance^2): exposures need not be alike."""
    calibration = calibrate(load_capture(folder))
    capture, images = calibration.capture, calibration.images
    factors = [optical_factor(capture, band) for band in capture.manifest.band]
    known = all(factor is not None for factor in factors)
    seconds = [band.exposure_s for band in capture.manifest.band]
    divisor = np.array(factors if known else seconds, float)[:, None, None]
    used = images["mask"].values == 0
    values = np.where(used, images["signal"].values, np.nan) / divisor
    return Stack(
        folder,
        capture.band_ids,
        values,
        images["variance"].values / divisor**2,
        "DN s^-1 mm^2" if known else "DN s^-1",
    )


def compare_stacks(first: Stack, second: Stack) -> StackComparison:
    """A = ``first`` against the reference B = ``second``, over the planes that both have.

    Raises InputError where nothing can be compared: other units, other sizes, no plane in common.
    """
    if first.unit != second.unit:
        raise InputError(second.source, f"values in {second.unit}", f"{first.unit}, as in {first.source}")
    if first.values.shape[1:] != second.values.shape[1:]:
        size, other = (" x ".join(map(str, s.values.shape[:0:-1])) for s in (first, second))
        raise InputError(second.source, f"{other} px", f"{size} px, as in {first.source}")
    names = [name for name in first.names if name in second.names]
    if not names:
        raise InputError(
            second.source,
            f"the planes {_listed(second.names)}",
            f"some of {_listed(first.names)}, as in {first.source}",
        )
    notes = [
        f"only in {stack.source}: {_listed(left)}"
        for stack in (first, second)
        if (left := [name for name in stack.names if name not in names])
    ]
    a, b = first.chosen(names), second.chosen(names)
    used = np.isfinite(a.values) & np.isfinite(b.values)
    difference = a.values - b.values
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(used & (b.values > 0), difference / b.values, np.nan)
    residual = None
    if a.variance is not None or b.variance is not None:
        variance = sum((v for v in (a.variance, b.variance) if v is not None), np.zeros(difference.shape))
        with np.errstate(divide="ignore", invalid="ignore"):
            residual = np.where(used & (variance > 0), difference / np.sqrt(variance), np.nan)
        if a.variance is None or b.variance is None:
            exact = first if a.variance is None else second
            notes.append(f"{exact.source} states no standard error and is taken as exact")
    rows = tuple(_row(i, a, b, used[i], relative[i], residual) for i in range(len(names)))
    sizes = 100 * relative if residual is None else residual
    measure = "difference, %" if residual is None else "residual / σ"
    return StackComparison(
        a, b, rows, _worst(a, b, sizes), measure, relative, residual, _expected_chi2(a, b), tuple(notes)
    )


def _expected_chi2(a: Stack, b: Stack) -> float:
    """The mean of F with 1 and n degrees of freedom, n / (n - 2), for variances from few batches (Welch)."""
    degrees = sum(stack.batches - 1 for stack in (a, b) if stack.batches > 1)
    return degrees / (degrees - 2) if degrees > 2 else 1.0


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (f", ... ({len(names)} in all)" if len(names) > 6 else "")


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _row(
    index: int, a: Stack, b: Stack, used: NDArray[np.bool_], relative: NDArray[np.float64],
    residual: NDArray[np.float64] | None,
) -> PlaneRow:  # fmt: skip
    ratio = relative[np.isfinite(relative)]
    squares = None if residual is None else residual[index][np.isfinite(residual[index])] ** 2
    return PlaneRow(
        a.names[index],
        int(used.sum()),
        _mean(a.values[index][used]),
        _mean(b.values[index][used]),
        _mean(ratio),
        float(np.sqrt(_mean(ratio**2))),
        None if squares is None else _mean(squares),
    )


def _worst(a: Stack, b: Stack, sizes: NDArray[np.float64]) -> tuple[WorstPixel, ...]:
    magnitude = np.nan_to_num(np.abs(sizes), nan=0.0)
    found = []
    for flat in np.argsort(magnitude, axis=None)[::-1][:WORST_PIXELS]:
        plane, y, x = (int(i) for i in np.unravel_index(flat, sizes.shape))
        if magnitude[plane, y, x] == 0:
            break
        found.append(
            WorstPixel(
                a.names[plane], x, y, float(a.values[plane, y, x]), float(b.values[plane, y, x]),
                float(sizes[plane, y, x]),
            )
        )  # fmt: skip
    return tuple(found)


def write_comparison(folder: Path, comparison: StackComparison) -> None:
    """Write comparison.json, and as EXR difference, relative_difference, residual_over_sigma where known."""
    a, b = comparison.first, comparison.second
    maps: dict[str, tuple[NDArray[np.float64], str]] = {
        "difference": (a.values - b.values, a.unit), "relative_difference": (comparison.relative, "1"),
    }  # fmt: skip
    if comparison.residual_over_sigma is not None:
        maps["residual_over_sigma"] = (comparison.residual_over_sigma, "1")
    for name, (values, unit) in maps.items():
        array = xr.DataArray(values, dims=("channel", "y", "x"), coords={"channel": list(a.names)})
        write_map(folder / f"{name}.exr", array, dict.fromkeys(a.names, unit))
    record = {
        "a": str(a.source),
        "b": str(b.source),
        "unit": a.unit,
        "planes": [_finite(asdict(row)) for row in comparison.rows],
        "expected_chi2_per_pixel": comparison.expected_chi2,
        "worst_pixels": [asdict(pixel) for pixel in comparison.worst],
        "worst_measure": comparison.worst_measure,
        "notes": list(comparison.notes),
    }
    with replacing(folder / "comparison.json") as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def _finite(record: dict) -> dict:
    """JSON has no NaN: what is not known becomes null."""
    return {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in record.items()}
