"""Correction of frames: dark subtraction and flat division, with propagated variance.

S = (S_o - S_d) mean(S_f - S_d) / (S_f - S_d)    (Pattanaik et al. 1997, eq. 1)

Repeats are averaged first. The variance of S is, in each pixel, a quadratic in the expected signal: shot noise of
object, flat and dark, read noise, rounding, and the covariance from dark frames that object and flat share.
Evaluated at a model's expected signal it is the exact variance under that model. Evaluated at the measured signal
it is correlated with that signal, and a chi-square with such weights is biased towards low counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..capture import Capture, FrameTable
from .dark import DarkLibrary
from .noise import NoiseModel

__all__ = [
    "CorrectedFrames",
    "FlatField",
    "correct",
    "evaluate_variance",
    "read_flat",
    "uniform_flat",
    "with_mean_of_all_pixels",
]

# Lower bound of the response, relative to its mean, before division; such pixels are masked.
_SMALLEST_RESPONSE = 1e-3

# Part of the pixels that defects alone may saturate in a flat.
_FEW_SATURATED = 0.01


@dataclass(frozen=True, eq=False)
class FlatField:
    """The flat field of one band.

    response : (y, x), mean 1 over the pixels of the band's channel, see ``with_mean_of_all_pixels``.
    relative_variance : (y, x) of the response, from the noise of the flat frames only. mean_dn : mean of the flat
    frames above dark, DN; infinite without a flat. dark_weights : (k,) weights of the dark levels that were subtracted.
    saturated : (y, x) True where a flat frame is saturated.
    """

    response: NDArray[np.float64]
    relative_variance: NDArray[np.float64]
    mean_dn: float
    dark_weights: NDArray[np.float64]
    saturated: NDArray[np.bool_]
    note: str | None = None


@dataclass(frozen=True, eq=False)
class CorrectedFrames:
    """signal : (y, x) DN. coefficients : (3, y, x), see evaluate_variance. saturated : (y, x) True or False."""

    signal: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    saturated: NDArray[np.bool_]


def evaluate_variance(coefficients: NDArray[np.float64], expected_signal: ArrayLike) -> NDArray[np.float64]:
    """Variance (..., y, x) in DN^2 of the corrected signal, averaged over repeats.

    coefficients : (..., 3, y, x) of c0 + c1 S + c2 S^2. expected_signal : (..., y, x) DN, the expectation S of
    the corrected signal; negative values are set to 0.
    """
    signal = np.maximum(np.asarray(expected_signal, float), 0.0)
    c0, c1, c2 = np.moveaxis(coefficients, -3, 0)
    return c0 + signal * (c1 + signal * c2)


def uniform_flat(shape: tuple[int, int], dark: DarkLibrary, note: str | None = None) -> FlatField:
    """A flat field of response 1 and variance 0."""
    zeros = np.zeros(shape)
    return FlatField(zeros + 1, zeros, np.inf, np.zeros(dark.exposure_s.size), zeros.astype(bool), note)


def read_flat(
    capture: Capture,
    band: str,
    dark: DarkLibrary,
    noise: NoiseModel,
    channel: NDArray[np.bool_] | None = None,
) -> FlatField:
    """The flat field of a band; of several flats the one at the band's f-number is preferred.

    Without a flat (or if it was divided beforehand) the response is 1 and its variance 0.
    channel : (y, x) the pixels of the band's channel, if the sensor has a mosaic.
    Raises InputError for a faulty frame.
    """
    tables = capture.flats(band)
    if not tables:
        return uniform_flat(capture.shape, dark)
    table = tables[0]
    note = None
    if capture.f_number(table) != capture.band(band).f_number:
        note = f"{band}: the flat was taken at another f-number: its vignetting may differ"
    stack = capture.frames(table)
    above_dark = stack.mean(axis=0) - dark.at(table.exposure_s)
    saturated = stack.max(axis=0) >= capture.saturation_dn
    usable = ~saturated if channel is None else ~saturated & channel
    if not np.any(usable) or above_dark[usable].mean() <= 0:
        fault = "dark" if np.any(usable) else "saturated"
        text = f"{band}: the flat frames are {fault}: a uniform flat was assumed"
        return uniform_flat(capture.shape, dark, text)
    mean = float(above_dark[usable].mean())
    variance = noise.variance(above_dark + dark.thermal(table.exposure_s)) / len(table.frames)
    response = np.maximum(above_dark / mean, _SMALLEST_RESPONSE)
    weights = dark.weights(table.exposure_s)
    return FlatField(response, variance / mean**2, mean, weights, saturated, note)


def with_mean_of_all_pixels(
    band: str, flat: FlatField, others: Sequence[FlatField], channel: NDArray[np.bool_] | None = None
) -> FlatField:
    """A flat field whose response has mean 1 over all pixels of its channel, though some are saturated.

    ``read_flat`` knows the mean of the others alone, which are the darker ones. How much darker they are is taken from
    that of ``others``, flat fields of other bands through the same lens, which is saturated least. Where they are
    saturated as much, the flat field stays as it is, with a note unless few pixels are.
    """
    whole = np.ones(flat.saturated.shape, bool) if channel is None else channel
    share = float(flat.saturated[whole].mean())
    if share == 0:
        return flat
    measured = [other for other in others if np.isfinite(other.mean_dn)]
    clean = min(measured, key=lambda other: other.saturated[whole].mean(), default=None)
    if clean is not None and clean.saturated[whole].mean() < share / 2:
        seen = whole & ~clean.saturated
        darker = float(clean.response[seen & ~flat.saturated].mean() / clean.response[seen].mean())
        return replace(
            flat,
            response=flat.response * darker,
            relative_variance=flat.relative_variance * darker**2,
            mean_dn=flat.mean_dn / darker,
        )
    if share < _FEW_SATURATED:
        return flat
    text = f"{band}: the flat frames are saturated in {share:.0%} of the pixels: the scale of the band is uncertain"
    return replace(flat, note="; ".join(filter(None, [flat.note, text])))


def correct(
    capture: Capture, table: FrameTable, flat: FlatField, dark: DarkLibrary, noise: NoiseModel
) -> CorrectedFrames:
    """The frames of a table, averaged and corrected by equation 1 of this module.

    Raises InputError for a faulty frame.
    """
    stack = capture.frames(table)
    repeats = stack.shape[0]
    response, mean = flat.response, flat.mean_dn
    signal = (stack.mean(axis=0) - dark.at(table.exposure_s)) / response
    weights = dark.weights(table.exposure_s)
    own = noise.variance(dark.thermal(table.exposure_s)) / repeats
    shared = np.zeros((3, *capture.shape))
    for index, exposure in enumerate(dark.exposure_s):
        level_variance = noise.variance(dark.thermal(exposure)) / dark.repeats[index]
        for power, share in enumerate(
            (
                weights[index] ** 2,
                -2 * weights[index] * flat.dark_weights[index] / mean,
                (flat.dark_weights[index] / mean) ** 2,
            )
        ):
            shared[power] += share * level_variance
    coefficients = np.stack(
        [
            (own + shared[0]) / response**2,
            noise.shot_dn / (repeats * response) + shared[1] / response**2,
            (flat.relative_variance + shared[2]) / response**2,
        ]
    )
    return CorrectedFrames(signal, coefficients, stack.max(axis=0) >= capture.saturation_dn)
