"""Spectral OpenEXR (layout of Fichet, Pacanowski and Wilkie, JCGT 10(3), 2021): one channel for each wavelength."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from .cube_checks import PROVENANCE, RADIANCE_UNIT, as_cube, float32_samples
from .declared import AS_STATED, Declared, scaled, sorted_planes, spectral_factor, told
from .exr_channels import ExrChannels, write_channels
from .previews import cube_to_linear_srgb

__all__ = ["cube_of_spectral_channels", "spectral_channels", "write_exr"]

_CHANNEL = re.compile(r"S0\.(\d+(?:,\d*)?|,\d+)([eE][+-]?\d+)?(nm|um|m)")
_METRES_PER_NM = {"nm": 1.0, "um": 1e3, "m": 1e9}
_UNIT = "W.m^-2.sr^-1.nm^-1"
#: The programs of the layout's authors write this unit also for samples per nm.
_PER_BAND = "W.m^-2.sr^-1"


def write_exr(path: Path, cube: xr.Dataset) -> None:
    """Write the radiance as float32, with channels R, G, B as a preview."""
    samples, picture = float32_samples(cube), cube_to_linear_srgb(cube)
    channels = {name: np.ascontiguousarray(picture[..., i], np.float32) for i, name in enumerate("RGB")}
    for index, wavelength in enumerate(cube["wavelength"].values):
        # A decimal comma, since the dot separates layers in OpenEXR.
        name = f"S0.{wavelength:.6f}nm".replace(".", ",").replace("S0,", "S0.")
        channels[name] = np.ascontiguousarray(samples[..., index])
    header = {"spectralLayoutVersion": "1.0", "emissiveUnits": _UNIT}
    if "missing" in cube.attrs:
        header["missing"] = cube.attrs["missing"]
    header |= {name: str(cube.attrs[name]) for name in PROVENANCE if name in cube.attrs}
    write_channels(path, header, channels)


def spectral_channels(names: Iterable[str]) -> dict[str, float]:
    """Wavelengths in nm of the channels that hold emissive spectra, by name."""
    return {name: _nanometres(match) for name in names if (match := _CHANNEL.fullmatch(name))}


def cube_of_spectral_channels(path: Path, channels: ExrChannels, declared: Declared = AS_STATED) -> xr.Dataset:
    """The cube in memory. Raises InputError for wavelengths twice, and for other units."""
    wavelengths = spectral_channels(channels.planes)
    planes = np.stack([channels.planes[name] for name in wavelengths], axis=-1)
    planes, grid = sorted_planes(path, planes, np.array(list(wavelengths.values())))
    header, notes = channels.header, []
    stated = header.get("emissiveUnits")
    if stated == _PER_BAND:
        notes.append(f"emissiveUnits '{stated}' is read as per nm, as the layout's authors write it")
        stated = RADIANCE_UNIT
    factor = spectral_factor(f"{path}: emissiveUnits", stated, declared)
    left = sorted(set(channels.planes) - set(wavelengths) - {"R", "G", "B", "A"})
    if left:
        notes.append(f"channels that are not emissive spectra are left out: {', '.join(left[:8])}")
    cube = as_cube(scaled(planes, factor), grid, header.get("missing") == "NaN")
    cube = cube.assign_attrs({name: header[name] for name in PROVENANCE if isinstance(header.get(name), str)})
    if stated is None:
        return told(cube, declared, ("units", "scale"), notes)
    return told(cube, declared, (), notes, {"units": stated})


def _nanometres(match: re.Match[str]) -> float:
    number = float(match[1].replace(",", ".") + (match[2] or ""))
    return number * _METRES_PER_NM[match[3]]
