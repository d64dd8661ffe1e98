"""Another spectrum of the lamp: smooth over the wavelength, in lines, or free in each band."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb

import numpy as np

from ..field_fit import Family, FieldFit, FitInput, FittedExplanation, equations_in_all_bands
from ._levels import EVEN, fit_levels, relative_levels

__all__ = ["FAMILY"]

#: Largest number of bands that lines of the lamp change together.
_MAX_LINES = 3

#: Number of bands among which lines are sought, those with the largest gain: limits the number of fits.
_MAX_LINE_BANDS = 8


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data = fit_input.data
    columns = relative_levels(data)

    def levels(form: str, fit: FieldFit, num_choices: int = 1) -> FittedExplanation:
        return FittedExplanation(FAMILY, form, fit, columns, "lamp", EVEN, num_choices=num_choices)

    n = equations_in_all_bands(data, columns)
    bands = len(data.bands)
    position = (data.nm - data.nm.min()) / max(np.ptp(data.nm), 1e-9)
    waves = np.array([np.cos(np.pi * i * position) for i in (1, 2, 3)]).T
    yield levels("smooth over the wavelength", fit_levels(n, waves, 0.0))
    gains = n.b[:, 0] ** 2 / np.maximum(n.a[:, 0, 0], 1e-300)
    likely = np.argsort(-gains)[:_MAX_LINE_BANDS]
    for size in range(1, _MAX_LINES + 1):
        for some in combinations(np.sort(likely), size):
            lines = fit_levels(n, np.eye(bands)[:, list(some)], 0.0)
            yield levels("a line" if size == 1 else "lines", lines, comb(bands, size))
    yield levels("free in each band", fit_levels(n, np.eye(bands), 0.0))


FAMILY = Family(
    id="lamp-spectrum",
    title="a lamp of another spectrum",
    acts_on="lamp",
    generate=_generate,
    order=60,
    localised=False,
    levels=True,
    spectral=True,
)
