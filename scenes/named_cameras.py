"""Spectral sensitivities of colour cameras by name, relative within each channel."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .spectra import Spectrum

__all__ = ["NAMED_CAMERA", "camera_columns", "camera_names", "named_camera_channel"]

#: Beginning of a reference to a named camera, where a file's name stands otherwise.
NAMED_CAMERA = "camera:"
#: Channels of the tables in their order.
_CHANNELS = "RGB"


@lru_cache(maxsize=1)
def camera_names() -> tuple[str, ...]:
    """Names of the cameras whose sensitivities colour-science carries.

    Returns
    -------
    tuple
        In alphabetical order.
    """
    from colour import MSDS_CAMERA_SENSITIVITIES

    return tuple(sorted(MSDS_CAMERA_SENSITIVITIES.keys()))


def camera_columns(name: str) -> dict[str, str] | None:
    """References to the channels of a camera.

    Parameters
    ----------
    name
        Name of the camera, in any case.

    Returns
    -------
    dict | None
        By channel "R", "G", "B", the reference that ``named_camera_channel`` reads; None for an unknown camera.
    """
    spelling = {camera.casefold(): camera for camera in camera_names()}.get(name.strip().casefold())
    return None if spelling is None else {letter: f"{NAMED_CAMERA}{spelling}:{letter}" for letter in _CHANNELS}


@lru_cache(maxsize=32)
def named_camera_channel(reference: str) -> Spectrum | None:
    """Quantum efficiency of a channel of a named camera, 1 at its peak.

    The tables hold signals for light of equal energy, each channel relative to its own peak. Over the wavelength they
    are signals for equal numbers of photons. The level of the channels relative to each other is not in them.

    Parameters
    ----------
    reference
        "camera:NAME:R".

    Returns
    -------
    Spectrum | None
        The curve, zero beyond its table; None for another reference and for an unknown camera or channel.
    """
    if not reference.startswith(NAMED_CAMERA):
        return None
    name, _, letter = reference.removeprefix(NAMED_CAMERA).rpartition(":")
    if name not in camera_names() or letter not in _CHANNELS:
        return None
    from colour import MSDS_CAMERA_SENSITIVITIES

    table = MSDS_CAMERA_SENSITIVITIES[name]
    wavelength = np.array(table.wavelengths, float)
    values = np.maximum(np.array(table.values, float)[:, _CHANNELS.index(letter)], 0.0) / wavelength
    return Spectrum(wavelength, values / values.max(), "zero")
