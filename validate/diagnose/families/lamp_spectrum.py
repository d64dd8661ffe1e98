"""Another spectrum of the lamp: over the wavelength, in lines, in each band, by the angle."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb

import numpy as np

from ..field_fit import Advice, Family, FieldFit, FitInput, FittedExplanation, equations_in_all_bands, free_spectrum
from ._levels import EVEN, fit_levels, level_equations, relative_levels

__all__ = ["FAMILY"]

#: Largest number of bands that lines of the lamp change together.
_MAX_LINES = 3

#: Number of bands among which lines are sought, those with the largest gain: limits the number of fits.
_MAX_LINE_BANDS = 8


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    yield from _levels(fit_input)
    yield _by_angle(fit_input)


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


def _by_angle(fit_input: FitInput) -> FittedExplanation:
    """Light by the angle at which it leaves the lamp, free in each band.

    A cover that scatters does this.
    """
    data, maps = fit_input.data, fit_input.surface_maps
    fit = free_spectrum(equations_in_all_bands(data, maps.lamp_lobe))
    _, even = maps.even_maps()
    return FittedExplanation(
        FAMILY,
        "by the angle at which light leaves it",
        fit,
        maps.lamp_lobe,
        "radiance",
        tuple(maps.waves[i] for i in even),
        mirrored_dn=data.signal,
    )


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
