"""Vignetting: a radial fall-off that the flat field did not show.

L' = L (1 - e r^2), r the distance from the image's centre over that of a corner pixel's centre. It acts on frames of
the scene only. The cause is a flat field that was taken at another aperture or focus, or without the hood. Where a
camera corrects its fall-off itself, flats correct it twice: e is negative.

Parameters: edge_loss e, without unit, null value 0.
Source: first term of an even polynomial in r; no publication.
"""

from __future__ import annotations

import numpy as np

from ..chain import Light
from .effect import Effect, Parameter

__all__ = ["EFFECT"]

#: Largest part of the corner's light that a fall-off takes: darker pixels of a flat are left out of all results.
_LARGEST_LOSS = 0.9


def _apply(light: Light, edge_loss: float) -> Light:
    """Light with the fall-off; r runs to the pixels' centres and is 1 at that of a corner pixel."""
    height, width = light.signal.shape[1:]
    y, x = np.arange(height) - (height - 1) / 2, np.arange(width) - (width - 1) / 2
    square = y[:, None] ** 2 + x**2
    return light.with_signal(light.signal * (1 - edge_loss * square / square.max()))


EFFECT = Effect(
    id="vignetting",
    stage="optics",
    title="a fall-off that the flat field did not show",
    in_words="the image's corner loses {edge_loss:.2%} of its light",
    summary="Frames of the scene fall off by 1 - edge_loss r^2, r = 1 in the image's corner. The flat field does not "
    "show it: it was taken at another aperture or focus, or without the hood.",
    # such a fall-off that flats and camera both correct leaves the inverse factor
    parameters=(Parameter("edge_loss", "1", null=0.0, low=1 - 1 / (1 - _LARGEST_LOSS), high=_LARGEST_LOSS, step=5e-3),),
    apply=_apply,
    confirm="Take the flat field again with the aperture, focus and hood of the scene's frames. A loss below 0 means "
    "that the camera or a program had corrected them before: switch that off, or leave the flats out.",
)
