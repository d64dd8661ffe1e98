"""Layers of channels in one OpenEXR file, such as Blender's passes and Mitsuba's AOVs.

A layer is what stands in front of the last dot of a channel's name: ``ViewLayer.Combined`` of
``ViewLayer.Combined.R`` ("Technical Introduction to OpenEXR", naming conventions).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from cboxlab.utils.errors import InputError

__all__ = ["layers_of", "listed", "one_layer_hint", "require_one_layer"]

#: Names that a message lists.
_MAX_NAMES = 8

_RGB = frozenset("RGB")


def listed(names: Sequence[str]) -> str:
    """Names with commas, of many the first eight and their number.

    Parameters
    ----------
    names
        Names of channels or layers.

    Returns
    -------
    str
        The list.
    """
    more = f", ... ({len(names)} in all)" if len(names) > _MAX_NAMES else ""
    return ", ".join(names[:_MAX_NAMES]) + more


def layers_of(names: Sequence[str]) -> dict[str, set[str]]:
    """Channels of each layer.

    Parameters
    ----------
    names
        Names of channels. A number after the last dot, as in ``band.1`` and ``400.5``, is no channel of a layer.

    Returns
    -------
    dict
        The last parts of the names by layer; by the empty text those without a layer.
    """
    layers: dict[str, set[str]] = {}
    for name in names:
        layer, _, channel = name.rpartition(".")
        if re.match(r"\d", channel):
            layer, channel = "", name
        layers.setdefault(layer, set()).add(channel)
    return layers


def one_layer_hint(layer: str, software: str) -> str:
    """Advice on how to save one layer as a picture.

    Parameters
    ----------
    layer
        Name of the layer in the file; empty for channels R, G, B themselves.
    software
        The header's entry on the program that wrote the file.

    Returns
    -------
    str
        A sentence.
    """
    dot = f"{layer}." if layer else ""
    advice = f"Save one layer alone, such as {dot}R, {dot}G, {dot}B as R, G, B"
    if software.startswith("Mitsuba"):
        return f"{advice}; in Mitsuba, render without the integrator 'aov'."
    return f"{advice}; in Blender, choose the file format OpenEXR in place of OpenEXR MultiLayer."


def require_one_layer(path: Path, names: Sequence[str], software: str = "") -> None:
    """Raise InputError for a picture among other channels, and for several layers.

    Parameters
    ----------
    path
        File, for the message.
    names
        Names of its channels.
    software
        The header's entry on the program that wrote the file.

    Raises
    ------
    InputError
        If a layer holds R, G and B, or there are several layers.
    """
    layers = layers_of([name for name in names if name != "A"])
    in_colour = [layer for layer, channels in layers.items() if channels >= _RGB]
    if not in_colour and len(layers) < 2:
        return
    picture = next((layer for layer in in_colour if not layer or layer.endswith("Combined")), "")
    picture = picture if picture in in_colour else next(iter(in_colour), "")
    description = f"the channels {listed(sorted(names))}"
    if len(layers) > 1:
        description = f"layers ({listed([layer or 'without a name' for layer in sorted(layers)])}) with {description}"
    raise InputError(
        path, description, "one picture: spectra, R, G, B, or X, Y, Z alone", one_layer_hint(picture, software)
    )
