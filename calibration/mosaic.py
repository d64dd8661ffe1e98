"""Sensors with a colour filter array: which pixels belong to which channel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .capture import Capture

__all__ = ["channel_mask", "strongest_channels"]


def channel_mask(pattern: str, shape: tuple[int, int], channel: str) -> NDArray[np.bool_]:
    """(y, x) True where the mosaic has ``channel`` ("R", "G" or "B").

    pattern : the four channels of the top-left 2 x 2 pixels, row by row, such as "GBRG".
    """
    if channel not in pattern:
        raise ValueError(f"channel '{channel}' is not in the pattern '{pattern}'")
    cell = np.array([letter == channel for letter in pattern]).reshape(2, 2)
    height, width = shape
    return np.tile(cell, ((height + 1) // 2, (width + 1) // 2))[:height, :width]


def strongest_channels(capture: Capture) -> dict[str, str] | None:
    """By band, the channel with the largest mean count in the band's own frames; None without a mosaic.

    The weaker channels see a narrow band mostly through leaks of their filter and the crosstalk of
    brighter neighbours, so that they answer less linearly.
    """
    mosaic = capture.manifest.mosaic
    if mosaic is None:
        return None
    masks = {channel: channel_mask(mosaic.pattern, capture.shape, channel) for channel in "RGB"}
    strongest = {}
    for band in capture.manifest.band:
        frame = capture.frames(band).mean(axis=0)
        strongest[band.id] = max(masks, key=lambda channel: frame[masks[channel]].mean())
    return strongest
