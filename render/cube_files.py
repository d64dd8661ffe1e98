"""Spectral cubes on disk: NetCDF (everything), spectral OpenEXR and ENVI (radiance), PNG (a picture).

A cube is the Dataset of ``RenderedImage.cube``: radiance (y, x, wavelength) in W m^-2 sr^-1 nm^-1 and,
where known, standard_error of the same shape and surface (y, x); wavelength in nm, ascending. NetCDF also
holds cubes as coefficients of a spectral basis (``spectral_basis``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import xarray as xr
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.files import replacing
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from .previews import cube_to_linear_srgb, cube_to_srgb

__all__ = ["READABLE", "WRITABLE", "open_cube", "read_cube", "write_cube"]

_RADIANCE = "W m^-2 sr^-1 nm^-1"
_EXR_CHANNEL = re.compile(r"S0\.(\d+(?:,\d*)?|,\d+)([eE][+-]?\d+)?(nm|um|m)")
_METRES_PER_NM = {"nm": 1.0, "um": 1e3, "m": 1e9}
# The layout's own programs state the second for samples per nm, too.
_EXR_UNITS = ("W.m^-2.sr^-1.nm^-1", "W.m^-2.sr^-1")
_ENVI_TYPES = {1: "u1", 2: "i2", 4: "f4", 5: "f8", 12: "u2"}
_ENVI_ORDERS = {
    "bsq": ("wavelength", "y", "x"),
    "bil": ("y", "wavelength", "x"),
    "bip": ("y", "x", "wavelength"),
}


def write_cube(path: Path, cube: xr.Dataset) -> None:
    """Write a cube in the format of the path's ending: .nc, .exr, .hdr (ENVI, with .img beside) or .png.

    .nc keeps the whole dataset; .exr (layout of Fichet, Pacanowski and Wilkie, JCGT 10(3), 2021) and .hdr
    keep the radiance as float32. No half-written file is left. Raises InputError for another ending, a
    dataset that is no cube, or a place that cannot be written to.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(path, f"the ending '{path.suffix}'", f"one of {', '.join(WRITABLE)}")
    (_require_stored if path.suffix.lower() == ".nc" else _require_cube)(cube, path)
    try:
        writer(path, cube)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be written") from None


def read_cube(path: Path) -> xr.Dataset:
    """The cube of a .nc, .exr or .hdr file, in memory. Raises InputError naming what is wrong with it."""
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, f"the ending '{path.suffix}'", f"one of {', '.join(READABLE)}")
    if not path.is_file():
        raise InputError(path, "no such file", "a spectral cube")
    cube = reader(path)
    _require_cube(cube, path)
    return cube


@contextmanager
def open_cube(path: Path) -> Iterator[xr.Dataset]:
    """The cube of a file, of which .nc and .hdr are read only as far as they are used. Errors of read_cube.

    NetCDF may hold coefficients of a spectral basis in place of radiance (``spectral_basis``).
    """
    path = Path(path)
    if path.suffix.lower() == ".hdr" and path.is_file():
        cube = _map_envi(path)
        _require_cube(cube, path)
        yield cube
        return
    if path.suffix.lower() != ".nc" or not path.is_file():
        yield read_cube(path)
        return
    try:
        file = xr.open_dataset(path, engine="h5netcdf", cache=False)
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a NetCDF-4 file") from None
    with file:
        _require_stored(file, path)
        yield file


def _require_stored(cube: xr.Dataset, path: Path) -> None:
    """What a NetCDF file may hold: a cube, or one in a basis."""
    if "coefficient" in cube:
        _require_coefficients(cube, path)
    else:
        _require_cube(cube, path)


def _require_coefficients(cube: xr.Dataset, path: Path) -> None:
    dims = {
        "coefficient": ("y", "x", "component"),
        "basis": ("component", "wavelength"),
        "mean": ("wavelength",),
    }
    for name, expected in dims.items():
        if name not in cube or set(cube[name].dims) != set(expected):
            raise InputError(f"{path}: {name}", "nothing that fits", f"an array over {', '.join(expected)}")
    _require_axis_and_units(cube, "coefficient", path)


def _require_cube(cube: xr.Dataset, path: Path) -> None:
    if "radiance" not in cube or set(cube["radiance"].dims) != {"y", "x", "wavelength"}:
        found = (
            ", ".join(f"{name}{tuple(map(str, a.dims))}" for name, a in cube.data_vars.items()) or "nothing"
        )
        raise InputError(f"{path}: radiance", found, "radiance with dimensions y, x, wavelength")
    _require_axis_and_units(cube, "radiance", path)


