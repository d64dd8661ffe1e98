"""Another spectrum of a paint: on one surface, of one material, or of all materials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..field_fit import (
    Advice,
    Columns,
    Family,
    FitInput,
    FittedExplanation,
    SmoothSurfaceMaps,
    each_band,
    equations_in_all_bands,
)

__all__ = ["FAMILY"]


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data, maps = fit_input.data, fit_input.surface_maps
    surfaces, even = maps.even_maps()
    paint = maps.paints(surfaces)
    groups = [(data.names[surface], [i]) for i, surface in enumerate(surfaces)]
    for index, name in enumerate(data.materials):
        same = [i for i, material in enumerate(paint) if material == index]
        if len(same) > 1:
            groups.append((name, same))
    every = tuple(maps.waves[i] for i in even)
    materials = np.unique(paint)
    if len(materials) > 1:
        together = [_together(maps, [int(i) for i in even[paint == material]]) for material in materials]
        fit = each_band(
            equations_in_all_bands(data, lambda band: np.concatenate([columns(band) for columns in together]))
        )
        by_surface = replace(fit, coefficients=fit.coefficients[:, np.searchsorted(materials, paint)])
        all_even = [int(i) for i in even]
        form = "all paints, each otherwise"
        yield FittedExplanation(
            FAMILY, form, by_surface, lambda band: maps.reflectance(band, all_even), "reflectance", every
        )
    for name, members in groups:
        columns = _together(maps, [int(even[i]) for i in members])
        fit = each_band(equations_in_all_bands(data, columns))
        surface = name if len(members) == 1 else None
        some = tuple(every[i] for i in members)
        yield FittedExplanation(
            FAMILY,
            f"the paint of {name}",
            fit,
            columns,
            "reflectance",
            some,
            surface,
            num_choices=len(groups),
        )


def _together(maps: SmoothSurfaceMaps, some: Sequence[int]) -> Columns:
    """One relative change of reflectance for several maps."""
    return lambda band: maps.reflectance(band, some).sum(axis=0, keepdims=True)


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "all paints",
        "in all paints",
        ("paints that yellowed", "a spectrophotometer without new calibration", "samples of another batch"),
        "Measure the reflectance of every surface in the box itself.",
    ),
    Advice(
        "",
        "on the surfaces of one paint",
        ("paint that faded or yellowed", "another batch of paint", "a sample of another paint than that on the wall"),
        "Measure the reflectance of this surface in the box itself.",
    ),
)

FAMILY = Family(
    id="paint-spectrum",
    title="a paint of another spectrum",
    acts_on="scene",
    generate=_generate,
    order=70,
    localised=False,
    spectral=True,
    advice=_ADVICE,
)
