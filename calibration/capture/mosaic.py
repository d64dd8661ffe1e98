"""Sensors with a colour filter array: which pixels belong to which channel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .capture import Capture
from .manifest import BandTable

__all__ = ["band_channels", "brighter_channel_notes", "channel_mask"]

#: Wavelength at which the blue and green sensitivities of common colour filter arrays cross, nm.
_BLUE_TO_GREEN_NM = 490.0
#: Wavelength at which their green and red sensitivities cross, nm.
_GREEN_TO_RED_NM = 580.0


def channel_mask(pattern: str, shape: tuple[int, int], channel: str) -> NDArray[np.bool_]:
    """Pixels of one channel of a mosaic.

    Parameters
    ----------
    pattern
        Letters of the upper left 2 x 2 pixels, row by row, such as "GBRG".
    shape
        (height, width) of the frame, px.
    channel
        "R", "G" or "B".

    Returns
    -------
    NDArray
        (y, x) True where the mosaic has the channel.

    Raises
    ------
    ValueError
        If the channel is not in the pattern.
    """
    if channel not in pattern:
        raise ValueError(f"channel '{channel}' is not in the pattern '{pattern}'")
    cell = np.array([letter == channel for letter in pattern]).reshape(2, 2)
    height, width = shape
    return np.tile(cell, ((height + 1) // 2, (width + 1) // 2))[:height, :width]


def band_channels(capture: Capture) -> dict[str, str] | None:
    """The channel used for each band.

    With stated quantum efficiencies it is the channel with the largest response within the filter's pass band. Without
    them it is the channel that usually passes the filter's peak: B below 490 nm, R above 580 nm, G between. Without a
    transmittance it is the channel with the largest mean count. The brightest channel is not always the right one:
    light outside the pass band and crosstalk can make another channel brighter.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    dict | None
        By band identifier, "R", "G" or "B"; None without a mosaic.
    """
    if capture.manifest.mosaic is None:
        return None
    pattern = capture.manifest.mosaic.pattern
    return {band.id: _band_channel(capture, band, pattern) for band in capture.manifest.band}


def _band_channel(capture: Capture, band: BandTable, pattern: str) -> str:
    if band.transmittance is None:
        return _brightest_channel(capture, band, pattern)
    filter_curve = capture.light(band.transmittance)
    if capture.manifest.camera.quantum_efficiency is not None:
        grid = filter_curve.wavelength_nm

        def in_band(channel: str) -> float:
            efficiency = capture.quantum_efficiency(channel)
            return 0.0 if efficiency is None else float(np.sum(efficiency.at(grid) * filter_curve.values))

        return max("RGB", key=in_band)
    peak = filter_curve.wavelength_nm[np.argmax(filter_curve.values)]
    return "B" if peak < _BLUE_TO_GREEN_NM else "R" if peak > _GREEN_TO_RED_NM else "G"


def _brightest_channel(capture: Capture, band: BandTable, pattern: str) -> str:
    """The channel with the largest mean count in the band's frames."""
    frame = capture.frames(band).mean(axis=0)
    return max("RGB", key=lambda channel: frame[channel_mask(pattern, capture.shape, channel)].mean())


def brighter_channel_notes(capture: Capture, channels: Mapping[str, str] | None) -> list[str]:
    """Notes on bands in which another channel is brighter than the one used.

    Parameters
    ----------
    capture
        The capture.
    channels
        By band identifier, the channel used; None without a mosaic.

    Returns
    -------
    list
        One sentence per such band; empty without a mosaic.
    """
    mosaic = capture.manifest.mosaic
    if channels is None or mosaic is None:
        return []
    notes = []
    for band in capture.manifest.band:
        brightest = _brightest_channel(capture, band, mosaic.pattern)
        if brightest != channels[band.id]:
            notes.append(
                f"{band.id}: channel {brightest} is brighter than the channel used, {channels[band.id]}: "
                "the frames contain light from outside the pass band"
            )
    return notes