def _require_axis_and_units(cube: xr.Dataset, quantity: str, path: Path) -> None:
    if "wavelength" not in cube.coords:
        raise InputError(f"{path}: wavelength", "no coordinate", "the wavelengths in nm")
    wavelength = cube["wavelength"].values
    if not np.all(np.isfinite(wavelength)) or np.any(np.diff(wavelength) <= 0) or wavelength[0] <= 0:
        raise InputError(f"{path}: wavelength", "values that do not ascend", "ascending wavelengths in nm")
    for name, units in (("wavelength", "nm"), (quantity, _RADIANCE)):
        stated = cube[name].attrs.get("units", units)
        if stated != units:
            raise InputError(f"{path}: {name}", f"the unit '{stated}'", f"'{units}'", "Convert it first.")


def _cube(radiance: NDArray, wavelength_nm: ArrayLike) -> xr.Dataset:
    wavelength = ("wavelength", np.asarray(wavelength_nm, float), {"units": "nm"})
    values = (("y", "x", "wavelength"), radiance, {"units": _RADIANCE})
    return xr.Dataset({"radiance": values}, coords={"wavelength": wavelength})


def _samples(cube: xr.Dataset) -> NDArray[np.float32]:
    return cube["radiance"].transpose("y", "x", "wavelength").values.astype(np.float32)


def _write_netcdf(path: Path, cube: xr.Dataset) -> None:
    packed = {str(name): {"zlib": True, "complevel": 4} for name in cube.data_vars}
    with replacing(path) as temporary:
        cube.to_netcdf(temporary, engine="h5netcdf", encoding=packed)


def _read_netcdf(path: Path) -> xr.Dataset:
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "a NetCDF-4 file") from None


def _write_exr(path: Path, cube: xr.Dataset) -> None:
    samples, picture = _samples(cube), cube_to_linear_srgb(cube)
    channels = {name: np.ascontiguousarray(picture[..., i], np.float32) for i, name in enumerate("RGB")}
    for index, wavelength in enumerate(cube["wavelength"].values):
        # A comma, since the dot separates layers in OpenEXR.
        name = f"S0.{wavelength:.6f}nm".replace(".", ",").replace("S0,", "S0.")
        channels[name] = np.ascontiguousarray(samples[..., index])
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "spectralLayoutVersion": "1.0",
        "emissiveUnits": _EXR_UNITS[0],
    }
    with replacing(path) as temporary, OpenEXR.File(header, channels) as file:
        file.write(str(temporary))


def _read_exr(path: Path) -> xr.Dataset:
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # The file empties its header and channels when it is closed.
            header, channels = dict(file.header()), dict(file.channels())
            planes = {
                _nanometres(match): np.array(channels[name].pixels, np.float32)
                for name in channels
                if (match := _EXR_CHANNEL.fullmatch(name))
            }
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", "an OpenEXR file") from None
    if not planes:
        known = ", ".join(sorted(channels)[:8])
        raise InputError(path, f"the channels {known}", "emissive spectra such as 'S0.550,000000nm'")
    units = str(header.get("emissiveUnits", _EXR_UNITS[0]))
    if units not in _EXR_UNITS:
        raise InputError(f"{path}: emissiveUnits", f"'{units}'", f"one of {', '.join(_EXR_UNITS)}")
    wavelengths = sorted(planes)
    return _cube(np.stack([planes[w] for w in wavelengths], axis=-1), wavelengths)


def _nanometres(match: re.Match[str]) -> float:
    number = float(match[1].replace(",", ".") + (match[2] or ""))
    return number * _METRES_PER_NM[match[3]]


