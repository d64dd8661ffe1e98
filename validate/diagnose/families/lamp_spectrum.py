"""Another spectrum of the lamp: by wavelength, line, band, angle, or part of the lamp."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb

import numpy as np

from ..field_fit import (
    Advice,
    Columns,
    Family,
    FieldFit,
    FitInput,
    FittedExplanation,
    equations_in_all_bands,
    free_spectrum,
)
from ..shared_forms import EVEN, fit_levels, level_equations, relative_levels

__all__ = ["FAMILY"]

#: Largest number of bands that lines of the lamp change together.
_MAX_LINES = 3

#: Number of bands among which lines are sought, those with the largest gain: limits the number of fits.
_MAX_LINE_BANDS = 8


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    maps = fit_input.surface_maps
    yield from _levels(fit_input)
    yield _uneven(fit_input, "by the angle at which light leaves it", maps.lamp_lobe)
    yield _uneven(fit_input, "in a part of the lamp", maps.lamp_sides)


def _levels(fit_input: FitInput) -> Iterator[FittedExplanation]:
    """One number for each band: smooth over the wavelength, in lines, or free."""
    data = fit_input.data
    columns = relative_levels(data)

    def levels(form: str, fit: FieldFit, num_choices: int = 1) -> FittedExplanation:
        return FittedExplanation(FAMILY, form, fit, columns, "lamp", EVEN, num_choices=num_choices)

    n = level_equations(data)
    bands = len(data.bands)
    position = (data.nm - data.nm.min()) / max(np.ptp(data.nm), 1e-9)
    waves = np.array([np.cos(np.pi * i * position) for i in (1, 2, 3)]).T
    yield levels("smooth over the wavelength", fit_levels(n, waves))
    gains = n.fitted.b[:, 0] ** 2 / np.maximum(n.fitted.a[:, 0, 0], 1e-300)
    likely = np.argsort(-gains)[:_MAX_LINE_BANDS]
    for size in range(1, _MAX_LINES + 1):
        for some in combinations(np.sort(likely), size):
            lines = fit_levels(n, np.eye(bands)[:, list(some)])
            yield levels("a line" if size == 1 else "lines", lines, comb(bands, size))
    yield levels("free in each band", fit_levels(n, np.eye(bands)))


def _uneven(fit_input: FitInput, form: str, columns: Columns) -> FittedExplanation:
    """Light by where or at which angle it leaves the lamp, free in each band.

    A cover that scatters does this, and a part of a lamp that has aged.
    """
    fit = free_spectrum(equations_in_all_bands(fit_input.data, columns))
    _, even = fit_input.surface_maps.even_maps()
    waves = tuple(fit_input.surface_maps.waves[i] for i in even)
    return FittedExplanation(FAMILY, form, fit, columns, "radiance", waves, mirrored_dn=fit_input.data.signal)


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "by the angle",
        "in the lamp's cover",
        (
            "a cover that scatters by the wavelength",
            "a lamp seen through its glass at an angle",
            "a reflector with a colour",
        ),
        "Measure the lamp's spectrum from below and from the side.",
    ),
    Advice(
        "part of the lamp",
        "in a part of the lamp",
        ("tubes or diodes that aged unlike", "a stained or bleached part of the cover", "one source of another colour"),
        "Photograph the lamp itself in each band, short enough not to saturate: its colour must be the same all over.",
    ),
    Advice(
        "line",
        "in the lamp, or in the filter of that band",
        ("a gas line that the table lacks", "an exposure or filter entered wrong for a band", "a filter that aged"),
        "Measure the lamp's spectrum again, with a slit of 2 nm or less.",
    ),
    Advice(
        "",
        "in the lamp",
        (
            "a lamp table of another voltage or age",
            "a spectroradiometer without new calibration",
            "filters that aged alike",
        ),
        "Measure the lamp's spectrum again right before the next capture.",
    ),
)

FAMILY = Family(
    id="lamp-spectrum",
    title="a lamp of another spectrum",
    acts_on="lamp",
    generate=_generate,
    order=60,
    localised=False,
    levels=True,
    spectral=True,
    rivals=_levels,
    advice=_ADVICE,
)
