"""Displacement of the image, constant, linear or smooth; in all bands, in one, or in each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray

from ..field_fit import (
    Advice,
    Columns,
    Family,
    FitInput,
    FittedExplanation,
    MaskedPattern,
    ResidualData,
    equations_in_all_bands,
    next_to_common_field,
)
from ..shared_forms import forms_by_spectrum

__all__ = ["FAMILY"]

#: Highest order of the cosines of each displacement. One half wave across the picture is nearly linear.
_ORDER = {"the whole picture": 0, "magnified or turned": 1, "a smooth field": 4}

#: Displacement that is sought in one band alone: a lens enlarges every band otherwise, which smooth fields contain.
_OF_ONE_BAND = "magnified or turned"


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data = fit_input.data
    for form, maps, columns in _operators(data):
        forms = forms_by_spectrum(FAMILY, form, equations_in_all_bands(data, columns), columns, "displacement", maps)
        yield from [*forms][-1:] if form == _OF_ONE_BAND else forms


def displacements_of_bands(data: ResidualData) -> Iterator[FittedExplanation]:
    """Displacements of single bands, next to one that is common to all bands.

    Errors of the rendered edges are common to all bands.

    Parameters
    ----------
    data
        Residual to be explained.

    Yields
    ------
    FittedExplanation
        In each band otherwise, and in one band; constant, linear and smooth.
    """
    for form, maps, columns in _operators(data):
        n = next_to_common_field(equations_in_all_bands(data, columns))
        _, *single = forms_by_spectrum(FAMILY, form, n, columns, "displacement", maps)
        some = single[-1:] if form == _OF_ONE_BAND else single
        yield from (replace(explanation, sharp=True) for explanation in some)


def _operators(data: ResidualData) -> Iterator[tuple[str, ImageMaps, Columns]]:
    """Constant, linear and smooth displacements to the right and down."""
    for form, order in _ORDER.items():
        maps = ImageMaps("cosines", order=order)
        yield form, maps, _columns(data, maps.matrix(data.shape))


def _columns(data: ResidualData, basis: NDArray[Any]) -> Columns:
    return lambda band: np.concatenate([way[band].ravel() * basis for way in data.moved]).astype(np.float32)


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "one band",
        "in one filter",
        ("a filter that is a wedge", "a tilted filter", "a camera moved between two bands"),
        "Turn the filter in its holder and photograph again: a shift that turns is in the filter.",
    ),
    Advice(
        "in each band",
        "in the filters, or between the frames",
        (
            "filters of different wedge or tilt",
            "a camera that sinks while bands are taken",
            "colour errors of the lens",
        ),
        "Take the first band again at the end: a shift between the two is the camera's.",
    ),
    Advice(
        "",
        "in the lens or the camera's mount",
        ("a distortion that the model lacks", "a moved camera", "points that were surveyed wrong"),
        "Measure twenty more points near the borders, and calibrate the camera again.",
    ),
)

FAMILY = Family(
    id="displacement",
    title="a displacement of the picture",
    acts_on="image",
    generate=_generate,
    order=30,
    masked=(MaskedPattern(rank=3, generate=displacements_of_bands),),
    advice=_ADVICE,
)
