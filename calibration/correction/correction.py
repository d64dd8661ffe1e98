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
from .block_sampling import sampling_variance
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

#: Lower bound of the relative response before division: keeps the quotient finite; such pixels are masked.
_MIN_RELATIVE_RESPONSE = 1e-3
#: Degree of the polynomial of a flat's fall-off: cos^4 and vignetting are even and of fourth order over a usual field.
_FALL_OFF_DEGREE = 4
#: Fewest pixels for each of its terms: fewer would follow single pixels.
_PIXELS_A_TERM = 5
#: Share of a flat's pixels that defects alone may saturate: below it the band's scale is not in doubt.
_MAX_DEFECT_SATURATED_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class FlatField:
    """The flat field of one band."""

    #: (y, x) relative response, mean 1 over the pixels of the band's channel, see ``with_mean_of_all_pixels``.
    response: NDArray[np.float64]
    #: (y, x) variance of the response by the noise of the flat frames alone, relative.
    relative_variance: NDArray[np.float64]
    #: Mean of the flat frames above dark, DN; infinite without a flat.
    mean_dn: float
    #: (k,) weights of the dark levels that were subtracted from the flat.
    dark_weights: NDArray[np.float64]
    #: (y, x) True where a flat frame is saturated.
    saturated: NDArray[np.bool_]
    #: What is uncertain about the flat field, one sentence; None if nothing is.
    note: str | None = None


@dataclass(frozen=True, eq=False)
class CorrectedFrames:
    """The corrected mean of the frames of one exposure."""

    #: (y, x) signal above dark, divided by the flat, DN.
    signal: NDArray[np.float64]
    #: (3, y, x) coefficients of its variance, see ``evaluate_variance``.
    coefficients: NDArray[np.float64]
    #: (y, x) True where a repeat is saturated.
    saturated: NDArray[np.bool_]


def evaluate_variance(coefficients: NDArray[np.float64], expected_signal: ArrayLike) -> NDArray[np.float64]:
    """Variance of the corrected signal, averaged over repeats: c0 + c1 S + c2 S^2.

    Parameters
    ----------
    coefficients
        (..., 3, y, x) c0 in DN^2, c1 in DN, c2 without unit.
    expected_signal
        (..., y, x) expectation S of the corrected signal, DN; negative values are set to 0.

    Returns
    -------
    NDArray
        (..., y, x) variance, DN^2.
    """
    signal = np.maximum(np.asarray(expected_signal, float), 0.0)
    c0, c1, c2 = np.moveaxis(coefficients, -3, 0)
    return c0 + signal * (c1 + signal * c2)


def uniform_flat(shape: tuple[int, int], dark: DarkLibrary, note: str | None = None) -> FlatField:
    """A flat field of response 1 and variance 0.

    Parameters
    ----------
    shape
        (height, width) of the frames, px.
    dark
        The dark levels; all have weight 0 in this flat field.
    note
        Why the flat field is uniform; None if there is nothing to report.

    Returns
    -------
    FlatField
        Its ``mean_dn`` is infinite, which marks a flat field that was not measured.
    """
    zeros = np.zeros(shape)
    return FlatField(zeros + 1, zeros, np.inf, np.zeros(dark.exposure_s.size), zeros.astype(bool), note)


