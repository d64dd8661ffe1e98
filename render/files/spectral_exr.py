"""Spectral OpenEXR: one channel for each wavelength.

Layout of Fichet, Pacanowski and Wilkie, JCGT 10(3), 2021.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from .cube_checks import PROVENANCE, RADIANCE_UNIT, as_cube, float32_samples
from .declared import AS_STATED, Declared, scaled, sorted_planes, spectral_factor, with_declarations
from .exr_channels import ExrChannels, write_channels
from .headers import exr_window, window_of

__all__ = ["cube_of_spectral_channels", "spectral_channels", "write_exr"]

#: Name of a channel of emissive spectra: wavelength with a decimal comma, and its unit.
_CHANNEL = re.compile(r"S0\.(\d+(?:,\d*)?|,\d+)([eE][+-]?\d+)?(nm|um|m)")

#: Nanometres per unit of a channel's wavelength.
_NM_PER_UNIT = {"nm": 1.0, "um": 1e3, "m": 1e9}

#: W m^-2 sr^-1 nm^-1 as the layout spells it.
_UNIT = "W.m^-2.sr^-1.nm^-1"

#: Unit of a band's radiance: the programs of the layout's authors write it also for samples per nm.
_PER_BAND = "W.m^-2.sr^-1"


def write_exr(path: Path, cube: xr.Dataset) -> None:
    """Write the radiance as float32, with channels R, G, B as a preview.

    Parameters
    ----------
    path
        File to write.
    cube
        Radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1. Where it comes from (``PROVENANCE``) and its place in a larger
        picture go into the header.
    """
    from .previews import cube_to_linear_srgb  # slow to import, and only needed here

    samples, picture = float32_samples(cube), cube_to_linear_srgb(cube)
    channels = {name: np.ascontiguousarray(picture[..., i], np.float32) for i, name in enumerate("RGB")}
    for index, wavelength in enumerate(cube["wavelength"].values):
        # A decimal comma, since the dot separates layers in OpenEXR.
        name = f"S0.{wavelength:.6f}nm".replace(".", ",").replace("S0,", "S0.")
        channels[name] = np.ascontiguousarray(samples[..., index])
    header: dict[str, object] = {"spectralLayoutVersion": "1.0", "emissiveUnits": _UNIT}
    if "missing" in cube.attrs:
        header["missing"] = cube.attrs["missing"]
    header |= {name: str(cube.attrs[name]) for name in PROVENANCE if name in cube.attrs}
    if (window := window_of(cube)) is not None:
        header |= exr_window(window)
    write_channels(path, header, channels)


def spectral_channels(names: Iterable[str]) -> dict[str, float]:
    """Wavelengths of the channels that hold emissive spectra.

    Parameters
    ----------
    names
        Names of channels.

    Returns
    -------
    dict
        nm by name; without the names of other channels.
    """
    return {name: _nanometres(match) for name in names if (match := _CHANNEL.fullmatch(name))}


def cube_of_spectral_channels(path: Path, channels: ExrChannels, declared: Declared = AS_STATED) -> xr.Dataset:
    """Spectral cube of the channels of emissive spectra.

    Parameters
    ----------
    path
        File, for messages.
    channels
        Its channels; others than emissive spectra are left out, with a note unless they are R, G, B or A.
    declared
        Units and scale, where the header lacks ``emissiveUnits``.

    Returns
    -------
    xr.Dataset
        Radiance (y, x, wavelength), W m^-2 sr^-1 nm^-1, ascending in wavelength.

    Raises
    ------
    InputError
        If a wavelength occurs twice, or the unit is missing or none of spectral radiance.
    """
    wavelengths = spectral_channels(channels.planes)
    planes = np.stack([channels.planes[name] for name in wavelengths], axis=-1)
    planes, grid = sorted_planes(path, planes, np.array(list(wavelengths.values())))
    header, notes = channels.header, []
    file_unit = header.get("emissiveUnits")
    if file_unit == _PER_BAND:
        notes.append(f"emissiveUnits '{file_unit}' is read as per nm, as the layout's authors write it")
        file_unit = RADIANCE_UNIT
    factor = spectral_factor(f"{path}: emissiveUnits", file_unit, declared)
    others = sorted(set(channels.planes) - set(wavelengths) - {"R", "G", "B", "A"})
    if others:
        notes.append(f"channels that are not emissive spectra are left out: {', '.join(others[:8])}")
    cube = as_cube(scaled(planes, factor), grid, header.get("missing") == "NaN")
    cube = cube.assign_attrs({name: header[name] for name in PROVENANCE if isinstance(header.get(name), str)})
    if file_unit is None:
        return with_declarations(cube, declared, ("units", "scale"), notes)
    return with_declarations(cube, declared, (), notes, {"units": file_unit})


def _nanometres(match: re.Match[str]) -> float:
    """Wavelength of a channel's name, nm."""
    number = float(match[1].replace(",", ".") + (match[2] or ""))
    return number * _NM_PER_UNIT[match[3]]
