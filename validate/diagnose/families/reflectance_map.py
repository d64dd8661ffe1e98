"""Uneven reflectance: a smooth map on one surface, a stain, another paint that shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    OTHER_SIGN,
    PENALTY_ODD,
    PENALTY_UNLIKELY,
    Advice,
    Columns,
    Family,
    FitInput,
    FittedExplanation,
    SpotAppearance,
    SurfaceSpot,
    change_dn,
    darker_part,
    equations_in_all_bands,
    fixed_spectrum,
    free_spectrum,
    scaled,
)

__all__ = ["FAMILY"]

#: Least difference of the change of reflectance between bands, relative to the largest, by which a paint is recognised.
_MIN_COLOUR_CONTRAST = 0.5


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data, maps = fit_input.data, fit_input.surface_maps
    by_surface = maps.by_surface()
    for surface, some in by_surface.items():
        columns: Columns = partial(maps.reflectance, some=some)
        fit = free_spectrum(equations_in_all_bands(data, columns))
        waves = maps.waves[some.start : some.stop]
        name, choices = data.names[surface], len(by_surface)
        yield FittedExplanation(FAMILY, "a smooth map", fit, columns, "reflectance", waves, name, num_choices=choices)
    if fit_input.surface_spot is not None:
        yield from _stains(fit_input.surface_spot)


def _stains(spot: SurfaceSpot) -> Iterator[FittedExplanation]:
    """A stain, grey or coloured, and other paints in its place."""
    data = spot.data
    stain = FittedExplanation(
        FAMILY, "a stain", spot.fit, spot.relative_change, "reflectance", spot.maps, spot.name, local=True
    )
    if OTHER_SIGN < darker_part(data, change_dn(data, stain)) < 1 - OTHER_SIGN:
        stain = replace(stain, form="a stain, or a bump or dent that is lit on one side")
    yield stain
    yield from _other_paints(spot, stain)


def _other_paints(spot: SurfaceSpot, stain: FittedExplanation) -> Iterator[FittedExplanation]:
    """Another paint in the place of a stain: splashed on it, or beneath a thin paint."""
    data = spot.data
    reflectance = np.maximum(data.reflectance_of(spot.surface), 1e-6)
    for index, name in enumerate(data.materials):
        paint_change = data.transport.reflectance[index] / reflectance - 1
        if np.ptp(paint_change) <= _MIN_COLOUR_CONTRAST * np.abs(paint_change).max():
            continue

        def painted(band: int, paint_change: NDArray[Any] = paint_change) -> NDArray[Any] | csr_matrix:
            return scaled(spot.basis, paint_change[band] * data.signal[band])

        fit = fixed_spectrum(equations_in_all_bands(data, painted), np.ones(len(paint_change)))
        fit = replace(fit, coefficients=paint_change[:, None] * fit.coefficients)
        yield replace(
            stain,
            form=f"the paint {name} shows",
            fit=fit,
            num_choices=len(data.materials),
            paint_change=paint_change,
        )


def _spot_log_odds(spot: SpotAppearance) -> float:
    """Fresh or clean paint brightens all bands alike; spectra of stains are broad."""
    odds = -PENALTY_ODD if spot.brighter and not spot.neutral else 0.0
    return odds - PENALTY_UNLIKELY if spot.in_one_band else odds


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "paint",
        "on a surface of the box",
        ("another paint that was splashed", "a coat worn thin", "a spot painted over"),
        "Photograph again from another place: what stays on the surface is there. Then look at it closely.",
    ),
    Advice(
        "bump",
        "on a surface of the box",
        ("a bump or dent", "a stain", "a warped board"),
        "Light the place from the side with a torch: a bump has a shadow, a stain has none.",
    ),
    Advice(
        "stain",
        "on a surface of the box",
        ("a stain or fingerprint", "dust or soot", "a damp place"),
        "Wipe the place or paint it over, and photograph again.",
    ),
    Advice(
        "",
        "on a surface of the box",
        ("paint rolled unevenly", "a surface that yellowed on one side", "dust that settled"),
        "Measure the reflectance at five places of this surface.",
    ),
)

FAMILY = Family(
    id="reflectance-map",
    title="a stain or another uneven reflectance",
    acts_on="scene",
    generate=_generate,
    order=80,
    spectral=True,
    spot_log_odds=_spot_log_odds,
    advice=_ADVICE,
)
