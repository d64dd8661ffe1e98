"""Counts added on the sensor: patterns, a glow at the border, errors by the count."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps, parts_of_levels
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    PENALTY_UNLIKELY,
    Advice,
    Family,
    FitInput,
    FittedExplanation,
    ResidualData,
    SpotAppearance,
    equations_in_all_bands,
    fixed_spectrum,
    scaled,
)
from ._sensor import SensorPatterns

__all__ = ["FAMILY"]

#: Smallest flat field by which counts are divided: keeps dark corners finite.
_MIN_FLAT = 0.05

#: Percentile of the variance that stands for pixels without light.
_WITHOUT_LIGHT = 1


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data = fit_input.data
    patterns = SensorPatterns(
        FAMILY,
        "offset",
        fit_input,
        operator=1 / np.maximum(data.flat, _MIN_FLAT),
        by_exposure=data.exposure_s,
        exposure_form="that grows with the exposure",
        common_variance=_variance_of_darks(data),
    )
    yield from patterns.over_the_sensor()
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
        return scaled(parts_of_levels(counts[band].ravel(), most), 1 / np.maximum(data.flat[band], _MIN_FLAT))

    fit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(len(data.bands)))
    form = "steps or bends of the counts by their level"
    return FittedExplanation(FAMILY, form, fit, columns, "levels", ImageMaps("cosines"), most_dn=most)


def _spot_log_odds(spot: SpotAppearance) -> float:
    """Amplifiers, which glow, sit at the border of a sensor."""
    return 0.0 if spot.at_the_border else -PENALTY_UNLIKELY


#: Words for the laboratory.
_ADVICE = (
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
        "Cover the lens and take two frames of the shortest exposure: hum has another phase in each.",
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
    additive=True,
    spot_log_odds=_spot_log_odds,
    advice=_ADVICE,
)
