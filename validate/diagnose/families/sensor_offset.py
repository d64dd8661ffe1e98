"""Counts added on the sensor: patterns, a glow at the border, errors by the count."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import LEVELS, ImageMaps, parts_of_levels
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    LEAST_DIVISOR,
    PENALTY_UNLIKELY,
    Advice,
    Family,
    FitInput,
    FittedExplanation,
    ResidualData,
    SpotAppearance,
    each_band,
    equations_in_all_bands,
    fixed_spectrum,
    scaled,
)
from ..shared_forms import SensorPatterns

__all__ = ["FAMILY"]

#: Percentile of the variance that stands for pixels without light.
_WITHOUT_LIGHT = 1


def _patterns(fit_input: FitInput) -> SensorPatterns:
    data = fit_input.data
    return SensorPatterns(
        FAMILY,
        "offset",
        fit_input,
        operator=1 / np.maximum(data.flat, LEAST_DIVISOR),
        by_exposure=data.exposure_s,
        exposure_form="that grows with the exposure",
        common_variance=_variance_of_darks(data),
    )


def _of_channels(fit_input: FitInput) -> Iterator[FittedExplanation]:
    """Black levels and bends of channels, amplifiers in turn; nothing without a mosaic."""
    patterns = _patterns(fit_input)
    yield from patterns.of_amplifiers(" DN")
    yield from patterns.black_levels()
    if fit_input.data.cell is not None:
        yield from _bends(fit_input.data)


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data, patterns = fit_input.data, _patterns(fit_input)
    yield from patterns.over_the_sensor()
    yield from _of_channels(fit_input)
    yield from patterns.single_pixels()
    yield from patterns.waves()
    yield from patterns.spots()
    yield _by_level(data)


def _variance_of_darks(data: ResidualData) -> float:
    """Variance of a pixel by the noise of darks that all bands may share, DN^2.

    There are about as many dark frames as frames of a band: they make half of the variance without light.
    """
    counts = [(sigma * flat)[used] ** 2 for sigma, flat, used in zip(data.sigma, data.flat, data.used, strict=True)]
    return float(np.mean([np.percentile(values, _WITHOUT_LIGHT) for values in counts if len(values)])) / 2


def _by_level(data: ResidualData) -> FittedExplanation:
    """Counts added by the count: wrong weights of a converter's bits, an irregular amplifier."""
    counts = data.signal * data.flat
    most = float(counts[data.used].max())

    def columns(band: int) -> NDArray[Any] | csr_matrix:
        return scaled(parts_of_levels(counts[band].ravel(), most), 1 / np.maximum(data.flat[band], LEAST_DIVISOR))

    fit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(len(data.bands)))
    form = "steps or bends of the counts by their level"
    return FittedExplanation(FAMILY, form, fit, columns, "levels", ImageMaps("cosines"), most_dn=most)


def _bends(data: ResidualData) -> Iterator[FittedExplanation]:
    """Counts that bend in one channel or in each otherwise: their part grows with the count."""
    counts = data.signal * data.flat
    most = float(counts[data.used].max())

    def columns(band: int) -> NDArray[Any] | csr_matrix:
        return scaled(parts_of_levels(counts[band].ravel(), most), 1 / np.maximum(data.flat[band], LEAST_DIVISOR))

    level = np.linspace(0.0, most, LEVELS)
    # flats and reference bend as well, which leaves another level of the channel
    parts = np.array([level, level * level / most])
    n = equations_in_all_bands(data, columns).of_sums(parts)
    fits = {
        "in one band": max((fixed_spectrum(n, band) for band in np.eye(len(n.b))), key=lambda fit: fit.evidence),
        "in each band otherwise": each_band(n),
    }
    for where, fit in fits.items():
        strongest = int(np.argmax(fit.size))
        bend = fit.coefficients[strongest, 1]
        form = f"a bend of the counts {where}, {bend:.2%} at {most:.0f} DN in {data.bands[strongest]}"
        choices = len(n.b) if where == "in one band" else 1
        fit = replace(fit, coefficients=fit.coefficients @ parts)
        yield FittedExplanation(
            FAMILY, form, fit, columns, "levels", ImageMaps("cosines"), sharp=True, most_dn=most, num_choices=choices
        )