def read_flat(
    capture: Capture,
    band: str,
    dark: DarkLibrary,
    noise: NoiseModel,
    channel: NDArray[np.bool_] | None = None,
) -> FlatField:
    """The flat field of a band, from the flat frames at the band's f-number where there are any.

    Without a flat, or if it was divided beforehand, the response is 1 and its variance 0. The same holds for flat
    frames that are saturated or dark, with a note.

    Parameters
    ----------
    capture
        The capture.
    band
        Identifier of the band.
    dark
        The dark levels.
    noise
        Noise model of one count.
    channel
        (y, x) True for the pixels of the band's channel; None without a mosaic.

    Returns
    -------
    FlatField
        Its response has mean 1 over the pixels that are not saturated, of a mosaic over all places of the image as the
        channel's pixels would see them.

    Raises
    ------
    InputError
        For a faulty frame.
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
    mean = float(above_dark[usable].mean()) * (1.0 if channel is None else _mean_of_all_places(above_dark, usable))
    variance = noise.variance(above_dark + dark.thermal(table.exposure_s)) / len(table.frames)
    response = np.maximum(above_dark / mean, _MIN_RELATIVE_RESPONSE)
    weights = dark.weights(table.exposure_s)
    return FlatField(response, variance / mean**2, mean, weights, saturated, note)


def _mean_of_all_places(above_dark: NDArray[np.float64], usable: NDArray[np.bool_]) -> float:
    """Mean of a channel's fall-off over all pixels, over that of the channel's pixels.

    Where the image ends with an incomplete repeat of the mosaic, a channel's pixels do not lie evenly over it. The mean
    of a fall-off then differs from channel to channel. A polynomial in the place gives the difference.
    """
    y, x = (np.linspace(-1.0, 1.0, size) for size in above_dark.shape)
    degree, pixels = _FALL_OFF_DEGREE, np.count_nonzero(usable)
    while degree and pixels < _PIXELS_A_TERM * (degree + 1) * (degree + 2) // 2:
        degree -= 1
    exponents = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    terms = np.stack([np.outer(y**i, x**j) for i, j in exponents])
    fall_off = np.tensordot(np.linalg.lstsq(terms[:, usable].T, above_dark[usable], rcond=None)[0], terms, axes=1)
    of_channel = float(fall_off[usable].mean())
    return float(fall_off.mean()) / of_channel if of_channel > 0 and fall_off.mean() > 0 else 1.0


def with_mean_of_all_pixels(
    band: str, flat: FlatField, others: Sequence[FlatField], channel: NDArray[np.bool_] | None = None
) -> FlatField:
    """Rescale a response to mean 1 over all pixels of its channel, saturated ones included.

    ``read_flat`` knows the mean of the unsaturated pixels alone, which are the darker ones. The flat field of another
    band through the same lens, the one with the fewest saturated pixels, gives how much darker they are. If that one
    is saturated as much, the flat field stays unchanged. A note is then added unless only few pixels are saturated.

    Parameters
    ----------
    band
        Identifier of the band, for the note.
    flat
        The flat field as read.
    others
        Flat fields of the bands at the same f-number, ``flat`` included.
    channel
        (y, x) True for the pixels of the band's channel; None without a mosaic.

    Returns
    -------
    FlatField
        ``flat`` itself if none of its pixels is saturated.
    """
    in_channel = np.ones(flat.saturated.shape, bool) if channel is None else channel
    share = float(flat.saturated[in_channel].mean())
    if share == 0:
        return flat
    measured = [other for other in others if np.isfinite(other.mean_dn)]
    clean = min(measured, key=lambda other: other.saturated[in_channel].mean(), default=None)
    if clean is not None and clean.saturated[in_channel].mean() < share / 2:
        unsaturated = in_channel & ~clean.saturated
        darker = float(clean.response[unsaturated & ~flat.saturated].mean() / clean.response[unsaturated].mean())
        return replace(
            flat,
            response=flat.response * darker,
            relative_variance=flat.relative_variance * darker**2,
            mean_dn=flat.mean_dn / darker,
        )
    if share < _MAX_DEFECT_SATURATED_SHARE:
        return flat
    text = f"{band}: the flat frames are saturated in {share:.0%} of the pixels: the scale of the band is uncertain"
    return replace(flat, note="; ".join(filter(None, [flat.note, text])))


def correct(
    capture: Capture, table: FrameTable, flat: FlatField, dark: DarkLibrary, noise: NoiseModel
) -> CorrectedFrames:
    """Average the frames of a table and correct them by equation 1 of this module.

    Parameters
    ----------
    capture
        The capture.
    table
        The table of the manifest that names the frames and their exposure.
    flat
        Flat field to divide by.
    dark
        The dark levels, subtracted at the table's exposure.
    noise
        Noise model of one count.

    Returns
    -------
    CorrectedFrames
        Signal, variance and saturation of the mean over repeats.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    stack = capture.frames(table)
    repeats = stack.shape[0]
    response, mean = flat.response, flat.mean_dn
    signal = (stack.mean(axis=0) - dark.at(table.exposure_s)) / response
    weights = dark.weights(table.exposure_s)
    frame_variance = noise.variance(dark.thermal(table.exposure_s)) / repeats
    between_pixels = sampling_variance(capture, table, dark, noise)
    if between_pixels is not None:
        frame_variance = frame_variance + between_pixels
    dark_variance = np.zeros((3, *capture.shape))
    for index, exposure in enumerate(dark.exposure_s):
        level_variance = noise.variance(dark.thermal(exposure)) / dark.repeats[index]
        for power, share in enumerate(
            (
                weights[index] ** 2,
                -2 * weights[index] * flat.dark_weights[index] / mean,
                (flat.dark_weights[index] / mean) ** 2,
            )
        ):
            dark_variance[power] += share * level_variance
    coefficients = np.stack(
        [
            (frame_variance + dark_variance[0]) / response**2,
            noise.shot_dn / (repeats * response) + dark_variance[1] / response**2,
            (flat.relative_variance + dark_variance[2]) / response**2,
        ]
    )
    return CorrectedFrames(signal, coefficients, stack.max(axis=0) >= capture.saturation_dn)
