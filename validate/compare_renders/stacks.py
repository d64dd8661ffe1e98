"""Comparison of two pictures with several planes: spectral cubes, maps, or the band images of captures.

For each plane, the relative difference (A - B) / B and, if at least one side states standard errors, the mean squared
residual over its variance. For two spectral cubes also the means over surfaces, edges, border and lamp, with standard
deviations (``regress``). If a cube states no standard error, noise is estimated in smooth parts, with a note.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.radiometry import optical_factor
from cboxlab.calibration.result import calibrate
from cboxlab.rendering.files import (
    AS_STATED,
    RADIANCE_UNIT,
    READABLE,
    Declared,
    Window,
    camera_of_attribute,
    common_pixels,
    read_picture,
    window_in_file,
    window_of,
)
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import origin, replacing
from numpy.typing import NDArray

from ..compare import read_map, write_map
from .cameras import LARGEST_SHIFT_PX, NOTED_SHIFT_PX, Instrument, instrument_of, shift_px
from .regress import (
    Common,
    PooledMean,
    Side,
    cut_camera,
    cut_side,
    in_common_quantity,
    regress_sides,
    side_of,
)

__all__ = [
    "PlaneRow",
    "Stack",
    "StackComparison",
    "WorstPixel",
    "compare_stacks",
    "comparison_record",
    "read_stack",
    "write_comparison",
]

#: Number of worst pixels listed.
WORST_PIXELS = 5


@dataclass(frozen=True, eq=False)
class Stack:
    """Planes of one picture. values : (plane, y, x), NaN where unknown. variance : the same shape, or None.

    batches : number of batches from whose scatter the variance was estimated; 0 if it is known otherwise.
    side : the same cube as ``regress`` takes it; None for other pictures. instrument : what it was taken with.
    """

    source: Path
    names: tuple[str, ...]
    values: NDArray[np.float64]
    variance: NDArray[np.float64] | None
    unit: str
    batches: int = 0
    side: Side | None = None
    instrument: Instrument = field(default_factory=lambda: Instrument(None, {}))
    #: Place of the pixels in a larger picture; None for a complete picture.
    window: Window | None = None

    @property
    def pixels(self) -> Window:
        """The window, that of a complete picture included."""
        height, width = self.values.shape[1:]
        return self.window or Window(0, 0, width, height, (0, 0, width, height))

    @property
    def declared(self) -> tuple[str, ...]:
        """What was declared in place of the file."""
        return () if self.side is None else self.side.declared

    @property
    def stated(self) -> Mapping[str, str]:
        """What the file states in place of what was declared."""
        return {} if self.side is None else self.side.stated

    def chosen(self, names: Sequence[str]) -> Stack:
        """The planes with these names, in this order."""
        index = [self.names.index(name) for name in names]
        variance = None if self.variance is None else self.variance[index]
        return replace(self, names=tuple(names), values=self.values[index], variance=variance, side=None)


@dataclass(frozen=True)
class PlaneRow:
    """One plane. relative_mean : (mean of A - mean of B) / mean of B. relative_rms : rms of A - B over rms of B.

    Both are ratios of sums and not means of ratios, which noise and dark pixels would dominate; NaN for a dark plane.

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
    """size : the residual over its standard deviation if known, otherwise (A - B) / B in percent."""

    plane: str
    x: int
    y: int
    first: float
    second: float
    size: float


