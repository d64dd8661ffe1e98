"""Lamp drift: the lamp's power drifts over the sequence.

S' = S (1 + d m), with S the signal above dark of a band. m are the minutes from the start of the first frame to the
middle of that band's frames. Flats and reference are lit by another source and stay. The cause is warming up or ageing.

Parameters: per_minute d, min^-1, null value 0.
Source: linear drift; no publication.
"""

from __future__ import annotations

from dataclasses import replace

from ..chain import Counts
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(counts: Counts, per_minute: float) -> Counts:
    """Counts with each band's scene scaled; flats and reference are lit by another source."""
    dark = counts.dark_scene[:, None, None]
    power = (1 + per_minute * counts.minutes)[:, None, None]
    return replace(counts, scene=dark + power * (counts.scene - dark))


EFFECT = Effect(
    id="lamp-drift",
    stage="counts",
    title="the lamp's power drifts over the sequence",
    in_words="the lamp's power changes by {per_minute:+.3%} a minute",
    summary="The lamp's power drifts as 1 + per_minute times the minutes since the first frame began, taken at the "
    "middle of each band's frames.",
    parameters=(Parameter("per_minute", "min^-1", null=0.0, low=-0.1, high=0.1, step=1e-3),),
    apply=_apply,
    own_to_capture=True,
    confirm="Take the first band once more at the end of the sequence, or log the lamp with a photodiode.",
)
