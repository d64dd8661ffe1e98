"""Pictures on disk.

Spectral cubes: NetCDF (all data), spectral OpenEXR and ENVI (radiance only), OpenEXR files of bands (reading only), PNG
(writing only). Pictures in colour, for reading only: OpenEXR in X, Y, Z or R, G, B, Radiance.

A cube is the Dataset of ``RenderedImage.cube``: radiance (y, x, wavelength) in W m^-2 sr^-1 nm^-1 and,
if known, standard_error of the same shape and surface (y, x); wavelength in nm, ascending. NetCDF files may also
hold cubes as coefficients of a spectral basis (``spectral_basis``). What a file does not state (units, wavelengths,
colour space) is asked for, never guessed (``declared``). A picture that is part of a larger one says so (``windows``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.arguments import required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import other_format, require_regular_file
from PIL import Image

from .colour_pictures import colour_channels, picture_of_colours
from .cube_checks import (
    negative_pixels,
    require_cube,
    require_light,
    require_numbers,
    require_stored,
    require_wavelengths_of_light,
    with_units,
)
from .declared import AS_STATED, Declared, with_notes
from .envi import map_envi, read_envi, samples_file, write_envi
from .exr_channels import read_channels
from .headers import is_envi, with_window
from .netcdf import open_netcdf, read_netcdf, write_netcdf
from .radiance_hdr import is_radiance, read_radiance
from .specfilm import cube_of_bands
from .spectral_exr import cube_of_spectral_channels, spectral_channels, write_exr

__all__ = ["READABLE", "WRITABLE", "files_of", "open_cube", "read_cube", "read_picture", "write_cube"]


@dataclass(frozen=True)
class CubeFormat:
    """One format of files."""

    #: Ending of its files, in lower case with the dot.
    ending: str
    #: Reads a cube, or a picture in colour (``colour_pictures``).
    read: Callable[[Path, Declared], xr.Dataset]
    #: Whether a file of that ending has this format.
    recognises: Callable[[Path], bool] = lambda path: True
    #: Writes a cube; None where the format is not written.
    write: Callable[[Path, xr.Dataset], None] | None = None
    #: Opens a cube whose values are read on demand; None where they are read at once.
    open: Callable[[Path, Declared], xr.Dataset] | None = None


def _write_png(path: Path, cube: xr.Dataset) -> None:
    """Write a preview in sRGB."""
    from .previews import cube_to_srgb  # slow to import

    with replacing(path) as temporary:
        Image.fromarray(cube_to_srgb(cube)).save(temporary, format="PNG")


def _read_exr(path: Path, declared: Declared) -> xr.Dataset:
    """Picture of one of three formats, by the names of the channels."""
    channels = read_channels(path)
    if spectral_channels(channels.planes):
        picture = cube_of_spectral_channels(path, channels, declared)
    elif colour_channels(set(channels.planes)) is not None:
        picture = picture_of_colours(path, channels, declared)
    else:
        picture = cube_of_bands(path, channels, declared)
    return with_window(with_notes(picture, channels.notes), channels.window)


#: Formats by ending; the first of an ending that recognises a file reads it.
FORMATS = (
    CubeFormat(".nc", read_netcdf, write=write_netcdf, open=open_netcdf),
    CubeFormat(".exr", _read_exr, write=write_exr),
    CubeFormat(".hdr", read_radiance, is_radiance),
    CubeFormat(".hdr", read_envi, is_envi, write_envi, map_envi),
)
_WRITERS = {form.ending: form.write for form in FORMATS if form.write} | {".png": _write_png}

#: Endings of files that are written.
WRITABLE = tuple(_WRITERS)

#: Endings of files that are read.
READABLE = tuple(dict.fromkeys(form.ending for form in FORMATS))


def write_cube(path: Path, cube: xr.Dataset) -> None:
    """Write a cube in the format of the path's ending: .nc, .exr, .hdr (ENVI) or .png.

    .nc keeps the complete dataset; .exr (layout of Fichet, Pacanowski and Wilkie, JCGT 10(3), 2021) and .hdr
    keep the radiance as float32.

    Parameters
    ----------
    path
        File to write; an incomplete one is removed.
    cube
        Radiance (y, x, wavelength), or for .nc coefficients of a spectral basis.

    Raises
    ------
    InputError
        If the ending is another, the dataset is no cube, or the path cannot be written to.
    """
    path = required_path("path", path, "a file to write")
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
    """Files that hold a picture: the file itself, and the data file of an ENVI header.

    Parameters
    ----------
    path
        File of a picture.

    Returns
    -------
    tuple of Path
        ``path`` first.
    """
    path = _header_of(path)
    samples = samples_file(path) if path.suffix.lower() == ".hdr" and is_envi(path) else None
    return (path,) if samples is None else (path, samples)


def read_cube(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """Spectral cube of a file, in memory.

    Parameters
    ----------
    path
        File of a cube.
    declared
        Values that the file does not state.

    Returns
    -------
    xr.Dataset
        Radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1.

    Raises
    ------
    InputError
        If the file is missing or invalid, leaves open what it holds, or is a picture in colour.
    """
    cube = read_picture(path, declared)
    if "xyz" in cube:
        raise InputError(path, "a picture in colour", "a spectral cube")
    return cube


def read_picture(path: Path, declared: Declared = AS_STATED, *, finite: bool = True) -> xr.Dataset:
    """Cube, or picture in X, Y, Z, of a file.

    Parameters
    ----------
    path
        File of a cube or a picture in colour.
    declared
        Values that the file does not state.
    finite
        Whether values have to be finite.

    Returns
    -------
    xr.Dataset
        As ``read_cube``; of a picture in colour ``xyz`` (y, x, component), cd m^-2.

    Raises
    ------
    InputError
        If the file is missing or invalid, or leaves open what it holds.
    """
    path = _header_of(required_path("path", path, "a file of a cube or picture"))
    with np.errstate(invalid="ignore"):  # a pixel that is not a number stays one
        picture = _format_of(path).read(path, declared)
    if "xyz" not in picture:
        require_cube(picture, path)
        require_wavelengths_of_light(picture, path)
    require_numbers(picture, path, finite=finite)
    require_light(picture, path)
    negative = negative_pixels(picture)
    return with_notes(picture, [f"pixels of negative radiance: {negative}"] if negative else [])


@contextmanager
def open_cube(path: Path, declared: Declared = AS_STATED) -> Iterator[xr.Dataset]:
    """Cube of a file; NetCDF and ENVI are read on demand.

    Parameters
    ----------
    path
        File of a cube.
    declared
        Values that the file does not state.

    Yields
    ------
    xr.Dataset
        As ``read_cube``; of a NetCDF file it may be coefficients of a spectral basis (``spectral_basis``).

    Raises
    ------
    InputError
        As ``read_cube``.
    """
    path = _header_of(required_path("path", path, "a file of a cube"))
    form = _format_of(path)
    if form.open is None:
        yield read_cube(path, declared)
        return
    with form.open(path, declared) as cube:
        require_stored(cube, path)
        require_wavelengths_of_light(cube, path)
        yield cube


def _header_of(path: Path) -> Path:
    """The header of a file of samples of ENVI; for another file, this file."""
    if path.suffix.lower() in READABLE or not path.name:
        return path
    headers = (path.with_suffix(".hdr"), Path(f"{path}.hdr"))
    return next((header for header in headers if header.is_file() and is_envi(header)), path)


def _format_of(path: Path) -> CubeFormat:
    """Format of a file. Raises InputError for a missing file, and for another format."""
    forms = [form for form in FORMATS if form.ending == path.suffix.lower()]
    if not forms:
        kind = other_format(path)
        hint = f"It is {kind}." if kind else ""
        raise InputError(path, f"the ending '{path.suffix}'", f"one of {', '.join(READABLE)}", hint)
    require_regular_file(path, "a spectral cube")
    try:
        match = next((form for form in forms if form.recognises(path)), None)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be read") from None
    if match is None:
        raise InputError(path, "no 'ENVI' and no '#?' at its beginning", "an ENVI header or a Radiance picture")
    return match
