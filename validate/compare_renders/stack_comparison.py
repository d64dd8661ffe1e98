"""Comparison of two image stacks, plane by plane.

For each plane, the relative difference (A - B) / B and, if at least one side states standard errors, the mean squared
residual. For two spectral cubes also the means over surfaces, edges, border and lamp, with standard deviations
(``regress``). If a cube states no standard error, noise is estimated in smooth parts, with a note.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import origin, replacing
from cboxlab.utils.numbers import json_value
from cboxlab.utils.table import Table
from numpy.typing import NDArray

from ..compare import write_map
from .cameras import LARGEST_SHIFT_PX, NOTED_SHIFT_PX, shift_px
from .regress import Common, PooledMean, as_percent, compared_areas, in_common_quantity
from .stacks import ImageStack, on_common_pixels, stack_of_side

__all__ = [
    "PlaneRow",
    "StackComparison",
    "WorstPixel",
    "compare_stacks",
    "comparison_record",
    "write_comparison",
]

#: Number of worst pixels listed: five, as many as a reader looks up.
WORST_PIXELS = 5
#: Names of planes repeated in a message.
_MAX_LISTED = 6


@dataclass(frozen=True)
class PlaneRow:
    """Comparison of one plane.

    The relative figures are ratios of sums and not means of ratios, which noise and dark pixels would rule.
    """

    #: Name of the plane.
    name: str
    #: Pixels known in both.
    pixels: int
    #: Mean of A, in the stack's unit.
    mean_first: float
    #: Mean of B, in the stack's unit.
    mean_second: float
    #: (mean of A - mean of B) / mean of B; NaN for a dark plane.
    relative_mean: float
    #: Rms of A - B over rms of B; NaN for a dark plane.
    relative_rms: float
    #: Mean of (A - B)^2 / (variance of A + variance of B); None where no variance is known.
    chi2_per_pixel: float | None


@dataclass(frozen=True)
class WorstPixel:
    """A pixel of large difference."""

    #: Name of the plane.
    plane: str
    #: Column, px.
    x: int
    #: Row, px.
    y: int
    #: Value of A.
    first: float
    #: Value of B.
    second: float
    #: Residual where a variance is known, otherwise (A - B) / B in percent.
    size: float


@dataclass(frozen=True, eq=False)
class StackComparison:
    """Outcome of ``compare_stacks``."""

    #: Common planes of A.
    first: ImageStack
    #: Common planes of B.
    second: ImageStack
    #: Comparison of each plane.
    rows: tuple[PlaneRow, ...]
    #: Pixels of largest difference, the largest first.
    worst: tuple[WorstPixel, ...]
    #: Name of the measure of ``worst``.
    worst_measure: str
    #: (plane, y, x) relative difference in single precision, NaN where B is 0 or either is unknown.
    relative: NDArray[np.float32]
    #: (plane, y, x) residual in single precision; None where no variance is known.
    residual_over_sigma: NDArray[np.float32] | None
    #: Expected chi-square per pixel of pictures that differ by noise alone.
    expected_chi2: float
    #: Remarks on the comparison.
    notes: tuple[str, ...]
    #: Means over the entire picture, surfaces and strata, of two cubes.
    means: tuple[PooledMean, ...] = ()

    def lines(self) -> list[str]:
        """Largest mean difference of a plane, or that all values agree; expected chi-square, notes.

        Returns
        -------
        list of str
            The sentences.
        """
        names = f"{self.first.source.name} against {self.second.source.name}"
        if np.array_equal(self.first.values, self.second.values, equal_nan=True):
            return [f"{names}: the same value in every pixel", *(f"• {note}" for note in self.notes)]
        bright = [row for row in self.rows if np.isfinite(row.relative_mean)]
        if bright:
            row = max(bright, key=lambda row: abs(row.relative_mean))
            size = as_percent(row.relative_mean, "B", unit=" %")
            lines = [f"{names}: largest mean difference of a plane, (A − B) / B: {size} ({row.name})"]
        else:
            lines = [f"{names}: no plane has light"]
        if self.residual_over_sigma is not None:
            lines.append(f"Noise alone gives a χ² per pixel of {self.expected_chi2:.2f}.")
        return [*lines, *(f"• {note}" for note in self.notes)]

    def tables(self) -> list[Table]:
        """Differences of planes, pooled means of cubes, worst pixels.

        Returns
        -------
        list of Table
            Only those with rows; a dash stands for a value that is not known.
        """
        planes = tuple(
            (
                row.name,
                f"{row.mean_first:.4g}",
                f"{row.mean_second:.4g}",
                _percent(row.relative_mean),
                _number(100 * row.relative_rms, ".3f"),
                str(row.pixels),
                _number(row.chi2_per_pixel, ".3f"),
            )
            for row in self.rows
        )
        means = tuple(
            (mean.name, _percent(mean.difference), f"{100 * mean.sigma:.3f}", str(mean.pixels)) for mean in self.means
        )
        worst = tuple(
            (p.plane, str(p.x), str(p.y), f"{p.first:.4g}", f"{p.second:.4g}", f"{p.size:+.4g}") for p in self.worst
        )
        pooled = "X, Y, Z" if {*self.first.names} <= {"X", "Y", "Z"} else "all wavelengths"
        tables = [
            Table(
                f"A is {self.first.source.name}, B is {self.second.source.name}, in {self.first.unit}",
                ("plane", "mean A", "mean B", "mean difference, %", "rms, %", "pixels", "χ²/pixel"),
                planes,
            ),
            Table(f"Means over {pooled}, (A − B) / B", ("part", "difference, %", "± %", "pixels"), means),
            Table("Worst pixels", ("plane", "x", "y", "A", "B", self.worst_measure), worst),
        ]
        return [table for table in tables if table.rows]


def _percent(difference: float) -> str:
    """(A - B) / B in per cent, or A as a part of B; a dash for NaN."""
    return "–" if difference != difference else as_percent(difference, "B")


def _number(value: float | None, form: str) -> str:
    """The formatted value; a dash for None and NaN."""
    return "–" if value is None or value != value else format(value, form)


@dataclass(frozen=True, eq=False)
class _Variance:
    """Variance of A - B by plane."""

    #: Variances of the stacks that state one.
    variances: tuple[NDArray[np.float64], ...]
    #: (plane, y, x) estimated variance, the least where a stack states none; None where there is no estimate.
    estimate: NDArray[np.float64] | None

    def of(self, plane: int) -> NDArray[np.float64]:
        """(y, x) variance of one plane."""
        variance = np.zeros(self.variances[0].shape[1:]) if self.estimate is None else np.zeros(self.estimate.shape[1:])
        for part in self.variances:
            variance = variance + part[plane]
        return variance if self.estimate is None else np.maximum(variance, self.estimate[plane])


def compare_stacks(first: ImageStack, second: ImageStack) -> StackComparison:
    """Compare A = ``first`` with the reference B = ``second``, over their common planes.

    Parameters
    ----------
    first, second
        The stacks.

    Returns
    -------
    StackComparison
        Figures of planes, worst pixels, maps, means, notes.

    Raises
    ------
    InputError
        If units or sizes differ, if their cameras show the same points more than a pixel apart, or if there is no
        common plane.
    """
    first, second, window_notes = on_common_pixels(first, second)
    first, second, side_notes, coarse = _same_quantity(first, second)
    _require_same_grid(first, second)
    view_notes = _view_notes(first, second)
    means, noise, common = _pooled(first, second)
    if common is not None:
        first, second = stack_of_side(first, common.candidate), stack_of_side(second, common.baseline)
    names = _common_planes(first, second)
    notes = [
        *window_notes,
        *view_notes,
        *side_notes,
        *(common.notes if common else ()),
        *_left_out(first, second, names),
    ]
    a, b = first.with_planes(names), second.with_planes(names)
    silent = [stack for stack in (first, second) if stack.variance is None]
    variance = None
    if len(silent) < 2 or (coarse and noise is not None):
        notes += _silent_notes(silent, noise is not None)
        variances = tuple(stack.variance for stack in (a, b) if stack.variance is not None)
        variance = _Variance(variances, noise if silent else None)
    rows, worst, relative, residual = _compared_planes(a, b, variance)
    measure = "difference, %" if residual is None else "residual / σ"
    expected = _expected_chi2(a, b)
    return StackComparison(a, b, rows, worst, measure, relative, residual, expected, tuple(notes), means)


def _same_quantity(first: ImageStack, second: ImageStack) -> tuple[ImageStack, ImageStack, list[str], bool]:
    """Both stacks in one quantity, notes of cubes, and whether either has coarse steps."""
    if first.side is None or second.side is None:
        return first, second, [*first.notes, *second.notes], False
    sides = in_common_quantity(first.side, second.side)
    first, second = (
        stack if side is stack.side else stack_of_side(stack, side)
        for stack, side in zip((first, second), sides, strict=True)
    )
    notes = [note for side in sides for note in side.notes if "standard error" not in note]
    return first, second, notes, any(side.rounding is not None for side in sides)


def _require_same_grid(first: ImageStack, second: ImageStack) -> None:
    """Raise InputError where units or sizes differ."""
    if first.unit != second.unit:
        raise InputError(second.source, f"values in {second.unit}", f"{first.unit}, like {first.source}")
    if first.values.shape[1:] != second.values.shape[1:]:
        size, other = (" x ".join(map(str, s.values.shape[:0:-1])) for s in (first, second))
        hint = "Is one turned by 90 degrees?" if first.values.shape[:0:-1] == second.values.shape[1:] else ""
        raise InputError(second.source, f"{other} px", f"{size} px, as in {first.source}", hint)


def _view_notes(first: ImageStack, second: ImageStack) -> list[str]:
    """Notes on cameras that differ; InputError where equal pixels do not show the same points."""
    instrument, other = first.instrument, second.instrument
    notes = instrument.differences(other)
    if instrument.camera is None or other.camera is None:
        return notes
    shift = shift_px(instrument.camera, other.camera)
    if shift > LARGEST_SHIFT_PX:
        raise InputError(
            second.source,
            f"a camera that sees the same points up to {shift:.1f} px elsewhere",
            f"the camera of {first.source}, within {LARGEST_SHIFT_PX:g} px",
        )
    if shift > NOTED_SHIFT_PX:
        notes.append(f"the cameras see the same points up to {shift:.2f} px apart, which shows at edges")
    return notes


def _pooled(
    first: ImageStack, second: ImageStack
) -> tuple[tuple[PooledMean, ...], NDArray[np.float64] | None, Common | None]:
    """Means of two cubes, (plane, y, x) variance, and both sides if one was interpolated."""
    if first.side is None or second.side is None:
        return (), None, None
    try:
        means, comparison = compared_areas(second.side, first.side)
    except InputError:  # no wavelength in common, or no light: the planes alone are compared
        return (), None, None
    noise = np.moveaxis(comparison.noise.variance, -1, 0)
    common = comparison.common if comparison.common.interpolation.any() else None
    planes = sum(name in second.names for name in first.names)
    return means, noise if common or len(noise) == planes else None, common


def _common_planes(first: ImageStack, second: ImageStack) -> list[str]:
    """Names of the common planes, in the order of the first; InputError without any."""
    names = [name for name in first.names if name in second.names]
    if not names:
        raise InputError(
            second.source,
            f"the planes {_listed(second.names)}",
            f"some of {_listed(first.names)}, as in {first.source}",
        )
    return names


def _left_out(first: ImageStack, second: ImageStack, names: Sequence[str]) -> list[str]:
    """Notes on planes that only one stack has."""
    return [
        f"only in {stack.source}: {_listed(missing)}"
        for stack in (first, second)
        if (missing := [name for name in stack.names if name not in names])
    ]


def _silent_notes(silent: Sequence[ImageStack], estimated: bool) -> list[str]:
    """Notes on stacks without standard errors."""
    treatment = "noise is estimated in smooth parts" if estimated else "it is assumed to be exact"
    return [f"{stack.source} states no standard error; {treatment}" for stack in silent]


def _compared_planes(
    a: ImageStack, b: ImageStack, variance: _Variance | None
) -> tuple[tuple[PlaneRow, ...], tuple[WorstPixel, ...], NDArray[np.float32], NDArray[np.float32] | None]:
    """Figures and maps of all planes, one at a time, so that temporaries are small."""
    relative = np.empty(a.values.shape, np.float32)
    residuals = None if variance is None else np.empty(a.values.shape, np.float32)
    rows, worst = [], list[tuple[float, int, WorstPixel]]()
    for plane, name in enumerate(a.names):
        first, second = np.ascontiguousarray(a.values[plane]), np.ascontiguousarray(b.values[plane])
        used = np.isfinite(first) & np.isfinite(second)
        difference = first - second
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(used & (second > 0), difference / second, np.nan)
        residual = None
        if variance is not None and residuals is not None:
            spread = variance.of(plane)
            with np.errstate(divide="ignore", invalid="ignore"):
                residual = np.where(used & (spread > 0), difference / np.sqrt(spread), np.nan)
            residuals[plane] = residual
        relative[plane] = ratio
        rows.append(_row(name, first, second, used, residual))
        worst += _worst(plane, name, first, second, 100 * ratio if residual is None else residual)
    worst.sort(key=lambda item: item[:2], reverse=True)
    return tuple(rows), tuple(pixel for *_, pixel in worst[:WORST_PIXELS]), relative, residuals


def _expected_chi2(a: ImageStack, b: ImageStack) -> float:
    """Mean of F with 1 and n degrees of freedom, n / (n - 2), for variances of few batches."""
    degrees = sum(stack.batches - 1 for stack in (a, b) if stack.batches > 1)
    return degrees / (degrees - 2) if degrees > 2 else 1.0


def _listed(names: Sequence[str]) -> str:
    """The first names, and the number of all where there are more."""
    more = f", ... ({len(names)} in all)" if len(names) > _MAX_LISTED else ""
    return ", ".join(names[:_MAX_LISTED]) + more


def _mean(values: NDArray[np.float64]) -> float:
    """Mean; NaN of nothing."""
    return float(values.mean()) if values.size else float("nan")


def _row(name: str, a: NDArray, b: NDArray, used: NDArray[np.bool_], residual: NDArray[np.float64] | None) -> PlaneRow:
    """Figures of one plane (y, x)."""
    pixels = used & (b > 0)
    bright = pixels.any()
    difference, reference = (a - b)[pixels], b[pixels]
    squares = None if residual is None else residual[np.isfinite(residual)] ** 2
    return PlaneRow(
        name,
        int(used.sum()),
        _mean(a[used]),
        _mean(b[used]),
        float(difference.sum() / reference.sum()) if bright else float("nan"),
        float(np.sqrt((difference**2).sum() / (reference**2).sum())) if bright else float("nan"),
        None if squares is None else _mean(squares),
    )


def _worst(
    plane: int, name: str, a: NDArray, b: NDArray, sizes: NDArray[np.float64]
) -> list[tuple[float, int, WorstPixel]]:
    """Magnitude, index in the stack and figures of a plane's worst pixels.

    Of pixels that are equally bad the last in the stack are taken.
    """
    magnitude = np.nan_to_num(np.abs(sizes), nan=0.0).ravel()
    count = min(WORST_PIXELS, magnitude.size)
    if not count:
        return []
    least = np.partition(magnitude, -count)[-count]
    candidates = np.flatnonzero((magnitude >= least) & (magnitude > 0))
    largest = candidates[np.argsort(magnitude[candidates], kind="stable")[::-1][:count]]
    pixels = []
    for flat in largest:
        y, x = (int(i) for i in np.unravel_index(flat, sizes.shape))
        pixel = WorstPixel(name, x, y, float(a[y, x]), float(b[y, x]), float(sizes[y, x]))
        pixels.append((float(magnitude[flat]), plane * magnitude.size + int(flat), pixel))
    return pixels


def write_comparison(folder: Path, comparison: StackComparison) -> list[Path]:
    """Write comparison.json and the maps of a comparison.

    The maps, as EXR, are difference, relative_difference and, where a variance is known, residual_over_sigma.

    Parameters
    ----------
    folder
        Existing folder.
    comparison
        The comparison.

    Returns
    -------
    list of Path
        The files written, comparison.json first.
    """
    a, b = comparison.first, comparison.second
    difference = np.stack([(p - q).astype(np.float32) for p, q in zip(a.values, b.values, strict=True)])
    maps: dict[str, tuple[NDArray[np.float32], str]] = {
        "difference": (difference, a.unit),
        "relative_difference": (comparison.relative, "1"),
    }
    if comparison.residual_over_sigma is not None:
        maps["residual_over_sigma"] = (comparison.residual_over_sigma, "1")
    attributes = origin(a=str(a.source), b=str(b.source))
    written = [folder / "comparison.json", *(folder / f"{name}.exr" for name in maps)]
    for name, (values, unit) in maps.items():
        array = xr.DataArray(values, dims=("channel", "y", "x"), coords={"channel": list(a.names)}, attrs=attributes)
        write_map(folder / f"{name}.exr", array, dict.fromkeys(a.names, unit))
    with replacing(written[0]) as temporary:
        temporary.write_text(json.dumps(comparison_record(comparison), indent=1) + "\n", encoding="utf-8")
    return written


def comparison_record(comparison: StackComparison) -> dict[str, Any]:
    """Content of comparison.json.

    Parameters
    ----------
    comparison
        The comparison.

    Returns
    -------
    dict
        All figures; None in place of NaN.
    """
    a, b = comparison.first, comparison.second
    return {
        "a": str(a.source),
        "b": str(b.source),
        "unit": a.unit,
        "planes": [json_value(asdict(row)) for row in comparison.rows],
        "expected_chi2_per_pixel": comparison.expected_chi2,
        "worst_pixels": [asdict(pixel) for pixel in comparison.worst],
        "worst_measure": comparison.worst_measure,
        "means": [json_value(asdict(row)) for row in comparison.means],
        "notes": list(comparison.notes),
    }