def _spot_log_odds(spot: SpotAppearance) -> float:
    """Amplifiers, which glow, sit at the border of a sensor."""
    return 0.0 if spot.at_the_border else -PENALTY_UNLIKELY


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "black level",
        "in the read-out of one channel",
        (
            "a black level that differs between channels",
            "a raw file whose black level was subtracted twice",
            "light in the dark frames",
        ),
        "Cover the lens and take frames of the shortest exposure: each channel's mean is its black level.",
    ),
    Advice(
        "a bend",
        "in the read-out of one channel",
        ("an amplifier near its limit", "a raw file with a curve", "charge that a full pixel gives away"),
        "Photograph an evenly lit card at ten exposure times, and fit each channel's counts over time.",
    ),
    Advice(
        "every second",
        "in the read-out",
        ("two amplifiers of unlike offset", "two converters that read in turn", "a changed read-out setting"),
        "Cover the lens and take frames of the shortest exposure: an offset differs there as well.",
    ),
    Advice(
        "quarters",
        "in the read-out",
        ("four amplifiers of unlike offset", "an amplifier that drifted since the darks", "a changed read-out setting"),
        "Cover the lens and take darks again: quarters that stay come from the amplifiers.",
    ),
    Advice(
        "mosaic's repeat",
        "in the read-out",
        (
            "amplifiers that read pixels in turn",
            "unlike black levels",
            "a wrong phase of the mosaic",
        ),
        "Cover the lens and take frames of the shortest exposure: places that stay come from the read-out.",
    ),
    Advice(
        "single pixels",
        "in pixels of the sensor",
        ("darks of another day or temperature", "pixels that became hot", "charge left by an earlier exposure"),
        "Cover the lens and take darks again, with the exposure times of the bands.",
    ),
    Advice(
        "rows",
        "in the rows of the sensor",
        ("a changed read-out setting", "mains hum", "a fault of the line amplifiers"),
        "Cover the lens and take frames of the shortest exposure: rows that stay come from the read-out.",
    ),
    Advice(
        "columns",
        "in the columns of the sensor",
        ("trapped charge", "a fault of the column amplifiers", "darks of another temperature"),
        "Cover the lens and take darks again: columns that stay come from the sensor.",
    ),
    Advice(
        "steps or bends",
        "in the converter, by the level of the counts",
        ("a converter whose bits weigh wrong", "a clipped amplifier", "a lossy file format"),
        "Photograph an evenly lit card at ten exposure times, and look for steps of counts over time.",
    ),
    Advice(
        "grows with the exposure",
        "on the sensor, while it is exposed",
        ("a leak of light past the filter wheel", "an amplifier that glows", "dark current of another temperature"),
        "Cover the lens but leave the lamp on, and take frames with the longest exposure of the bands.",
    ),
    Advice(
        "a wave",
        "in the read-out",
        ("mains hum", "radio interference of a supply", "a loose ground"),
        "Cover the lens and take two frames of the shortest exposure: waves of hum lie elsewhere in each.",
    ),
    Advice(
        "rings",
        "in the read-out",
        ("radio interference", "an uneven bias after power-up", "a wrong dark"),
        "Cover the lens and take darks again.",
    ),
    Advice(
        "a spot",
        "on the sensor",
        ("an amplifier that glows at a corner", "a leak of light", "persistence of a bright spot"),
        "Cover the lens and take frames with the exposure times of the bands.",
    ),
    Advice(
        "",
        "on the sensor",
        ("a leak of light past the filter wheel", "darks of another temperature", "a drifting bias"),
        "Cover the lens but leave the lamp on, and take frames with the exposure times of the bands.",
    ),
)

FAMILY = Family(
    id="sensor-offset",
    title="counts added on the sensor",
    acts_on="sensor",
    generate=_generate,
    order=10,
    rivals=_of_channels,
    additive=True,
    spot_log_odds=_spot_log_odds,
    advice=_ADVICE,
)
