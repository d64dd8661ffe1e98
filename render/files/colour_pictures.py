"""Pictures in X, Y, Z, from channels X, Y, Z or R, G, B of a stated colour space.

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

#: Hint on the scale of Mitsuba's spectral variants.
_MITSUBA_HINT = (
    "Mitsuba's spectral variants divide by 106.857, the integral of the CIE's y: the scale is 72983 where "
    "the scene's spectra are in W m^-2 sr^-1 nm^-1."
)

#: Largest difference of a file's primaries from those of a named space; the spaces differ by more.
_PRIMARIES_DIGITS = 6e-4

#: Channels of pictures in colour.
_XYZ = ("X", "Y", "Z")
_RGB = ("R", "G", "B")


def colour_channels(names: set[str]) -> tuple[str, ...] | None:
    """Channels of a colour picture.

    Parameters
    ----------
    names
        All channels of a file.

    Returns
    -------
    tuple of str or None
        X, Y, Z or R, G, B; None for a file that holds other channels too, except A.
    """
    return next((three for three in (_XYZ, _RGB) if names - {"A"} == set(three)), None)


def primaries_matrix(chromaticities: ArrayLike) -> NDArray[np.float64]:
    """Matrix from R, G, B to X, Y, Z; white (1, 1, 1) has Y = 1.

    Parameters
    ----------
    chromaticities
        x, y of red, green, blue and white: eight numbers, or (4, 2).

    Returns
    -------
    NDArray
        (3, 3) matrix.

    Raises
    ------
    InputError
        If the primaries lie on a line, or the white has y = 0.
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
    """Matrix of the declared colour space.

    Parameters
    ----------
    where
        File, for the message.
    declared
        Declarations for the file.
    hint
        Further advice where none is declared.

    Returns
    -------
    NDArray
        (3, 3) from R, G, B to X, Y, Z.

    Raises
    ------
    InputError
        If no space, or an unknown one, is declared.
    """
    names = ", ".join(COLOUR_SPACES)
    if declared.colour_space is None:
        raise InputError(
            where, "R, G, B of no stated colour space", f"one of {names}", f"declare colour-space=NAME. {hint}".strip()
        )
    if declared.colour_space not in COLOUR_SPACES:
        raise InputError("declared colour-space", f"'{declared.colour_space}'", f"one of {names}")
    return primaries_matrix(COLOUR_SPACES[declared.colour_space])


def stated_space(chromaticities: ArrayLike) -> str:
    """Name of a file's primaries; their numbers where no named space has them.

    Parameters
    ----------
    chromaticities
        x, y of red, green, blue and white. Files have them to 3 or 4 digits.

    Returns
    -------
    str
        Key of COLOUR_SPACES, or the eight numbers.
    """
    numbers = np.ravel(np.asarray(chromaticities, float))
    for name, primaries in COLOUR_SPACES.items():
        if np.allclose(numbers, primaries, rtol=0, atol=_PRIMARIES_DIGITS):
            return name
    return ", ".join(f"{value:g}" for value in numbers)


def as_xyz_picture(xyz: NDArray) -> xr.Dataset:
    """Dataset of a picture in colour.

    Parameters
    ----------
    xyz
        (y, x, 3) X, Y, Z, cd m^-2.

    Returns
    -------
    xr.Dataset
        ``xyz`` over y, x, component.
    """
    values = (("y", "x", "component"), xyz, {"units": PHOTOMETRIC_UNIT})
    return xr.Dataset({"xyz": values}, coords={"component": list(_XYZ)})


def with_rounding(picture: xr.Dataset, sigma: NDArray, shared: NDArray) -> xr.Dataset:
    """Picture with standard deviations from the steps of its file.

    Parameters
    ----------
    picture
        Picture in colour.
    sigma
        (y, x, 3) standard deviation of each value, cd m^-2.
    shared
        (y, x, 3) its part that neighbouring pixels share, cd m^-2.

    Returns
    -------
    xr.Dataset
        The picture with ``rounding`` and ``rounding_shared``.
    """
    dims, units = ("y", "x", "component"), {"units": PHOTOMETRIC_UNIT}
    return picture.assign(rounding=(dims, sigma, units), rounding_shared=(dims, shared, units))


def picture_of_colours(path: Path, channels: ExrChannels, declared: Declared) -> xr.Dataset:
    """Picture in X, Y, Z of the channels of a file.

    The header's ``chromaticities`` and ``whiteLuminance`` count.

    Parameters
    ----------
    path
        File, for messages.
    channels
        Its channels X, Y, Z or R, G, B.
    declared
        Colour space, units and scale, where the header does not state them.

    Returns
    -------
    xr.Dataset
        ``xyz`` (y, x, component), cd m^-2.

    Raises
    ------
    InputError
        If colour space or unit are neither stated nor declared.
    """
    three = colour_channels(set(channels.planes)) or _XYZ
    values = np.stack([channels.planes[name] for name in three], axis=-1).astype(np.float64)
    header, used, of_file = channels.header, [], dict[str, object]({"colour_space": "X, Y, Z"})
    if three == _RGB:
        primaries = header.get("chromaticities")
        if primaries is None:
            used.append("colour_space")
            matrix = space_matrix(path, declared)
        else:
            corners = np.concatenate(primaries, axis=None)
            of_file["colour_space"], matrix = stated_space(corners), primaries_matrix(corners)
        values = values @ matrix.T
    white = header.get("whiteLuminance")
    if white is None:
        used += ["units", "scale"]
        hint = _MITSUBA_HINT if "Mitsuba" in str(header.get("generatedBy")) else ""
        factor = photometric_factor(path, None, declared, hint)
    else:
        factor = float(white)
        of_file |= {"units": PHOTOMETRIC_UNIT, "scale": factor}
    return with_declarations(as_xyz_picture(values * factor), declared, used, file_values=of_file)
