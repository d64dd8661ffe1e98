"""Filter shift: pass bands of interference filters move to shorter wavelengths off the axis.

T'(lambda) = T(lambda / sqrt(1 - sin^2(theta) / n^2)), theta the field angle. It acts on flats and reference too. The
cause is the shorter optical path difference of oblique rays in the filter's layers. The effect grows with n^-2.

Parameters: effective_index n, without unit, null value infinity.
Source: Macleod, Thin-Film Optical Filters: the tilted narrow-band filter and its effective index.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..chain import BandCurves
from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(curves: BandCurves, effective_index: float) -> BandCurves:
    """Curves at every field angle, linear between the grid's wavelengths and 0 above the grid."""
    grid = curves.wavelength_nm
    shifted = np.empty_like(curves.transmittance)
    for angle, sine_squared in enumerate(curves.sine_squared):
        wavelength_at_normal_nm = grid / np.sqrt(1 - sine_squared / effective_index**2)
        for band, transmittance in enumerate(curves.transmittance[angle]):
            shifted[angle, band] = np.interp(wavelength_at_normal_nm, grid, transmittance, right=0.0)
    return replace(curves, transmittance=shifted)


EFFECT = Effect(
    id="filter-shift",
    stage="filter",
    title="pass bands shift towards the field's edge",
    summary="Pass bands move to shorter wavelengths off the axis: T(lambda / sqrt(1 - sin^2(theta) / n^2)), "
    "theta the field angle. Flats and reference are included. The effect grows with 1 / n^2.",
    parameters=(Parameter("effective_index", null=np.inf, low=1.05, step=0.05, scale="inverse square", example=2.0),),
    apply=_apply,
    confirm="Turn the filter against the optical axis and measure its pass band, or photograph a line "
    "source: its image fades towards the edge of the field in one band and grows in the next.",
    sources=("Macleod, Thin-Film Optical Filters: the tilted narrow-band filter and its effective index",),
)
