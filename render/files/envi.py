"""ENVI files: a text header and a file of raw samples."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import read_text
from numpy.typing import NDArray

from .cube_checks import RADIANCE_UNIT, as_cube, float32_samples
from .declared import AS_STATED, Declared, scaled, sorted_planes, spectral_factor, told

__all__ = ["data_file", "is_envi", "map_envi", "read_envi", "write_envi"]

_TYPES = {1: "u1", 2: "i2", 4: "f4", 5: "f8", 12: "u2"}
_ORDERS = {
    "bsq": ("wavelength", "y", "x"),
    "bil": ("y", "wavelength", "x"),
    "bip": ("y", "x", "wavelength"),
}


def write_envi(path: Path, cube: xr.Dataset) -> None:
    """Write the radiance as float32, band after band."""
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
    # The header is written last, so that a header implies complete data.
    with replacing(path.with_suffix(".img")) as temporary:
        temporary.write_bytes(np.ascontiguousarray(np.moveaxis(samples, -1, 0), "<f4").tobytes())
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _header(path: Path) -> dict[str, str]:
    """Keys in lower case with their values without braces; a value in braces may span several lines."""
    lines = iter(read_text(path, "an ENVI header", largest=2**20).splitlines())
    if not next(lines, "").startswith("ENVI"):
        raise InputError(path, "no 'ENVI' in its first line", "an ENVI header")
    header: dict[str, str] = {}
    for line in lines:
        key, equals, value = (part.strip() for part in line.partition("="))
        if not equals or not key or key.startswith(";"):
            continue
        parts = [value]
        while value.startswith("{") and "}" not in parts[-1] and (more := next(lines, None)) is not None:
            parts.append(more.strip())
        header[key.lower()] = " ".join(parts).strip("{}").strip()
    return header


def _require_plain_values(path: Path, header: dict[str, str]) -> None:
    """Raise InputError if the stored numbers must be scaled to get the radiance."""
    for key, plain in (
        ("data gain values", 1.0),
        ("data offset values", 0.0),
        ("reflectance scale factor", 1.0),
    ):
        try:
            stated = [float(part) for part in header.get(key, "").split(",") if part.strip()]
        except ValueError:
            raise InputError(f"{path}: {key}", repr(header[key]), "numbers") from None
        if any(value != plain for value in stated):
            hint = "Apply them to the samples and remove the key."
            raise InputError(f"{path}: {key}", header[key], f"{plain:g}: samples that are the radiance", hint)


def data_file(path: Path) -> Path | None:
    """The file of samples beside a header, if there is one."""
    return next((p for p in (path.with_suffix(s) for s in (".img", ".raw", ".dat", "")) if p.is_file()), None)


def is_envi(path: Path) -> bool:
    """Whether the file begins as ENVI's headers do."""
    with path.open("rb") as file:
        return file.read(7).removeprefix(b"\xef\xbb\xbf").startswith(b"ENVI")


def map_envi(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """The cube with its samples mapped from the file, read on demand.

    In memory where samples have to be scaled, or planes put in order.
    """
    header = _header(path)

    def whole(key: str, default: int | None = None) -> int:
        if key not in header and default is not None:
            return default
        try:
            return int(header[key])
        except (KeyError, ValueError):
            raise InputError(f"{path}: {key}", repr(header.get(key)), "a whole number") from None

    _require_plain_values(path, header)
    size = {"x": whole("samples"), "y": whole("lines"), "wavelength": whole("bands")}
    code, order = whole("data type"), header.get("interleave", "bsq").lower()
    if code not in _TYPES:
        raise InputError(f"{path}: data type", str(code), f"one of {', '.join(map(str, _TYPES))}")
    if order not in _ORDERS:
        raise InputError(f"{path}: interleave", order, f"one of {', '.join(_ORDERS)}")
    factor = spectral_factor(f"{path}: data units", header.get("data units"), declared)
    wavelength, used = _wavelengths(path, header, declared)
    if "data units" not in header:
        used += ["units", "scale"]
    if wavelength.size != size["wavelength"]:
        raise InputError(
            f"{path}: wavelength", f"{wavelength.size} values", f"{size['wavelength']}, the value of bands"
        )
    raw = data_file(path)
    if raw is None:
        raise InputError(path, "no data file beside it", f"{path.stem}.img, .raw or .dat")
    if (byte_order := whole("byte order", 0)) not in (0, 1):
        raise InputError(f"{path}: byte order", str(byte_order), "0 (little endian) or 1 (big endian)")
    kind = np.dtype("<>"[byte_order] + _TYPES[code])
    dims = _ORDERS[order]
    offset, count = whole("header offset", 0), math.prod(size[d] for d in dims)
    if min(*size.values(), offset) < 0:
        raise InputError(path, "a negative size or offset", "samples, lines and bands above 0")
    if raw.stat().st_size != offset + count * kind.itemsize:
        found = f"{raw.stat().st_size} bytes"
        raise InputError(raw, found, f"{offset + count * kind.itemsize} bytes according to its header")
    if count == 0:
        raise InputError(path, "no samples", "samples, lines and bands above 0")
    values = np.memmap(raw, kind, "r", offset, tuple(size[d] for d in dims))
    planes, wavelength = sorted_planes(path, np.moveaxis(values, dims.index("wavelength"), -1), wavelength)
    planes, ignored = _without(path, planes, header.get("data ignore value", ""))
    cube = as_cube(scaled(planes, factor), wavelength, ignored)
    return told(cube, declared, used, stated={"units": header["data units"]} if "data units" in header else {})


def _wavelengths(path: Path, header: dict[str, str], declared: Declared) -> tuple[NDArray[np.float64], list[str]]:
    """In nm, and what was declared in place of the header's."""
    units = header.get("wavelength units", "unknown").lower()
    factor = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3}.get(units)
    if "wavelength" not in header or (factor is None and units == "unknown"):
        if declared.wavelengths_nm is None:
            missing = "wavelength units" if "wavelength" in header else "wavelength"
            hint = "declare wavelengths=400:700:20."
            raise InputError(f"{path}: {missing}", "nothing", "Nanometers or Micrometers, and a list", hint)
        return np.array(declared.wavelengths_nm), ["wavelengths_nm"]
    if factor is None:
        raise InputError(f"{path}: wavelength units", units, "Nanometers or Micrometers")
    try:
        return np.array([float(w) for w in header["wavelength"].split(",")]) * factor, []
    except ValueError:
        raise InputError(f"{path}: wavelength", header["wavelength"], "a list of numbers") from None


def _without(path: Path, planes: NDArray, ignored: str) -> tuple[NDArray, bool]:
    """Samples of the ignored value as NaN, and whether NaN marks missing pixels."""
    if ignored.lower() in ("", "nan"):
        return planes, bool(ignored)
    try:
        value = float(ignored)
    except ValueError:
        raise InputError(f"{path}: data ignore value", repr(ignored), "a number") from None
    out = planes == np.asarray(value).astype(planes.dtype)
    return np.where(out, np.nan, planes).astype(np.result_type(planes.dtype, np.float32)), True


def read_envi(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """The cube in memory. Raises InputError for faults of the header and data of another size."""
    mapped = map_envi(path, declared)
    radiance = mapped["radiance"].values
    kind = np.float64 if radiance.dtype.newbyteorder("=") == np.float64 else np.float32
    cube = as_cube(radiance.astype(kind), mapped["wavelength"].values)
    return cube.assign_attrs(mapped.attrs)
