"""Another transmittance of a filter: light of other bands is in one band."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    Advice,
    Columns,
    Family,
    FieldFit,
    FitInput,
    FittedExplanation,
    NormalEquations,
    each_band,
    equations_in_all_bands,
    fit_result,
    fixed_spectrum,
    solve_coefficients,
)

__all__ = ["FAMILY"]

#: Form in which each channel of a mosaic has light of all others.
_OTHER_CHANNELS = "other light in all channels, as by other sensitivities"

#: Most places of a channel in a repeat where single ones may have another filter: Bayer's two greens.
#: An X-Trans sensor has twenty.
_MOST_PLACES = 4

#: Fewest bands for a form in which one holds light of others.
_MIN_BANDS = 3


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    """Leaks, wrong tables, other filters' light: sums of pictures in one band or all channels.

    The pictures of the bands stand for the light at their wavelengths. The own picture is a filter that is darker or
    brighter; it is free as well, since flats and references may or may not see the same filter. The sensitivities of a
    mosaic's channels come from one table, and leaks of the dyes are in all of them: they may all differ at once.
    """
    data = fit_input.data
    bands = len(data.bands)
    if bands < _MIN_BANDS:
        return
    signal = data.signal.reshape(bands, -1)
    level = np.median(signal, axis=1)
    pictures = signal / np.maximum(level, 1e-9)[:, None]

    def mixed(band: int) -> NDArray[Any]:
        return (level[band] * pictures).astype(np.float32)

    def frames(_: int) -> NDArray[Any]:
        return signal.astype(np.float32)

    n = equations_in_all_bands(data, mixed)
    parts = level[:, None] / np.maximum(level, 1e-9)
    for band in range(bands):
        single_band = np.eye(bands)[band]
        yield _explanation(f"other light in {data.bands[band]}", fixed_spectrum(n, single_band), frames, parts, bands)
        others = [(_of_two(n, band, [band, source]), source) for source in range(bands) if source != band]
        fit, source = max(others, key=lambda pair: pair[0].evidence)
        form = f"light of {data.bands[source]} in {data.bands[band]}"
        yield _explanation(form, fit, frames, parts, bands * (bands - 1))
    if not data.used.all(axis=0).any():  # behind a mosaic no pixel sees all bands
        yield _explanation(_OTHER_CHANNELS, each_band(n), frames, parts, 1)
    yield from _unlike_places(fit_input, mixed, parts)


def _rivals(fit_input: FitInput) -> Iterator[FittedExplanation]:
    """The same forms, and light of a single wavelength in one channel of a mosaic, or in each.

    Such is the second pass band of a dye, or an infrared filter that lets the ends of the spectrum through. Few
    channels stand for few wavelengths, so that the picture of each follows the light exchange.
    """
    yield from _generate(fit_input)
    data, t = fit_input.data, fit_input.data.transport
    if data.used.all(axis=0).any():  # bands of filters: their pictures stand for narrow parts of the spectrum
        return
    bands, lines = len(data.bands), len(t.line_nm)
    ratio = t.lines[None] / np.maximum(t.picture, 1e-30)[:, None]
    ratio = np.where(t.picture[:, None] > 0, ratio, 0.0).reshape(bands, lines, -1)
    signal = data.signal.reshape(bands, 1, -1)
    pictures = signal * np.concatenate([np.ones_like(signal), ratio], axis=1)
    level = np.median(signal, axis=2) / np.maximum(np.median(pictures, axis=2), 1e-9)

    def columns(band: int) -> NDArray[Any]:
        return (level[band, :, None] * pictures[band]).astype(np.float32)

    n = equations_in_all_bands(data, columns)

    def explanation(form: str, fit: FieldFit, num_choices: int) -> FittedExplanation:
        return FittedExplanation(
            FAMILY, form, fit, columns, "previous", ImageMaps("cosines"), sharp=True, num_choices=num_choices
        )

    likeliest = []
    for band in range(bands):
        fits = [_of_two(n, band, [0, 1 + line]) for line in range(lines)]
        line = max(range(lines), key=lambda index: fits[index].evidence)
        likeliest.append(1 + line)
        yield explanation(f"light of {t.line_nm[line]:.0f} nm in {data.bands[band]}", fits[line], bands * lines)
    alike = [_of_two_in_each(n, [1 + line] * bands) for line in range(lines)]
    line = max(range(lines), key=lambda index: alike[index].evidence)
    # each channel may leak or not, so that one alone is the simpler form
    yield explanation(f"light of {t.line_nm[line]:.0f} nm in all channels", alike[line], lines * 2**bands)
    yield explanation(
        "light of another wavelength in each of all channels", _of_two_in_each(n, likeliest), lines**bands
    )


def _unlike_places(fit_input: FitInput, mixed: Columns, parts: NDArray[np.float64]) -> Iterator[FittedExplanation]:
    """Other light in some pixels of one channel: two greens whose dyes differ.

    mixed : changes by the pictures of the bands at one level. parts : (band, band) their coefficients by counts.
    """
    data = fit_input.data
    if data.cell is None:
        return
    maps, bands = ImageMaps("repeat", repeat=data.cell), len(data.bands)
    in_place = csr_matrix(maps.matrix(data.shape)).toarray()
    count = in_place @ data.used.reshape(bands, -1).T.astype(float)
    unlike = [band for band in range(bands) if 1 < (count[:, band] > 0).sum() <= _MOST_PLACES]
    for band in unlike:

        def columns(index: int, pictures: Columns = mixed, only: int = band) -> NDArray[Any]:
            each = np.asarray(pictures(index))[:, None] * (in_place if index == only else 0 * in_place)
            return each.reshape(-1, each.shape[-1]).astype(np.float32)

        fit = fixed_spectrum(equations_in_all_bands(data, columns), np.eye(bands)[band])
        fit = replace(fit, coefficients=fit.coefficients * np.repeat(parts, len(in_place), axis=1))
        form = f"other light in some pixels of {data.bands[band]}, by their place in the mosaic"
        yield FittedExplanation(
            FAMILY,
            form,
            fit,
            lambda _: _by_places(data.signal, in_place),
            "previous",
            maps,
            sharp=True,
            num_choices=len(unlike),
        )


def _by_places(signal: NDArray[np.float64], in_place: NDArray[np.float64]) -> NDArray[Any]:
    """(band x place, pixel) counts of each band in each place of the mosaic."""
    each = signal.reshape(len(signal), 1, -1) * in_place
    return np.asarray(each.reshape(-1, each.shape[-1]), np.float32)


def _explanation(
    form: str, fit: FieldFit, frames: Columns, parts: NDArray[np.float64], num_choices: int
) -> FittedExplanation:
    """Form with coefficients of the frames' counts instead of those of pictures of one level."""
    fit = replace(fit, coefficients=fit.coefficients * parts)
    return FittedExplanation(
        FAMILY, form, fit, frames, "previous", ImageMaps("cosines"), sharp=True, num_choices=num_choices
    )


