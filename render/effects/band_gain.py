"""Band gain: one band's throughput differs from its tables.

The signal S above dark of one band becomes scale S, in frames of the scene only: DN' = D + scale (DN - D), D the dark
level. Causes are a dirty or aged filter, the lens, and the detector's quantum efficiency.

Parameters: band, name of the band; scale, without unit, null value 1.
Source: definition of throughput.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import Counts
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

#: Bands of the published box's captures; other captures name their bands otherwise.
_BANDS = ("f400", "f450", "f500", "f550", "f600", "f650", "f700")


def _apply(counts: Counts, band: str, scale: float) -> Counts:
    """Counts with one band's signal above dark scaled; InputError for an unknown band."""
    factor = np.ones((len(counts.bands), 1, 1))
    factor[index_of(band, counts.bands, "band-gain: band")] = scale
    dark = counts.dark_scene[:, None, None]
    return replace(counts, scene=dark + factor * (counts.scene - dark))


EFFECT = Effect(
    id="band-gain",
    stage="counts",
    title="one band's throughput differs from its tables",
    in_words="the throughput of {band} is {scale:.2%} of that of its tables",
    summary="One band's throughput (filter, lens or quantum efficiency) differs from its tables. "
    "In frames of the scene, its signal above dark is multiplied by scale.",
    parameters=(
        Parameter("band", choices=_BANDS, kind="band", example="f550"),
        Parameter("scale", "1", null=1.0, low=0.1, high=10.0, step=1e-2),
    ),
    apply=_apply,
    confirm="Take reference frames through this band directly before and after the scene. Then clean the filter "
    "and take both again.",
)
