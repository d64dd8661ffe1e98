"""Pictures in X, Y, Z: from OpenEXR files with channels X, Y, Z or R, G, B of a stated colour space.

A picture is a Dataset with ``xyz`` (y, x, component), CIE 1931, in cd m^-2. Where its file stores it in coarse steps
it also has ``rounding`` and ``rounding_shared`` of the same shape: the standard deviation that comes from them, and its
part that neighbouring pixels share.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

from .declared import PHOTOMETRIC_UNIT, Declared, photometric_factor, with_declarations
from .exr_channels import ExrChannels

__all__ = [
    "COLOUR_SPACES",
    "as_xyz_picture",
    "colour_channels",
    "picture_of_colours",
    "primaries_matrix",
    "space_matrix",
    "stated_space",
    "with_rounding",
]

#: By the name that ``Declared`` takes: (x, y) of red, green, blue and white. ITU-R BT.709 and BT.2020, SMPTE
#: RP 431-2 with D65, SMPTE ST 2065-1 (ACES) and its AP1, and Radiance's own (G. Ward, "Real Pixels", 1991).
COLOUR_SPACES = {
    "rec709": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "p3-d65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "aces": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767),
    "acescg": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "radiance": (0.640, 0.330, 0.290, 0.600, 0.150, 0.060, 1 / 3, 1 / 3),
}
_MITSUBA = (
    "Mitsuba's spectral variants divide by 106.857, the integral of the CIE's y: the scale is 72983 where "
    "the scene's spectra are in W m^-2 sr^-1 nm^-1."
)
#: Within which primaries of files are those of a known space; known spaces differ by more.
_PRIMARIES_DIGITS = 6e-4
_XYZ, _RGB = ("X", "Y", "Z"), ("R", "G", "B")


def colour_channels(names: set[str]) -> tuple[str, ...] | None:
    """The three channels of a file that holds a colour picture and nothing else; None for other files."""
    return next((three for three in (_XYZ, _RGB) if names - {"A"} == set(three)), None)


def primaries_matrix(chromaticities: ArrayLike) -> NDArray[np.float64]:
    """(3, 3) from R, G, B to X, Y, Z; white (1, 1, 1) has Y = 1. chromaticities : x, y of red, green, blue, white.

    Raises InputError for primaries on a line.
    """
    x, y = np.asarray(chromaticities, float).reshape(4, 2).T
    columns = np.stack([x, y, 1 - x - y])
    with np.errstate(divide="ignore", invalid="ignore"):
        white = columns[:, 3] / y[3]
    if not np.isfinite(white).all() or abs(np.linalg.det(columns[:, :3])) < 1e-6:
        raise InputError(
            "chromaticities",
            ", ".join(f"{v:g}" for v in np.ravel(chromaticities)),
            "primaries that span a triangle, and a white with y above 0",
        )
    return np.asarray(columns[:, :3] * np.linalg.solve(columns[:, :3], white))


def space_matrix(where: Path | str, declared: Declared, hint: str = "") -> NDArray[np.float64]:
    """The declared colour space's matrix. Raises InputError where none, or another, is declared."""
    known = ", ".join(COLOUR_SPACES)
    if declared.colour_space is None:
        raise InputError(
            where, "R, G, B of no stated colour space", f"one of {known}", f"declare colour-space=NAME. {hint}".strip()
        )
    if declared.colour_space not in COLOUR_SPACES:
        raise InputError("declared colour-space", f"'{declared.colour_space}'", f"one of {known}")
    return primaries_matrix(COLOUR_SPACES[declared.colour_space])


def stated_space(chromaticities: ArrayLike) -> str:
    """What a file's primaries are called: a known name, else their numbers. Files have them to 3 or 4 digits."""
    found = np.ravel(np.asarray(chromaticities, float))
    for name, known in COLOUR_SPACES.items():
        if np.allclose(found, known, rtol=0, atol=_PRIMARIES_DIGITS):
            return name
    return ", ".join(f"{value:g}" for value in found)


def as_xyz_picture(xyz: NDArray) -> xr.Dataset:
    """The dataset of X, Y, Z (y, x, 3) in cd m^-2."""
    values = (("y", "x", "component"), xyz, {"units": PHOTOMETRIC_UNIT})
    return xr.Dataset({"xyz": values}, coords={"component": list(_XYZ)})


def with_rounding(picture: xr.Dataset, sigma: NDArray, shared: NDArray) -> xr.Dataset:
    """The picture with standard deviations (y, x, 3) from the steps of its file. shared : by neighbouring pixels."""
    dims, units = ("y", "x", "component"), {"units": PHOTOMETRIC_UNIT}
    return picture.assign(rounding=(dims, sigma, units), rounding_shared=(dims, shared, units))


def picture_of_colours(path: Path, channels: ExrChannels, declared: Declared) -> xr.Dataset:
    """X, Y, Z of a file with these or R, G, B. The header's ``chromaticities`` and ``whiteLuminance`` count.

    Raises InputError where colour space or unit are missing.
    """
    three = colour_channels(set(channels.planes)) or _XYZ
    values = np.stack([channels.planes[name] for name in three], axis=-1).astype(np.float64)
    header, used, known = channels.header, [], dict[str, object]({"colour_space": "X, Y, Z"})
    if three == _RGB:
        stated = header.get("chromaticities")
        if stated is None:
            used.append("colour_space")
            matrix = space_matrix(path, declared)
        else:
            corners = np.concatenate(stated, axis=None)
            known["colour_space"], matrix = stated_space(corners), primaries_matrix(corners)
        values = values @ matrix.T
    white = header.get("whiteLuminance")
    if white is None:
        used += ["units", "scale"]
        hint = _MITSUBA if "Mitsuba" in str(header.get("generatedBy")) else ""
        factor = photometric_factor(path, None, declared, hint)
    else:
        factor = float(white)
        known |= {"units": PHOTOMETRIC_UNIT, "scale": factor}
    return with_declarations(as_xyz_picture(values * factor), declared, used, stated=known)
