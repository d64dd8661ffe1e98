"""ENVI files: a text header and a file of raw samples.

Samples are mapped from the file and read on demand, unless they have to be scaled, put in order or marked as missing.
A header that leaves the order, the type or the size of its samples open is refused, as ENVI itself does. What it leaves
open of their meaning (units, wavelengths) is asked for.
"""

from __future__ import annotations

import glob
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.limits import MAX_CUBE_VALUES, require_size
from numpy.typing import NDArray

from .cube_checks import RADIANCE_UNIT, as_cube, float32_samples
from .declared import AS_STATED, Declared, scaled, sorted_planes, spectral_factor, with_declarations
from .headers import (
    LONGEST_NM,
    SHORTEST_NM,
    EnviHeader,
    Window,
    in_nanometres,
    read_header,
    states_no_unit,
    window_of,
    with_window,
)

__all__ = ["data_file", "map_envi", "read_envi", "samples_file", "write_envi"]

#: NumPy's types by ENVI's code; 6 and 9 are complex and no radiance.
_TYPES = {
    1: "u1",
    2: "i2",
    3: "i4",
    4: "f4",
    5: "f8",
    12: "u2",
    13: "u4",
    14: "i8",
    15: "u8",
}

#: Dimensions in the order of the file, by interleave.
_ORDERS = {
    "bsq": ("wavelength", "y", "x"),
    "bil": ("y", "wavelength", "x"),
    "bip": ("y", "x", "wavelength"),
}

#: Endings of files of samples; ENVI's own are .img and .dat, those of cameras often the interleave.
_DATA_ENDINGS = (".img", ".raw", ".dat", ".bsq", ".bil", ".bip", ".bin", ".hyspex", ".pix", ".rad")

#: File types whose samples are no picture.
_OTHER_FILE_TYPES = ("envi spectral library", "envi classification", "envi meta file")

#: Bad bands that a note names by their wavelengths; of more it states the number.
_MAX_BANDS_NAMED = 6


#: Keys of a header that state the unit of the values, the first one that is there.
_UNIT_KEYS = ("data units", "radiance units", "measurement units", "units")
#: Keys of scales.
_SCALE = re.compile(r"\bscal(e|ing)\b")


@dataclass(frozen=True)
class _Layout(FrozenMappings):
    """Size, order and type of the samples in their file."""

    #: Number of samples by dimension y, x and wavelength.
    size: Mapping[str, int]
    #: Dimensions, the slowest first.
    order: tuple[str, ...]
    #: Type of a sample with its byte order.
    kind: np.dtype
    #: Bytes in front of the first sample.
    offset_bytes: int

    @property
    def file_bytes(self) -> int:
        """Bytes of the file."""
        return self.offset_bytes + math.prod(self.size.values()) * self.kind.itemsize


def write_envi(path: Path, cube: xr.Dataset) -> None:
    """Write the radiance as float32, band after band.

    The header is written last, so that a header implies complete data.

    Parameters
    ----------
    path
        File of the header; the samples go into the file with the ending .img next to it.
    cube
        Radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1.
    """
    samples = float32_samples(cube)
    wavelengths = ", ".join(f"{w:.10g}" for w in cube["wavelength"].values)
    lines = [
        "ENVI",
        "description = {spectral radiance}",
        f"samples = {samples.shape[1]}",
        f"lines = {samples.shape[0]}",
        f"bands = {samples.shape[2]}",
        "header offset = 0",
        "file type = ENVI Standard",
        "data type = 4",
        "interleave = bsq",
        "byte order = 0",
        f"data units = {RADIANCE_UNIT}",
        "wavelength units = Nanometers",
        f"wavelength = {{{wavelengths}}}",
    ]
    if "missing" in cube.attrs:
        lines.append(f"data ignore value = {cube.attrs['missing']}")
    if (window := window_of(cube)) is not None:
        lines += [f"x start = {window.left + 1}", f"y start = {window.top + 1}"]
    with replacing(path.with_suffix(".img")) as temporary:
        temporary.write_bytes(np.ascontiguousarray(np.moveaxis(samples, -1, 0), "<f4").tobytes())
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def data_file(path: Path, size_bytes: int | None = None) -> Path | None:
    """File of samples next to a header: x.img, x.dat, x.bil ... of x.hdr, or x.img of x.img.hdr.

    Where there is none of the usual endings, it is the file of another ending that has the size.

    Parameters
    ----------
    path
        File of the header.
    size_bytes
        Bytes of the samples' file; of several files the one of this size is taken. None takes the first.

    Returns
    -------
    Path or None
        None where there is no such file.

    Raises
    ------
    InputError
        If several files have the size.
    """
    stem = path.with_suffix("")
    endings = (*_DATA_ENDINGS, *(ending.upper() for ending in _DATA_ENDINGS))
    names = [stem.with_name(stem.name + ending) for ending in endings]
    candidates: list[Path] = []
    for candidate in (*names, stem):  # .img and .IMG are one file in some file systems
        if candidate.is_file() and not any(candidate.samefile(other) for other in candidates):
            candidates.append(candidate)
    if not candidates and size_bytes is not None:  # another ending; the size to the byte is proof enough
        others = [
            other for other in path.parent.glob(f"{glob.escape(stem.name)}.*") if other.is_file() and other != path
        ]
        candidates = [other for other in sorted(others) if other.stat().st_size == size_bytes]
    fitting = [candidate for candidate in candidates if candidate.stat().st_size == size_bytes]
    if len(fitting) > 1:
        names_found = ", ".join(candidate.name for candidate in fitting)
        raise InputError(path, f"data files {names_found} of the same size", "one data file of its header's name")
    return next(iter(fitting or candidates), None)


