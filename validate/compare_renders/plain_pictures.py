"""Pictures without units and wavelengths: arrays of NumPy, TIFF of counts or floats, PFM."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from cboxlab.utils.limits import MAX_CUBE_VALUES, require_size
from numpy.typing import NDArray

from .scene_pictures import AS_STORED, PFM_ENDING, read_pfm

__all__ = ["PLAIN_ENDINGS", "read_plain"]

#: Endings of these files.
PLAIN_ENDINGS = (".npy", ".tif", ".tiff", PFM_ENDING)


def read_plain(path: Path) -> tuple[tuple[str, ...], NDArray[np.float64], list[str]]:
    """Planes of a picture whose numbers are taken as they are.

    Parameters
    ----------
    path
        The file: (y, x) or (y, x, plane) of .npy, pages or samples of a TIFF.

    Returns
    -------
    names : tuple of str
        R, G, B of a TIFF or PFM in colour; else the numbers of the planes, from 0.
    values : NDArray
        (plane, y, x), NaN where the file has no finite number.
    notes : list of str
        The number of these.

    Raises
    ------
    InputError
        If the file cannot be read, or holds other than real numbers in two or three dimensions. For integers of a
        colour TIFF and for 8 bits, which a curve has changed.
    """
    read = {".npy": _array, PFM_ENDING: _pfm}.get(path.suffix.lower(), _tiff)
    stored, in_colour = read(path)
    require_size(path, stored.size, MAX_CUBE_VALUES, "values")
    planes = np.asarray(stored if stored.ndim == 3 else stored[None], np.float64)
    lacking = ~np.isfinite(planes)
    notes = (
        [f"{path}: {int(lacking.sum())} of {lacking.size} values are not finite and left out"] if lacking.any() else []
    )
    names = tuple("RGB") if in_colour else tuple(str(k) for k in range(len(planes)))
    return names, np.where(lacking, np.nan, planes), notes


def _array(path: Path) -> tuple[NDArray, bool]:
    """Array of a .npy, its last axis first where it has three."""
    try:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        if "pickle" in str(error) or "Python" in str(error):
            hint = "Save the plain array: np.save(path, array)."
            raise InputError(
                path, "Python objects (pickle), which are not opened", "an array of numbers", hint
            ) from None
        raise InputError(path, f"a file that cannot be read ({error})", "an array of NumPy") from None
    if not isinstance(stored, np.ndarray) or stored.dtype.kind not in "fiu" or stored.ndim not in (2, 3):
        fault = f"{stored.dtype} of shape {stored.shape}" if isinstance(stored, np.ndarray) else "no array"
        raise InputError(path, fault, "real numbers (y, x) or (y, x, plane)")
    return (np.moveaxis(stored, -1, 0) if stored.ndim == 3 else stored), False


def _pfm(path: Path) -> tuple[NDArray, bool]:
    """Planes of a PFM, and whether they are R, G, B."""
    planes = read_pfm(path)
    return planes, len(planes) == len(AS_STORED)


def _tiff(path: Path) -> tuple[NDArray, bool]:
    """Pages or samples of a TIFF, planes first, and whether they are R, G, B."""
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            in_colour = page.photometric == tifffile.PHOTOMETRIC.RGB and page.samplesperpixel == 3
            stored = file.asarray()
            planar = page.planarconfig == tifffile.PLANARCONFIG.SEPARATE
    except Exception as error:  # tifffile raises exceptions of many types on damaged files
        raise InputError(path, f"a file that cannot be read ({error})", "a complete TIFF") from None
    if stored.dtype.kind not in "fiu" or stored.ndim not in (2, 3):
        raise InputError(
            path, f"{stored.dtype} of shape {stored.shape}", "real numbers, pages or samples of one picture"
        )
    if stored.dtype.kind in "iu" and (in_colour or stored.dtype.itemsize == 1):
        fault = f"{8 * stored.dtype.itemsize} bits{' in R, G, B' if in_colour else ''}, as a developed picture has"
        hint = "Develop it linearly, and save floats; a gamma curve such as sRGB is not undone."
        raise InputError(path, fault, "numbers linear in the light", hint)
    samples_last = stored.ndim == 3 and page.samplesperpixel > 1 and not planar
    return (np.moveaxis(stored, -1, 0) if samples_last else stored), in_colour
