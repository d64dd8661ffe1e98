"""OpenEXR files of bands whose names do not tell their wavelengths, such as those of Mitsuba's ``specfilm``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.utils.errors import InputError

from .cube_checks import as_cube
from .declared import Declared, scaled, sorted_planes, spectral_factor, told
from .exr_channels import ExrChannels

__all__ = ["cube_of_bands"]


def cube_of_bands(path: Path, channels: ExrChannels, declared: Declared) -> xr.Dataset:
    """The cube in memory; declared wavelengths belong to the channels in the order of the numbers in their names.

    Raises InputError where wavelengths, units or one of a count are missing.
    """
    names = sorted((name for name in channels.planes if name != "A"), key=_natural)
    if declared.wavelengths_nm is None:
        raise InputError(
            path,
            f"the channels {_listed(names)}, which name no wavelength",
            "emissive spectra such as 'S0.550,000000nm', R, G, B, or X, Y, Z",
            "declare wavelengths=400:700:20.",
        )
    if len(declared.wavelengths_nm) != len(names):
        found = f"{len(declared.wavelengths_nm)} wavelengths"
        raise InputError("declared wavelengths", found, f"{len(names)}, for the channels {_listed(names)} of {path}")
    hint = (
        "Mitsuba's specfilm integrates over each response: the scale to that unit is 1 over the response's "
        "width in nm, where the scene's spectra are in it."
    )
    factor = spectral_factor(path, None, declared, hint)
    planes, grid = sorted_planes(
        path, np.stack([channels.planes[name] for name in names], axis=-1), np.array(declared.wavelengths_nm)
    )
    first, last = names[0], names[-1]
    note = f"channel {first} is {declared.wavelengths_nm[0]:g} nm, {last} is {declared.wavelengths_nm[-1]:g} nm"
    return told(as_cube(scaled(planes, factor), grid), declared, ("units", "scale", "wavelengths_nm"), [note])


def _natural(name: str) -> list[tuple[int, str]]:
    """band2 before band10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"([0-9]+)", name)]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:8]) + (f", ... ({len(names)} in all)" if len(names) > 8 else "")