def samples_file(path: Path) -> Path | None:
    """File of the samples that a header is read with.

    Parameters
    ----------
    path
        File of the header.

    Returns
    -------
    Path or None
        None where there is none; the first one where the header cannot be read.
    """
    try:
        return data_file(path, _layout(read_header(path)).file_bytes)
    except InputError:
        return data_file(path)


def map_envi(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """Cube with its samples mapped from the file and read on demand.

    Stored numbers are in memory where they have to be scaled, put in order or marked as missing: by ``data gain
    values`` and ``data offset values`` (gain times number plus offset), ``reflectance scale factor`` (number over
    factor), units other than W m^-2 sr^-1 nm^-1, and ``data ignore value``. Bands that ``bbl`` marks as bad are left
    out. Notes state what was applied.

    Parameters
    ----------
    path
        File of the header.
    declared
        Units, scale, wavelengths or their unit, where the header does not state them.

    Returns
    -------
    xr.Dataset
        Radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1, ascending in wavelength.

    Raises
    ------
    InputError
        If the header lacks a required key, leaves units or wavelengths open, or has a value without meaning. If the
        data file is missing or of another size.
    """
    header = read_header(path)
    notes: list[str] = []
    layout = _layout(header)
    file = data_file(path, layout.file_bytes)
    if file is None:
        endings = ", ".join(_DATA_ENDINGS[:6])
        raise InputError(path, "no data file next to it", f"{path.stem} with one of the endings {endings}, or none")
    if file.stat().st_size != layout.file_bytes:
        size_text = f"{file.stat().st_size} bytes"
        raise InputError(file, size_text, f"{layout.file_bytes} bytes according to its header")
    if _ORDERS.get(file.suffix[1:].lower(), layout.order) != layout.order:
        notes.append(
            f"read as {header.text('interleave')}, as the header states, although the data file is {file.name}"
        )
    unit_key = next((key for key in _UNIT_KEYS if header.text(key)), _UNIT_KEYS[0])
    stated_unit = header.text(unit_key) or None
    factor = spectral_factor(f"{path}: {unit_key}", stated_unit, declared)
    wavelength, used, of_file = _wavelengths(header, layout.size["wavelength"], declared)
    if stated_unit is None:
        used += ["units", "scale"]
    else:
        of_file["units"] = stated_unit
    shape = tuple(layout.size[name] for name in layout.order)
    values = np.memmap(file, layout.kind, "r", layout.offset_bytes, shape)
    planes: NDArray = np.moveaxis(values, layout.order.index("wavelength"), -1)
    planes, ignored = _without_ignored(path, planes, header.text("data ignore value") or "")
    planes = _with_gains(header, planes, notes)
    good = _good_bands(header, wavelength, notes)
    if not good.all():
        planes, wavelength = planes[..., good], wavelength[good]
    _require_light(header, wavelength)
    planes, wavelength = sorted_planes(path, planes, wavelength)
    cube = as_cube(scaled(planes, factor), wavelength, ignored)
    cube = with_window(cube, _window(header, layout.size))
    return with_declarations(cube, declared, used, notes, of_file)


def _layout(header: EnviHeader) -> _Layout:
    """Size, order and type of the samples."""
    path = header.path
    size = {"y": header.integer("lines"), "x": header.integer("samples"), "wavelength": header.integer("bands")}
    code = header.integer("data type")
    if code not in _TYPES:
        description = f"{code} (complex numbers)" if code in (6, 9) else str(code)
        raise InputError(f"{path}: data type", description, f"one of {', '.join(map(str, _TYPES))}")
    interleave = (header.text("interleave") or "").lower()
    if interleave not in _ORDERS:
        expected = f"one of {', '.join(_ORDERS)}: the order of the samples in their file"
        raise InputError(f"{path}: interleave", repr(interleave) if interleave else "nothing", expected)
    kind = np.dtype(_TYPES[code])
    byte_order = header.integer("byte order", 0 if kind.itemsize == 1 else None)
    if byte_order not in (0, 1):
        raise InputError(f"{path}: byte order", str(byte_order), "0 (little endian) or 1 (big endian)")
    offset = header.integer("header offset", 0)
    if min(*size.values(), offset) < 0:
        raise InputError(path, "a negative size or offset", "samples, lines and bands above 0")
    if 0 in size.values():
        raise InputError(path, "no samples", "samples, lines and bands above 0")
    _require_plain_file(header)
    return _Layout(size, _ORDERS[interleave], kind.newbyteorder(">" if byte_order else "<"), offset)


def _require_plain_file(header: EnviHeader) -> None:
    """Raise InputError for other files than pictures, compressed samples, and gaps between them."""
    path, file_type = header.path, (header.text("file type") or "").lower()
    if file_type.startswith(_OTHER_FILE_TYPES):
        raise InputError(f"{path}: file type", file_type, "ENVI Standard, a picture")
    if header.integer("file compression", 0):
        raise InputError(f"{path}: file compression", "1", "0: samples as they are", "Decompress the data file first.")
    for key in ("major frame offsets", "minor frame offsets"):
        if header.numbers(key).any():
            raise InputError(f"{path}: {key}", header.text(key) or "", "0: samples without gaps")


def _window(header: EnviHeader, size: Mapping[str, int]) -> Window | None:
    """Pixels of a larger picture that the file holds, by ``x start`` and ``y start``.

    None for its first pixels. ENVI counts from 1; programs that count from 0 write 0 for the first pixel.
    """
    column, row = (max(header.integer(f"{axis} start", 1) - 1, 0) for axis in "xy")
    return Window(column, row, size["x"], size["y"]) if column or row else None


def _wavelengths(
    header: EnviHeader, bands: int, declared: Declared
) -> tuple[NDArray[np.float64], list[str], dict[str, object]]:
    """(bands,) nm in the order of the file, used declarations, and what the header states."""
    path, unit = header.path, header.text("wavelength units")
    values = header.numbers("wavelength")
    if values.size and states_no_unit(unit):
        _require_count(f"{path}: wavelength", values, bands)
        if declared.wavelength_unit is not None:
            wavelength = in_nanometres(values, declared.wavelength_unit)
            if wavelength is None:
                raise InputError(
                    "declared wavelength-unit", f"'{declared.wavelength_unit}'", "nm, um or another unit of length"
                )
            return wavelength, ["wavelength_unit"], {}
        if declared.wavelengths_nm is None:
            raise InputError(
                f"{path}: wavelength units",
                "nothing" if unit is None else f"'{unit}'",
                f"the unit of its {bands} wavelengths, {values.min():g} to {values.max():g}: Nanometers or Micrometers",
                "declare wavelength-unit=nm, or declare wavelengths=400:700:20.",
            )
    if not values.size or states_no_unit(unit):
        if declared.wavelengths_nm is None:
            expected = "a list of wavelengths, and Nanometers or Micrometers in wavelength units"
            raise InputError(f"{path}: wavelength", "nothing", expected, "declare wavelengths=400:700:20.")
        wavelength = np.array(declared.wavelengths_nm)
        _require_count("declared wavelengths", wavelength, bands)
        return wavelength, ["wavelengths_nm"], {}
    wavelength = in_nanometres(values, unit)
    if wavelength is None:
        raise InputError(f"{path}: wavelength units", f"'{unit}'", "Nanometers, Micrometers or another unit of length")
    _require_count(f"{path}: wavelength", values, bands)
    return wavelength, [], {"wavelength_unit": str(unit)}


def _require_count(where: str, values: NDArray[np.float64], bands: int) -> None:
    """Raise InputError unless there is a wavelength for each band."""
    if values.size != bands:
        raise InputError(where, f"{values.size} values", f"{bands}, the value of bands")


def _require_light(header: EnviHeader, wavelength: NDArray[np.float64]) -> None:
    """Raise InputError for wavelengths that are none of light: the unit of the list is another."""
    low, high = float(wavelength.min()), float(wavelength.max())
    if not (low >= SHORTEST_NM and high <= LONGEST_NM):
        unit = header.text("wavelength units") or "declared"
        raise InputError(
            f"{header.path}: wavelength",
            f"{low:g} to {high:g} nm (unit: {unit})",
            f"wavelengths of light, {SHORTEST_NM:g} to {LONGEST_NM:g} nm",
            "Is the list in another unit, such as Micrometers in place of Nanometers?",
        )


def _good_bands(header: EnviHeader, wavelength: NDArray[np.float64], notes: list[str]) -> NDArray[np.bool_]:
    """(bands,) bands that ``bbl``, the list of bad bands (0 bad, 1 good), does not mark as bad."""
    where = f"{header.path}: bbl"
    flags = header.numbers("bbl")
    if flags.size == 0:
        return np.ones(wavelength.size, bool)
    if flags.size != wavelength.size:
        raise InputError(where, f"{flags.size} values", f"{wavelength.size}, the value of bands")
    odd = flags[(flags != 0) & (flags != 1)]
    if odd.size:
        raise InputError(where, f"{odd[0]:g}", "0 for each bad band and 1 for each good one")
    good = flags != 0
    if not good.any():
        raise InputError(where, "no good band", "1 for each band to be read")
    bad = wavelength[~good]
    if bad.size:
        names = f"{', '.join(f'{w:g}' for w in bad)} nm" if bad.size <= _MAX_BANDS_NAMED else f"{bad.size} bands"
        notes.append(f"bands that the header marks as bad (bbl) are left out: {names}")
    return good


def _with_gains(header: EnviHeader, planes: NDArray, notes: list[str]) -> NDArray:
    """(y, x, bands) values that the stored numbers stand for; the same array without a scale."""
    path, bands = header.path, planes.shape[-1]
    gain = header.numbers_by_band("data gain values", bands, 1.0)
    offset = header.numbers_by_band("data offset values", bands, 0.0)
    _require_known_scales(header)
    divisor = header.numbers_by_band("reflectance scale factor", 1, 1.0)[0]
    for key, values in (("data gain values", gain), ("reflectance scale factor", divisor)):
        if not np.all(values > 0):
            raise InputError(f"{path}: {key}", f"{np.min(values):g}", "numbers above 0")
    applied = [
        key
        for key, differs in (
            ("data gain values", (gain != 1).any()),
            ("data offset values", offset.any()),
            ("reflectance scale factor", divisor != 1),
        )
        if differs
    ]
    if not applied:
        return planes
    if divisor != 1 and len(applied) > 1:
        expected = "one of the two: a factor, or gains and offsets"
        raise InputError(f"{path}: {applied[-1]}", f"{divisor:g} and {applied[0]}", expected)
    notes.append(f"applied to the stored numbers: {' and '.join(applied)}")
    kind = np.result_type(planes.dtype, np.float32)
    return np.asarray((planes * (gain / divisor) + offset).astype(kind))


def _require_known_scales(header: EnviHeader) -> None:
    """Raise InputError for a scale by which numbers may have to be multiplied or divided."""
    for key in header.entries:
        if _SCALE.search(key) and key != "reflectance scale factor" and not np.all(header.numbers(key) == 1):
            hint = "Write 'data gain values' in its place: the factors from the stored numbers to the unit."
            expected = "'data gain values', which are multiplied, or 'reflectance scale factor', which divides"
            raise InputError(
                f"{header.path}: {key}", f"{header.text(key)}, a scale of unknown direction", expected, hint
            )


def _without_ignored(path: Path, planes: NDArray, ignored: str) -> tuple[NDArray, bool]:
    """Samples of the ignored value as NaN, and whether NaN marks missing pixels."""
    if ignored.lower() in ("", "nan"):
        return planes, bool(ignored)
    try:
        value = float(ignored)
    except ValueError:
        raise InputError(f"{path}: data ignore value", repr(ignored), "a number") from None
    if planes.dtype.kind in "iu" and not (value.is_integer() and _fits(value, planes.dtype)):
        return planes, True  # no stored number can have this value
    with np.errstate(over="ignore"):  # a number of 64 bits for samples of 32 is stored as infinite
        missing = planes == np.asarray(value).astype(planes.dtype)
    return np.where(missing, np.nan, planes).astype(np.result_type(planes.dtype, np.float32)), True


def _fits(value: float, kind: np.dtype) -> bool:
    """Whether a whole number lies in the range of a type of integers."""
    limits = np.iinfo(kind)
    return limits.min <= value <= limits.max


def read_envi(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """Cube in memory, in float32, or in float64 where the file has numbers of 32 bits or more.

    Parameters
    ----------
    path
        File of the header.
    declared
        As ``map_envi``.

    Returns
    -------
    xr.Dataset
        As ``map_envi``.

    Raises
    ------
    InputError
        As ``map_envi``.
    """
    mapped = map_envi(path, declared)
    require_size(path, mapped["radiance"].size, MAX_CUBE_VALUES, "values")
    radiance = mapped["radiance"].values
    kind = np.result_type(radiance.dtype.newbyteorder("="), np.float32)
    cube = as_cube(radiance.astype(kind), mapped["wavelength"].values)
    return cube.assign_attrs(mapped.attrs)
