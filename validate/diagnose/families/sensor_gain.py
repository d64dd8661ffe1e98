"""Gain fixed on the sensor: patterns, dust, hairs, interference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    PENALTY_IMPOSSIBLE,
    PENALTY_ODD,
    PENALTY_UNLIKELY,
    Advice,
    Family,
    FitInput,
    FittedExplanation,
    ResidualData,
    SpotAppearance,
    Wave,
    each_band,
    equations_in_all_bands,
    scaled,
)
from ..shared_forms import SensorPatterns

__all__ = ["FAMILY"]

#: Highest order of the cosines by which strength and phase of interference vary: resolves an eighth of the image.
_ENVELOPE_ORDER = 8


def _patterns(fit_input: FitInput) -> SensorPatterns:
    data = fit_input.data
    return SensorPatterns(
        FAMILY,
        "gain",
        fit_input,
        operator=data.signal,
        by_exposure=1 / data.exposure_s - 1 / data.flat_exposure_s,
        exposure_form="as of a shutter's opening",
    )


def _amplifiers(fit_input: FitInput) -> Iterator[FittedExplanation]:
    yield from _patterns(fit_input).of_amplifiers("%")


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data, patterns = fit_input.data, _patterns(fit_input)
    yield from patterns.over_the_sensor()
    yield from _amplifiers(fit_input)
    yield from patterns.single_pixels()
    yield from patterns.waves(lambda wave, num_choices: _interference(data, wave, num_choices))
    yield from patterns.spots()


def _interference(data: ResidualData, wave: Wave, num_choices: int) -> FittedExplanation:
    """Interference of light in one gap: waves by the wavelength.

    They are weaker where orders differ within a band.
    """
    maps = replace(wave.maps, order=_ENVELOPE_ORDER, nm=float(data.nm[wave.band]))

    def columns(band: int) -> NDArray[Any] | csr_matrix:
        at_wavelength = maps.at(float(data.nm[band]))
        return scaled(at_wavelength.matrix(data.shape), data.signal[band])

    fit = each_band(equations_in_all_bands(data, columns))
    form = f"{'rings' if maps.curvature else 'a wave'} by the wavelength"
    return FittedExplanation(FAMILY, form, fit, columns, "gain", maps, sharp=True, num_choices=num_choices)


def _spot_log_odds(spot: SpotAppearance) -> float:
    """Dust darkens, is no straight thin line, and is round in the image."""
    odds = -PENALTY_UNLIKELY if spot.brighter else 0.0
    odds -= PENALTY_IMPOSSIBLE if spot.line else 0.0
    return odds if spot.rounder_in_the_image else odds - PENALTY_ODD


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "in one band,",
        "in the read-out of one channel's pixels",
        (
            "two amplifiers that read the greens",
            "neighbours of unlike colour that leak charge",
            "a raw file whose channels were scaled otherwise",
        ),
        "Photograph an evenly lit card through a narrow filter: what still differs is made by amplifiers.",
    ),
    Advice(
        "every second",
        "in the read-out",
        ("two amplifiers of unlike gain", "two converters that read in turn", "gains that drifted since the flats"),
        "Photograph an evenly lit card at two exposures: unlike gains differ by the same percentage in both.",
    ),
    Advice(
        "quarters",
        "in the read-out",
        ("four amplifiers of unlike gain", "a gain that drifted since the flats", "a shutter of two halves"),
        "Photograph an evenly lit card at two exposures: unlike gains differ by the same percentage in both.",
    ),
    Advice(
        "mosaic's repeat",
        "in the read-out",
        ("amplifiers that read pixels in turn", "gains that drifted since the flats", "a wrong phase of the mosaic"),
        "Take new flats right after the scene, and calibrate with them.",
    ),
    Advice(
        "single pixels",
        "in pixels of the sensor",
        ("flats of another day", "ice or dew on a cooled sensor", "fine dust on the sensor"),
        "Take new flats right after the scene, and calibrate with them.",
    ),
    Advice(
        "rows",
        "in the rows of the sensor",
        ("amplifiers that drifted since the flats", "an uneven shutter", "a changed read-out setting"),
        "Take new flats right after the scene, and calibrate with them.",
    ),
    Advice(
        "columns",
        "in the columns of the sensor",
        ("amplifiers that drifted since the flats", "trapped charge", "a changed read-out setting"),
        "Take new flats right after the scene, and calibrate with them.",
    ),
    Advice(
        "shutter",
        "in the shutter",
        ("a shutter that opens slowly", "a sticking blade", "a wrong stated exposure"),
        "Photograph the scene again with twice the exposure: the pattern of a shutter halves.",
    ),
    Advice(
        "a wave",
        "in a filter or in a window before the sensor",
        ("interference in a filter", "interference in the sensor's window", "a wedge of air behind a filter"),
        "Turn the filter in its holder and photograph again: fringes that turn are in the filter.",
    ),
    Advice(
        "rings",
        "in a filter or in a window before the sensor",
        ("interference in a filter", "interference in the sensor's window", "a diffraction ring of a dust grain"),
        "Turn the filter in its holder and photograph again: rings that turn are in the filter.",
    ),
    Advice(
        "a spot in one band",
        "on a filter",
        ("dust on a filter", "a fingerprint on a filter", "a scratch in its coating"),
        "Turn the filter in its holder and photograph again: a spot that turns is on the filter.",
    ),
    Advice(
        "a spot",
        "on the sensor or its window",
        ("dust on the sensor's window", "a fibre on the sensor", "a drop that dried"),
        "Turn the camera a little and photograph again: a spot that stays at its pixel is on the sensor.",
    ),
    Advice(
        "",
        "on the sensor or in the lens",
        ("flats taken at another aperture or focus", "a film on the window", "a hood that shades the corners"),
        "Take new flats at the aperture and focus of the scene.",
    ),
)

FAMILY = Family(
    id="sensor-gain",
    title="a gain fixed on the sensor",
    acts_on="sensor",
    generate=_generate,
    order=20,
    rivals=_amplifiers,
    spot_log_odds=_spot_log_odds,
    advice=_ADVICE,
)
