"""OpenEXR files of bands with free names, as of ``specfilm``, or with wavelengths as names."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError

from .cube_checks import as_cube
from .declared import Declared, scaled, sorted_planes, spectral_factor, with_declarations
from .exr_channels import ExrChannels
from .headers import listed, require_one_layer

__all__ = ["cube_of_bands"]

#: What to do about the unit of Mitsuba's bands.
_SCALE_HINT = (
    "Mitsuba's specfilm integrates over each response: the scale to that unit is 1 over the response's width in nm, "
    "where the scene's spectra are in it."
)
#: Name of a channel that is a wavelength with its unit, such as ``500nm`` or ``547,5 nm``.
_WAVELENGTH_NAME = re.compile(r"([0-9]{3,4}(?:[.,][0-9]+)?) ?nm", re.IGNORECASE)


def cube_of_bands(path: Path, channels: ExrChannels, declared: Declared) -> xr.Dataset:
    """Spectral cube of the channels, in the order of the numbers in their names.

    Names that are wavelengths in nm give the wavelengths, where none are declared.

    Parameters
    ----------
    path
        File, for messages.
    channels
        Its channels; one named A (alpha) is left out.
    declared
        Units, scale and the wavelength of each channel.

    Returns
    -------
    xr.Dataset
        Radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1, ascending in wavelength.

    Raises
    ------
    InputError
        If wavelengths or units are not declared, if the wavelengths are not one for each channel, and for several
        layers of channels, such as AOVs.
    """
    names = sorted((name for name in channels.planes if name != "A"), key=_natural)
    software = str(channels.header.get("generatedBy") or channels.header.get("software") or "")
    wavelength_nm = declared.wavelengths_nm or _named_wavelengths(names)
    if wavelength_nm is None or len(wavelength_nm) != len(names):
        require_one_layer(path, list(channels.planes), software)
    if wavelength_nm is None:
        raise InputError(
            path,
            f"the channels {listed(names)}, which name no wavelength",
            "emissive spectra such as 'S0.550,000000nm', wavelengths such as 550nm, R, G, B, or X, Y, Z",
            "declare wavelengths=400:700:20.",
        )
    if len(wavelength_nm) != len(names):
        count_text = f"{len(wavelength_nm)} wavelengths"
        raise InputError(
            "declared wavelengths", count_text, f"{len(names)}, for the channels {listed(names)} of {path}"
        )
    factor = spectral_factor(path, None, declared, _SCALE_HINT)
    planes, grid = sorted_planes(
        path, np.stack([channels.planes[name] for name in names], axis=-1), np.array(wavelength_nm)
    )
    first, last = names[0], names[-1]
    note = f"channel {first} is {wavelength_nm[0]:g} nm, {last} is {wavelength_nm[-1]:g} nm"
    cube = as_cube(scaled(planes, factor), grid)
    return with_declarations(cube, declared, ("units", "scale", "wavelengths_nm"), [note])


def _named_wavelengths(names: list[str]) -> tuple[float, ...] | None:
    """Wavelength of each name, nm; None where a name is none."""
    matches = [_WAVELENGTH_NAME.fullmatch(name) for name in names]
    return tuple(float(match[1].replace(",", ".")) for match in matches if match) if all(matches) else None


def _natural(name: str) -> list[tuple[int, str]]:
    """Key of an order in which band2 precedes band10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"([0-9]+)", name)]
