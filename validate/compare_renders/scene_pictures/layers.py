"""Layers of a renderer's file: the picture, and channels that describe surfaces.

The names are those of Cycles' passes, Mitsuba's AOVs, pbrt's G-buffers, and outputs of LuxCore, Arnold and V-Ray.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from cboxlab.rendering.files import layers_of, listed
from cboxlab.utils.errors import InputError

__all__ = ["guide_layers", "picture_layer"]

#: Last words of layers that hold the complete picture.
_PICTURES = ("combined", "composite", "beauty", "rgba", "rgb", "image", "color", "colour", "img", "final", "ci")
#: Channels of a picture in colour.
_RGB = frozenset("RGB")
#: Channels of a vector.
_VECTOR = frozenset("XYZ")
#: By kind of a guide: expression that the layer's last word matches in lower case, and the channels that it has.
_KINDS: dict[str, tuple[str, tuple[frozenset[str], ...]]] = {
    "albedo": (r"(denoising[ _]*)?(alb|albedo|base_?colou?r|diffcol|diffuse_?(colou?r|filter|albedo))", (_RGB,)),
    "normal": (r"(denoising[ _]*)?((sh|shading|geo|geometry)?[ _]*normals?|n|ns|nn|nrm|.*_n)", (_VECTOR, _RGB)),
    "depth": (r"(denoising[ _]*)?(depth|zdepth|z|dd|dist|distance)", tuple(map(frozenset, "ZTVYRD"))),
    "object": (r"(indexob|object|shape|instance|obj|idx|id)?[ _]*(index|id|idx)?", tuple(map(frozenset, "XIVYRU"))),
    "material": (r"(indexma|(material|mat)[ _]*(index|id|idx)?)", tuple(map(frozenset, "XIVYRU"))),
}


def picture_layer(path: Path, names: Sequence[str], declared: str | None) -> str | None:
    """Layer of channels R, G, B that is the picture.

    Parameters
    ----------
    path
        File, for messages.
    names
        Names of its channels.
    declared
        Layer that the user declares; None where not declared.

    Returns
    -------
    str or None
        The layer, empty for channels R, G, B themselves; None for a file without such channels.

    Raises
    ------
    InputError
        If the declared layer has no R, G, B, or if several layers may be the picture.
    """
    layers = layers_of(names)
    in_colour = sorted(layer for layer, channels in layers.items() if channels >= _RGB)
    if declared is not None:
        if declared not in in_colour:
            raise InputError(
                "declared layer", f"'{declared}'", f"a layer of {path} with R, G, B: {listed(in_colour) or 'none'}"
            )
        return declared
    if not in_colour or "" in in_colour:
        return "" if in_colour else None
    others = [n for n in in_colour if _kind(n, layers[n]) is None and "crypto" not in n.lower()]
    pictures = [layer for layer in others if _last_word(layer) in _PICTURES]
    candidates = pictures or others
    if len(candidates) == 1:
        return candidates[0]
    which = candidates or in_colour
    raise InputError(
        path, f"the layers {listed(which)}", "one picture", f"Declare which one it is: layer='{which[0]}'."
    )


def guide_layers(names: Sequence[str], picture: str) -> dict[str, tuple[str, ...]]:
    """Channels that describe surfaces.

    Parameters
    ----------
    names
        Names of all channels.
    picture
        Layer of the picture.

    Returns
    -------
    dict
        Names of channels by kind: "albedo", "normal", "depth", "object", "material". A kind that several layers have
        comes from the first in alphabetical order.
    """
    layers = layers_of([name for name in names if name.rpartition(".")[0] != picture])
    loose = layers_of([name for name in names if name.rpartition(".")[0] == picture])
    guides: dict[str, tuple[str, ...]] = {}
    for layer in sorted(layers):
        kind = _kind(layer, layers[layer])
        if kind is not None:
            order = "RGB" if layers[layer] >= _RGB else "".join(sorted(layers[layer] - {"A"}))
            guides.setdefault(kind, tuple(f"{layer}.{channel}" if layer else channel for channel in order))
    for channel in sorted(loose.get(picture, set()) - {"R", "G", "B", "A"}):
        kind = _kind(channel, {"V"})
        if kind is not None:
            guides.setdefault(kind, (f"{picture}.{channel}" if picture else channel,))
    return guides


def _last_word(layer: str) -> str:
    """Last part of a layer's name, in lower case."""
    return layer.rpartition(".")[2].lower()


def _kind(layer: str, channels: set[str]) -> str | None:
    """Kind of a guide; None for other layers."""
    word = _last_word(layer)
    for kind, (expression, allowed) in _KINDS.items():
        if word and re.fullmatch(expression, word) and any(channels - {"A"} == three for three in allowed):
            return kind
    # Mitsuba's AOVs bear a user's name, and a channel by kind; numbers of triangles are too fine
    if word.startswith("prim"):
        return None
    return {frozenset("T"): "depth", frozenset("I"): "object"}.get(frozenset(channels))
