"""Light from another source: on several surfaces, or on one place."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    PENALTY_ODD,
    Advice,
    Columns,
    Family,
    FitInput,
    FittedExplanation,
    ResidualData,
    SpotAppearance,
    equations_in_all_bands,
    free_spectrum,
    scaled,
)

__all__ = ["FAMILY"]


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data, maps = fit_input.data, fit_input.surface_maps
    columns: Columns = partial(maps.light, some=range(len(maps.waves)))
    fit = free_spectrum(equations_in_all_bands(data, columns))
    form = "light that falls on several surfaces"
    yield FittedExplanation(FAMILY, form, fit, columns, "irradiance", maps.waves)
    spot = fit_input.surface_spot
    if spot is not None:
        form = "light on one place of a surface"
        yield FittedExplanation(
            FAMILY, form, spot.fit, spot.relative_change, "reflectance", spot.maps, spot.name, local=True
        )
    if fit_input.bells is not None:
        yield _on_one_place(data, fit_input.bells)


def _on_one_place(data: ResidualData, bells: ImageMaps) -> FittedExplanation:
    """Light on one place of the image, on any surfaces."""
    basis = csr_matrix(bells.matrix(data.shape))

    def columns(band: int) -> NDArray[Any] | csr_matrix:
        return scaled(basis, data.signal[band])

    fit = free_spectrum(equations_in_all_bands(data, columns))
    return FittedExplanation(FAMILY, "light on one place", fit, columns, "reflectance", bells, local=True)


def _spot_log_odds(spot: SpotAppearance) -> float:
    """Other light has another colour than the box's own: it does not brighten all bands alike."""
    return -PENALTY_ODD if spot.brighter and spot.neutral else 0.0


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "one place",
        "in the scene, on one place",
        ("a gap through which daylight falls", "a pilot lamp", "a reflex from something shiny"),
        "Photograph with the box's lamp off, with the same exposure: what stays is other light.",
    ),
    Advice(
        "",
        "in the scene",
        ("light of the room or a window", "a second lamp", "a light wall or shirt near the camera"),
        "Photograph with the box's lamp off, with the same exposure: what stays is other light.",
    ),
)

FAMILY = Family(
    id="extra-light",
    title="light from another source",
    acts_on="scene",
    generate=_generate,
    order=90,
    additive=True,
    spot_log_odds=_spot_log_odds,
    advice=_ADVICE,
)
