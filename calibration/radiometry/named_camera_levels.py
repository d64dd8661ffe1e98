"""Levels of a named camera's channels, from the references."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from cboxlab.scenes import NAMED_CAMERA

from ..capture import Capture
from .radiometry import Radiometry

__all__ = ["channel_levels", "level_notes"]


def _channel_columns(capture: Capture) -> dict[str, str]:
    """By letter, the reference to a channel of a named camera."""
    efficiency = capture.manifest.camera.quantum_efficiency
    columns = efficiency if isinstance(efficiency, dict) else {}
    return {letter: column for letter, column in columns.items() if column.startswith(NAMED_CAMERA)}


def channel_levels(capture: Capture, radiometry: Radiometry, channels: Mapping[str, str] | None) -> Mapping[str, float]:
    """Peak efficiency of each channel over that of the most sensitive one.

    A table whose channels are all 1 at their peaks makes the constant C differ from channel to channel. The constants'
    ratios are the ratios of the peaks.

    Parameters
    ----------
    capture
        The capture.
    radiometry
        The capture's constants for tables of peak 1.
    channels
        By band, the channel of a sensor with a mosaic; None without one.

    Returns
    -------
    Mapping
        By reference to the channel; empty without a named camera, and where a channel has no usable reference.
    """
    columns = _channel_columns(capture)
    constants: dict[str, list[float]] = {letter: [] for letter in columns}
    for measured in radiometry.by_band:
        letter = "" if channels is None else channels[measured.band][:1]
        if letter in constants:
            constants[letter].append(measured.constant)
    if not columns or not all(constants.values()):
        return {}
    levels = {letter: float(np.median(values)) for letter, values in constants.items()}
    highest = max(levels.values())
    return {columns[letter]: level / highest for letter, level in levels.items()} if highest > 0 else {}


def level_notes(capture: Capture) -> list[str]:
    """Note on the levels of a named camera's channels.

    Parameters
    ----------
    capture
        The capture, with ``channel_levels`` where they could be measured.

    Returns
    -------
    list
        One sentence; empty without a named camera.
    """
    columns = _channel_columns(capture)
    if not columns:
        return []
    name = next(iter(columns.values())).removeprefix(NAMED_CAMERA).rpartition(":")[0]
    beginning = f"the sensitivities of {name} are those that colour-science carries, relative within each channel"
    if not capture.channel_levels:
        return [f"{beginning}: without [[reference]] frames of every channel the channels' levels are unknown"]
    levels = ", ".join(f"{letter} {capture.channel_levels[column]:.3g}" for letter, column in columns.items())
    return [f"{beginning}: their levels come from the references ({levels})"]