def _write_envi(path: Path, cube: xr.Dataset) -> None:
    samples = _samples(cube)
    wavelengths = ", ".join(f"{w:.10g}" for w in cube["wavelength"].values)
    lines = [
        "ENVI", "description = {spectral radiance}", f"samples = {samples.shape[1]}",
        f"lines = {samples.shape[0]}", f"bands = {samples.shape[2]}", "header offset = 0",
        "file type = ENVI Standard", "data type = 4", "interleave = bsq", "byte order = 0",
        f"data units = {_RADIANCE}", "wavelength units = Nanometers", f"wavelength = {{{wavelengths}}}",
    ]  # fmt: skip
    # The header goes last: where there is one, its data are complete.
    with replacing(path.with_suffix(".img")) as temporary:
        temporary.write_bytes(np.ascontiguousarray(np.moveaxis(samples, -1, 0), "<f4").tobytes())
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _envi_header(path: Path) -> dict[str, str]:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "an ENVI header") from None
    if not text.startswith("ENVI"):
        raise InputError(path, "no 'ENVI' in its first line", "an ENVI header")
    pairs = re.findall(r"^\s*([^=\n]+?)\s*=\s*(\{[^}]*\}|[^\n]*)", text, re.MULTILINE)
    return {key.lower(): value.strip().strip("{}").strip() for key, value in pairs}


def _map_envi(path: Path) -> xr.Dataset:
    """The samples as they lie in the file, read as far as they are used."""
    header = _envi_header(path)

    def whole(key: str, default: int | None = None) -> int:
        if key not in header and default is not None:
            return default
        try:
            return int(header[key])
        except (KeyError, ValueError):
            raise InputError(f"{path}: {key}", repr(header.get(key)), "a whole number") from None

    size = {"x": whole("samples"), "y": whole("lines"), "wavelength": whole("bands")}
    code, order = whole("data type"), header.get("interleave", "bsq").lower()
    if code not in _ENVI_TYPES:
        raise InputError(f"{path}: data type", str(code), f"one of {', '.join(map(str, _ENVI_TYPES))}")
    if order not in _ENVI_ORDERS:
        raise InputError(f"{path}: interleave", order, f"one of {', '.join(_ENVI_ORDERS)}")
    if header.get("data units", _RADIANCE) != _RADIANCE:
        raise InputError(f"{path}: data units", header["data units"], f"'{_RADIANCE}'", "Convert it first.")
    units = header.get("wavelength units", "Nanometers").lower()
    factor = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3}.get(units)
    if factor is None:
        raise InputError(f"{path}: wavelength units", units, "Nanometers or Micrometers")
    try:
        wavelength = np.array([float(w) for w in header.get("wavelength", "").split(",")]) * factor
    except ValueError:
        raise InputError(
            f"{path}: wavelength", header.get("wavelength", "nothing"), "a list of numbers"
        ) from None
    if wavelength.size != size["wavelength"]:
        raise InputError(
            f"{path}: wavelength", f"{wavelength.size} values", f"{size['wavelength']}, as bands says"
        )
    raw = next((p for p in (path.with_suffix(s) for s in (".img", ".raw", ".dat", "")) if p.is_file()), None)
    if raw is None:
        raise InputError(path, "no data file beside it", f"{path.stem}.img, .raw or .dat")
    kind = np.dtype(("<", ">")[whole("byte order", 0) == 1] + _ENVI_TYPES[code])
    dims = _ENVI_ORDERS[order]
    offset, count = whole("header offset", 0), int(np.prod([size[d] for d in dims]))
    if raw.stat().st_size != offset + count * kind.itemsize:
        found = f"{raw.stat().st_size} bytes"
        raise InputError(raw, found, f"{offset + count * kind.itemsize} by its header")
    if count == 0:
        raise InputError(path, "no samples", "samples, lines and bands above 0")
    values = np.memmap(raw, kind, "r", offset, tuple(size[d] for d in dims))
    return _cube(np.moveaxis(values, dims.index("wavelength"), -1), wavelength)


def _read_envi(path: Path) -> xr.Dataset:
    mapped = _map_envi(path)
    radiance = mapped["radiance"].values
    kind = np.float64 if radiance.dtype.newbyteorder("=") == np.float64 else np.float32
    return _cube(radiance.astype(kind), mapped["wavelength"].values)


def _write_png(path: Path, cube: xr.Dataset) -> None:
    with replacing(path) as temporary:
        Image.fromarray(cube_to_srgb(cube)).save(temporary, format="PNG")


_WRITERS: dict[str, Callable[[Path, xr.Dataset], None]] = {
    ".nc": _write_netcdf, ".exr": _write_exr, ".hdr": _write_envi, ".png": _write_png,
}  # fmt: skip
_READERS: dict[str, Callable[[Path], xr.Dataset]] = {
    ".nc": _read_netcdf,
    ".exr": _read_exr,
    ".hdr": _read_envi,
}

#: The endings that write_cube and read_cube know.
WRITABLE, READABLE = tuple(_WRITERS), tuple(_READERS)