def _of_two(n: NormalEquations, band: int, some: list[int]) -> FieldFit:
    """Fit of two columns in one band: its own level, and light of another kind."""
    h = n.a[band][np.ix_(some, some)] - n.c[band][:, some].T @ n.c[band][:, some]
    x, evidence, freedom, width = solve_coefficients(h, n.b[band][some])
    trial_h, trial_b = n.trial_a[band][np.ix_(some, some)], n.trial_b[band][some]
    trial = np.linalg.solve(trial_h + np.eye(2) / width, trial_b)
    coefficients, of_trial = np.zeros(n.b.shape), np.zeros(n.b.shape)
    coefficients[band, some], of_trial[band, some] = x, trial
    return fit_result(n, coefficients, of_trial, evidence, freedom)


def _of_two_in_each(n: NormalEquations, others: list[int]) -> FieldFit:
    """Fit of two columns in each band: its own level, and one of others (band,)."""
    some = [[0, other] for other in others]
    parts = [
        (n.a[b][np.ix_(s, s)], n.b[b][s], n.c[b][:, s], n.trial_a[b][np.ix_(s, s)], n.trial_b[b][s])
        for b, s in enumerate(some)
    ]
    fit = each_band(NormalEquations(*(np.array(values) for values in zip(*parts, strict=True))))
    coefficients = np.zeros(n.b.shape)
    for band, (columns, values) in enumerate(zip(some, fit.coefficients, strict=True)):
        coefficients[band, columns] = values
    return replace(fit, coefficients=coefficients)


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "some pixels",
        "in the colour filters of some pixels of one channel",
        (
            "greens of two dyes",
            "neighbours of unlike colour beneath their filters",
            "a mosaic with more channels than stated",
        ),
        "State the places as separate channels (G1 and G2), and measure the sensitivity of each by narrow lines.",
    ),
    Advice(
        "all channels",
        "in the colour filters of the sensor",
        ("a missing infrared filter", "another copy of the camera than the table's", "dyes that bleached"),
        "Measure the sensitivity of each channel with a monochromator, or photograph narrow lines of known radiance.",
    ),
    Advice(
        "",
        "in one filter",
        (
            "a filter that leaks far from its band",
            "a wheel that stops between two filters",
            "the table of another filter",
        ),
        "Measure the filter's transmittance from 350 to 1000 nm, in the camera's light path.",
    ),
)

FAMILY = Family(
    id="filter-curve",
    title="a filter of another transmittance",
    acts_on="lamp",
    generate=_generate,
    order=65,
    rivals=_rivals,
    localised=False,
    advice=_ADVICE,
)
