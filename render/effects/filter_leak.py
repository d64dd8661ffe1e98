"""Filter leak: filters pass some light out of their band.

T' = T + f (Tmax - T), with T the transmittance of a filter and Tmax its largest value on the curves' grid. It acts on
flats and reference too. The cause is incomplete blocking of an interference filter.

Parameters: fraction f, without unit, null value 0.
Source: linear mixture of the pass band and a constant; no publication.
"""

from __future__ import annotations

from dataclasses import replace

from ..chain import BandCurves
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(curves: BandCurves, fraction: float) -> BandCurves:
    """Curves with the leak added; Tmax is each filter's largest value on the curves' grid."""
    highest = curves.transmittance.max(axis=-1, keepdims=True)
    return replace(curves, transmittance=curves.transmittance + fraction * (highest - curves.transmittance))


EFFECT = Effect(
    id="filter-leak",
    stage="filter",
    title="filters pass light out of their band",
    summary="Filters pass some light out of their band: T + f Tmax (1 - T / Tmax). Flats and reference are included.",
    parameters=(Parameter("fraction", "1", null=0.0, low=0.0, high=0.5, step=1e-3),),
    apply=_apply,
    confirm="Stack two filters of different bands before the camera: the light that passes is leak. Or add a sharp "
    "cut-off filter to one band, or measure the filters over the detector's whole range.",
)
