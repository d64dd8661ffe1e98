"""Pictures on disk. Spectral cubes: NetCDF (all data), spectral OpenEXR and ENVI (radiance only), OpenEXR files of
bands (reading only), PNG (writing only). Pictures in colour, for reading only: OpenEXR in X, Y, Z or R, G, B, Radiance.

A cube is the Dataset of ``RenderedImage.cube``: radiance (y, x, wavelength) in W m^-2 sr^-1 nm^-1 and,
if known, standard_error of the same shape and surface (y, x); wavelength in nm, ascending. NetCDF files may also
hold cubes as coefficients of a spectral basis (``spectral_basis``). What a file does not state (units, wavelengths,
colour space) is asked for, never guessed (``declared``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import require_regular_file
from PIL import Image

from .colour_pictures import colour_channels, picture_of_colours
from .cube_checks import (
    negative_pixels,
    require_cube,
    require_light,
    require_numbers,
    require_stored,
    with_units,
)
from .declared import AS_STATED, Declared, with_notes
from .envi import data_file, is_envi, map_envi, read_envi, write_envi
from .exr_channels import read_channels
from .netcdf import open_netcdf, read_netcdf, write_netcdf
from .previews import cube_to_srgb
from .radiance_hdr import is_radiance, read_radiance
from .specfilm import cube_of_bands
from .spectral_exr import cube_of_spectral_channels, spectral_channels, write_exr

__all__ = ["READABLE", "WRITABLE", "files_of", "open_cube", "read_cube", "read_picture", "write_cube"]


@dataclass(frozen=True)
class CubeFormat:
    """One format. read : gives a cube or a picture in colour (``colour_pictures``). recognises : whether a file of that
    ending has it. write, open : None where it cannot be written, or read on demand."""

    ending: str
    read: Callable[[Path, Declared], xr.Dataset]
    recognises: Callable[[Path], bool] = lambda path: True
    write: Callable[[Path, xr.Dataset], None] | None = None
    open: Callable[[Path, Declared], xr.Dataset] | None = None


def _write_png(path: Path, cube: xr.Dataset) -> None:
    with replacing(path) as temporary:
        Image.fromarray(cube_to_srgb(cube)).save(temporary, format="PNG")


def _read_exr(path: Path, declared: Declared) -> xr.Dataset:
    """Which of three formats it is, the channels' names tell."""
    channels = read_channels(path)
    if spectral_channels(channels.planes):
        return cube_of_spectral_channels(path, channels, declared)
    if colour_channels(set(channels.planes)) is not None:
        return picture_of_colours(path, channels, declared)
    return cube_of_bands(path, channels, declared)


#: The first of an ending that recognises a file reads it.
FORMATS = (
    CubeFormat(".nc", read_netcdf, write=write_netcdf, open=open_netcdf),
    CubeFormat(".exr", _read_exr, write=write_exr),
    CubeFormat(".hdr", read_radiance, is_radiance),
    CubeFormat(".hdr", read_envi, is_envi, write_envi, map_envi),
)
_WRITERS = {known.ending: known.write for known in FORMATS if known.write} | {".png": _write_png}
WRITABLE = tuple(_WRITERS)
READABLE = tuple(dict.fromkeys(known.ending for known in FORMATS))


def write_cube(path: Path, cube: xr.Dataset) -> None:
    """Write a cube in the format of the path's ending: .nc, .exr, .hdr (ENVI, with .img beside) or .png.

    .nc keeps the whole dataset; .exr (layout of Fichet, Pacanowski and Wilkie, JCGT 10(3), 2021) and .hdr
    keep the radiance as float32. Incomplete files are removed. Raises InputError for another ending, a dataset that
    is not a cube, or a path that cannot be written to.
    """
    path = Path(path)
    ending = path.suffix.lower()
    write = _WRITERS.get(ending)
    if write is None:
        raise InputError(path, f"the ending '{path.suffix}'", f"one of {', '.join(WRITABLE)}")
    (require_stored if ending == ".nc" else require_cube)(cube, path)
    try:
        write(path, with_units(cube) if "radiance" in cube else cube)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be written") from None


def files_of(path: Path) -> tuple[Path, ...]:
    """The file of a picture, and the data file beside an ENVI header."""
    samples = data_file(path) if path.suffix.lower() == ".hdr" and is_envi(path) else None
    return (path,) if samples is None else (path, samples)


def read_cube(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """The spectral cube of a file, in memory. declared : what the file does not state.

    Raises InputError for a missing or invalid file, one that leaves open what it holds, and for pictures in colour.
    """
    cube = read_picture(path, declared)
    if "xyz" in cube:
        raise InputError(path, "a picture in colour", "a spectral cube")
    return cube


def read_picture(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """The cube, or the picture in X, Y, Z (``xyz`` over y, x, component, in cd m^-2), of a file. As ``read_cube``."""
    path = Path(path)
    picture = _readable(path).read(path, declared)
    if "xyz" not in picture:
        require_cube(picture, path)
    require_numbers(picture, path)
    require_light(picture, path)
    negative = negative_pixels(picture)
    return with_notes(picture, [f"pixels of negative radiance: {negative}"] if negative else [])


@contextmanager
def open_cube(path: Path, declared: Declared = AS_STATED) -> Iterator[xr.Dataset]:
    """The cube of a file; NetCDF and ENVI are read on demand. Raises InputError like read_cube.

    A NetCDF file may hold coefficients of a spectral basis instead of radiance (``spectral_basis``).
    """
    path = Path(path)
    known = _readable(path)
    if known.open is None:
        yield read_cube(path, declared)
        return
    with known.open(path, declared) as cube:
        require_stored(cube, path)
        yield cube


def _readable(path: Path) -> CubeFormat:
    own = [known for known in FORMATS if known.ending == path.suffix.lower()]
    if not own:
        raise InputError(path, f"the ending '{path.suffix}'", f"one of {', '.join(READABLE)}")
    require_regular_file(path, "a spectral cube")
    try:
        found = next((known for known in own if known.recognises(path)), None)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be read") from None
    if found is None:
        raise InputError(path, "no 'ENVI' and no '#?' at its beginning", "an ENVI header or a Radiance picture")
    return found