@dataclass(frozen=True, eq=False)
class StackComparison:
    """Outcome of ``compare_stacks``.

    first, second : the common planes. relative : (plane, y, x), NaN where left out. residual_over_sigma : the same
    shape, None if no variance is known. expected_chi2 : per pixel, if A and B differ only by noise.
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
    means: tuple[PooledMean, ...] = ()


def read_stack(path: Path, declared: Declared = AS_STATED) -> Stack:
    """The planes of a cube, a picture in colour, a map or a capture. declared : what the file does not state.

    Channels of an EXR file that is no spectral cube are compared as they are, unless anything is declared. Raises
    InputError for anything else and for unreadable files.
    """
    if path.is_dir():
        return _capture_stack(path)
    if not path.exists():
        raise InputError(path, "no such file or folder", f"a capture folder, or a file {', '.join(READABLE)}")
    if path.suffix.lower() == ".exr" and declared == AS_STATED:
        channels, units = read_map(path)
        names = tuple(str(name) for name in channels["channel"].values)
        if not any(name.startswith("S0.") for name in names):
            unit = ", ".join(sorted(set(units.values()))) or "the file's own unit"
            values = channels.values.astype(np.float64)
            return Stack(path, names, values, None, unit, window=window_in_file(path))
    picture = read_picture(path, declared)
    if "xyz" in picture:
        side = side_of([picture], [str(path)])
        return _of_side(Stack(path, (), np.zeros(0), None, "", window=side.window), side)
    return _cube_stack(path, picture)


def _cube_stack(path: Path, cube: xr.Dataset) -> Stack:
    order = "wavelength", "y", "x"
    variance, batches = None, 0
    if "standard_error" in cube:
        variance = cube["standard_error"].transpose(*order).values.astype(np.float64) ** 2
        batches = int(cube["standard_error"].attrs.get("batches", 0))
    names = tuple(f"{w:.10g} nm" for w in cube["wavelength"].values)
    values = cube["radiance"].transpose(*order).values.astype(np.float64)
    side = side_of([cube], [str(path)]) if np.isfinite(values).all() else None
    instrument = Instrument(camera_of_attribute(cube.attrs.get("camera")), {})
    return Stack(path, names, values, variance, RADIANCE_UNIT, batches, side, instrument, window_of(cube))


def _capture_stack(folder: Path) -> Stack:
    """Corrected signals divided by exposure / (f_number^2 image_distance^2), so that exposures may differ."""
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
        instrument=instrument_of(capture, calibration.camera),
    )


def compare_stacks(first: Stack, second: Stack) -> StackComparison:
    """Compare A = ``first`` with the reference B = ``second``, over their common planes.

    Raises InputError if units or sizes differ, if their cameras saw the same points more than a pixel apart, or if
    there is no common plane.
    """
    first, second, cut = _on_common_pixels(first, second)
    sides: tuple[Side, ...] = ()
    if first.side is not None and second.side is not None:
        sides = in_common_quantity(first.side, second.side)
        first, second = (
            stack if own is stack.side else _of_side(stack, own)
            for stack, own in zip((first, second), sides, strict=True)
        )
    if first.unit != second.unit:
        raise InputError(second.source, f"values in {second.unit}", f"{first.unit}, like {first.source}")
    if first.values.shape[1:] != second.values.shape[1:]:
        size, other = (" x ".join(map(str, s.values.shape[:0:-1])) for s in (first, second))
        raise InputError(second.source, f"{other} px", f"{size} px, as in {first.source}")
    seen = _same_view(first, second)
    means, noise, told = _pooled(first, second)
    if told is not None:
        first, second = _of_side(first, told.candidate), _of_side(second, told.baseline)
    names = [name for name in first.names if name in second.names]
    if not names:
        raise InputError(
            second.source,
            f"the planes {_listed(second.names)}",
            f"some of {_listed(first.names)}, as in {first.source}",
        )
    notes = (
        cut
        + seen
        + [note for side in sides for note in side.notes if "standard error" not in note]
        + list(told.notes if told else ())
        + [
            f"only in {stack.source}: {_listed(left)}"
            for stack in (first, second)
            if (left := [name for name in stack.names if name not in names])
        ]
    )
    a, b = first.chosen(names), second.chosen(names)
    used = np.isfinite(a.values) & np.isfinite(b.values)
    difference = a.values - b.values
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(used & (b.values > 0), difference / b.values, np.nan)
    residual = None
    coarse = noise is not None and any(side.rounding is not None for side in sides)
    if a.variance is not None or b.variance is not None or coarse:
        variance = sum((v for v in (a.variance, b.variance) if v is not None), np.zeros(difference.shape))
        for silent in (stack for stack in (first, second) if stack.variance is None):
            if noise is None:
                notes.append(f"{silent.source} states no standard error; it is assumed to be exact")
            else:
                notes.append(f"{silent.source} states no standard error; noise is estimated in smooth parts")
                variance = np.maximum(variance, noise)
        with np.errstate(divide="ignore", invalid="ignore"):
            residual = np.where(used & (variance > 0), difference / np.sqrt(variance), np.nan)
    rows = tuple(_row(i, a, b, used[i], residual) for i in range(len(names)))
    sizes = 100 * relative if residual is None else residual
    measure = "difference, %" if residual is None else "residual / σ"
    return StackComparison(
        a,
        b,
        rows,
        _worst(a, b, sizes),
        measure,
        relative,
        residual,
        _expected_chi2(a, b),
        tuple(notes),
        means,
    )


def _on_common_pixels(first: Stack, second: Stack) -> tuple[Stack, Stack, list[str]]:
    """Both cut to the pixels that both have, with a note; the same where both are complete.

    Raises InputError where they have no pixel in common, or belong to pictures of different sizes.
    """
    part = common_pixels(first.pixels, second.pixels, (str(first.source), str(second.source)))
    if part is None:
        return first, second, []
    note = f"compared in the {part.width} x {part.height} pixels that both have: {part}; x and y count from the first"
    return _cut(first, part), _cut(second, part), [note]


def _cut(stack: Stack, part: Window) -> Stack:
    """Planes of some pixels."""
    rows, columns = stack.pixels.slices(part)
    camera = stack.instrument.camera
    if camera is not None and (camera.height_px, camera.width_px) == stack.values.shape[1:]:
        camera = cut_camera(camera, stack.pixels, part)
    return replace(
        stack,
        values=stack.values[:, rows, columns],
        variance=None if stack.variance is None else stack.variance[:, rows, columns],
        side=None if stack.side is None else cut_side(stack.side, part),
        instrument=replace(stack.instrument, camera=camera),
        window=part,
    )


def _same_view(first: Stack, second: Stack) -> list[str]:
    """Notes on cameras that differ. Raises InputError where equal pixels do not show the same points."""
    one, other = first.instrument, second.instrument
    notes = one.differences(other)
    if one.camera is None or other.camera is None:
        return notes
    shift = shift_px(one.camera, other.camera)
    if shift > LARGEST_SHIFT_PX:
        raise InputError(
            second.source,
            f"a camera that sees the same points up to {shift:.1f} px elsewhere",
            f"the camera of {first.source}, within {LARGEST_SHIFT_PX:g} px",
        )
    if shift > NOTED_SHIFT_PX:
        notes.append(f"the cameras see the same points up to {shift:.2f} px apart, which shows at edges")
    return notes


def _pooled(first: Stack, second: Stack) -> tuple[tuple[PooledMean, ...], NDArray[np.float64] | None, Common | None]:
    """For two cubes: means, variance of the difference (plane, y, x), both sides if interpolated."""
    if first.side is None or second.side is None:
        return (), None, None
    try:
        outcome, found = regress_sides(second.side, first.side)
    except InputError:  # no wavelength in common, or no light: the planes alone are compared
        return (), None, None
    kept = tuple(row for row in outcome.pools if row.kind in ("whole", "surface", "stratum"))
    noise = np.moveaxis(found.noise.variance, -1, 0)
    common = found.common if found.common.interpolation.any() else None
    planes = sum(name in second.names for name in first.names)
    return kept, noise if common or len(noise) == planes else None, common


def _of_side(stack: Stack, side: Side) -> Stack:
    names = side.bands if side.in_colour else tuple(f"{name} nm" for name in side.bands)
    variance = None if side.variance is None else np.moveaxis(side.variance, -1, 0)
    values, unit = np.moveaxis(side.radiance, -1, 0), "cd m^-2" if side.in_colour else RADIANCE_UNIT
    return replace(stack, names=names, values=values, variance=variance, unit=unit, side=side)


def _expected_chi2(a: Stack, b: Stack) -> float:
    """Mean of F with 1 and n degrees of freedom, n / (n - 2), for variances from few batches (Welch)."""
    degrees = sum(stack.batches - 1 for stack in (a, b) if stack.batches > 1)
    return degrees / (degrees - 2) if degrees > 2 else 1.0


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (f", ... ({len(names)} in all)" if len(names) > 6 else "")


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _row(index: int, a: Stack, b: Stack, used: NDArray[np.bool_], residual: NDArray[np.float64] | None) -> PlaneRow:
    pixels, reference = used & (b.values[index] > 0), b.values[index]
    bright = pixels.any()
    difference = (a.values[index] - reference)[pixels]
    squares = None if residual is None else residual[index][np.isfinite(residual[index])] ** 2
    return PlaneRow(
        a.names[index],
        int(used.sum()),
        _mean(a.values[index][used]),
        _mean(b.values[index][used]),
        float(difference.sum() / reference[pixels].sum()) if bright else float("nan"),
        float(np.sqrt((difference**2).sum() / (reference[pixels] ** 2).sum())) if bright else float("nan"),
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
                a.names[plane],
                x,
                y,
                float(a.values[plane, y, x]),
                float(b.values[plane, y, x]),
                float(sizes[plane, y, x]),
            )
        )
    return tuple(found)


def write_comparison(folder: Path, comparison: StackComparison) -> list[Path]:
    """Write comparison.json and, as EXR, difference, relative_difference and (if known) residual_over_sigma.

    Returns the files written.
    """
    a, b = comparison.first, comparison.second
    maps: dict[str, tuple[NDArray[np.float64], str]] = {
        "difference": (a.values - b.values, a.unit),
        "relative_difference": (comparison.relative, "1"),
    }
    if comparison.residual_over_sigma is not None:
        maps["residual_over_sigma"] = (comparison.residual_over_sigma, "1")
    made = origin(a=str(a.source), b=str(b.source))
    written = [folder / "comparison.json", *(folder / f"{name}.exr" for name in maps)]
    for name, (values, unit) in maps.items():
        array = xr.DataArray(values, dims=("channel", "y", "x"), coords={"channel": list(a.names)}, attrs=made)
        write_map(folder / f"{name}.exr", array, dict.fromkeys(a.names, unit))
    with replacing(written[0]) as temporary:
        temporary.write_text(json.dumps(comparison_record(comparison), indent=1) + "\n", encoding="utf-8")
    return written


def comparison_record(comparison: StackComparison) -> dict[str, Any]:
    """The content of comparison.json; no NaN."""
    a, b = comparison.first, comparison.second
    return {
        "a": str(a.source),
        "b": str(b.source),
        "unit": a.unit,
        "planes": [_finite(asdict(row)) for row in comparison.rows],
        "expected_chi2_per_pixel": comparison.expected_chi2,
        "worst_pixels": [asdict(pixel) for pixel in comparison.worst],
        "worst_measure": comparison.worst_measure,
        "means": [_finite(asdict(row)) for row in comparison.means],
        "notes": list(comparison.notes),
    }


def _finite(record: dict) -> dict:
    """Values for JSON: NaN becomes null."""
    return {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in record.items()}
