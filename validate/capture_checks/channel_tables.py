"""Check for a colour channel whose table is displaced in wavelength or has another level.

The references give each channel its C, which is one constant for all. The light of the known scene's paints over the
rendering gives further ratios. A table of another level changes all of them alike. A displaced table changes each by
the slope of the source's or of the paint's spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import Capture, pattern_rows, split_channel
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.quality import Suspicion
from cboxlab.calibration.radiometry import Radiometry, counts_over_constant
from numpy.typing import NDArray

from .scene_view import SceneView, light_of_paints

__all__ = ["check_channel_tables"]

#: Smallest displacement that is suspected, nm: copies of a camera differ by up to 5 nm.
SMALLEST_SHIFT_NM = 7.0

#: Displacements that are tried, nm: farther ones change a channel as another channel's table does.
SHIFTS_NM = np.arange(-24.0, 25.0, 4.0)

#: Smallest suspicious level where paints leave its cause open, natural log: copies of a camera differ by 5 %.
SMALLEST_LEVEL = 0.05

#: Standard deviation of a channel's C, natural log: dark levels and stray light in even fields.
SIGMA_OF_CONSTANT = 0.01

#: Standard deviation of a paint's light over the rendering, natural log: sound captures scatter by 0.01.
SIGMA_OF_PAINT = 0.012

#: Stray light over the light of the brightest paint: it matters most on dark paints.
STRAY_LIGHT = 0.003

#: Largest mean square of the standardised deviations that a cause may leave.
LARGEST_MISFIT = 4.0

#: Decrease of the sum of squares from which on one cause is preferred to another: a chance of 1 in 10,000.
DECISIVE = 15.0

#: Fewest channels: of two, nobody knows which is wrong.
FEWEST_CHANNELS = 3


@dataclass(frozen=True, eq=False)
class _Ratios:
    """Measured over expected light of every band, natural logarithms, by displacement."""

    #: (shift, quantity, band) C, then each paint; NaN where a band has none.
    values: NDArray[np.float64]
    #: (quantity, band) standard deviations.
    sigma: NDArray[np.float64]
    #: (quantity, band) signals, DN.
    signal: NDArray[np.float64]


@dataclass(frozen=True)
class _Cause:
    """A change of one channel that fits best."""

    #: Letter of the channel.
    letter: str
    #: Its level (natural log), or the displacement of its table, nm.
    size: float
    #: Sum of squares that it leaves.
    squares: float


def check_channel_tables(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    channels: Mapping[str, str] | None,
    view: SceneView | None,
) -> Iterator[Suspicion]:
    """Detect a colour channel whose table is displaced or does not suit the references.

    Parameters
    ----------
    capture
        A capture; without a mosaic nothing is checked.
    bands
        The capture's corrected signals.
    radiometry
        C by the references of each band.
    channels
        Channel of each band of a sensor with a mosaic; None without one.
    view
        The capture's known scene; None leaves the references alone.

    Yields
    ------
    Suspicion
        At most one.
    """
    mosaic = capture.manifest.mosaic
    if channels is None or mosaic is None or capture.manifest.is_free_by_band:
        return
    letters = np.array([split_channel(channels[band])[0] for band in capture.band_ids])
    if np.unique(letters).size < FEWEST_CHANNELS:
        return
    as_stated = _ratios(capture, bands, radiometry, channels, view, np.zeros(1))
    level = _best_level(as_stated.values[0], as_stated.sigma, letters)
    if not _squares(as_stated.values[0], as_stated.sigma) - level.squares > DECISIVE:
        return
    ratios = _ratios(capture, bands, radiometry, channels, view, SHIFTS_NM)
    frames = [band.frames for band in capture.manifest.band]
    of_effects = _effects(as_stated, letters, frames, pattern_rows(mosaic.pattern))
    yield from _suspicions(as_stated, level, _best_shift(ratios, letters), of_effects)


def _ratios(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    channels: Mapping[str, str],
    view: SceneView | None,
    shifts_nm: NDArray[np.float64],
) -> _Ratios:
    """Measured over expected light with all tables displaced alike, by shifts (shift,)."""
    constants = {c.band: c.constant for c in radiometry.by_band}
    of_references = np.full((len(shifts_nm), 1, len(capture.band_ids)), np.nan)
    signal = np.full((1, len(capture.band_ids)), np.nan)
    for index, band in enumerate(capture.band_ids):
        tables = capture.references(band)
        if not tables or not constants.get(band, 0.0) > 0:
            continue
        units = [counts_over_constant(capture, tables[0], tables[0].radiance, channels[band], s) for s in shifts_nm]
        unit_of_table = counts_over_constant(capture, tables[0], tables[0].radiance, channels[band])
        if unit_of_table is not None and all(unit is not None for unit in units):
            signal[0, index] = constants[band] * unit_of_table
            of_references[:, 0, index] = np.log(signal[0, index] / np.array(units, float))
    sigma = np.full((1, len(capture.band_ids)), SIGMA_OF_CONSTANT)
    if view is None or not view.scene.diffuse:
        return _Ratios(of_references, sigma, signal)
    paints = light_of_paints(capture, bands, radiometry, channels, view, shifts_nm)
    stray = STRAY_LIGHT / np.maximum(paints.brightness, STRAY_LIGHT)
    of_paints = np.sqrt(SIGMA_OF_PAINT**2 + stray**2 + paints.scatter**2)
    return _Ratios(
        np.concatenate([of_references, paints.ratios], axis=1),
        np.concatenate([sigma, of_paints]),
        np.concatenate([signal, paints.signal]),
    )


def _centred(values: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """(quantity, band) values less the mean of each quantity, over sigma; 0 without a value."""
    weight = np.where(np.isfinite(values), sigma**-2.0, 0.0)
    filled = np.where(np.isfinite(values), values, 0.0)
    mean = np.sum(weight * filled, axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    return np.asarray(np.sqrt(weight) * (filled - mean), np.float64)


def _squares(values: NDArray[np.float64], sigma: NDArray[np.float64]) -> float:
    """Sum of squares of the bands about the mean of each quantity."""
    return float(np.sum(_centred(values, sigma) ** 2))


def _without(
    values: NDArray[np.float64], sigma: NDArray[np.float64], pattern: NDArray[np.float64]
) -> tuple[float, float]:
    """Best factor of a pattern (quantity, band), and the sum of squares that it leaves."""
    of_values = _centred(values, sigma)
    of_pattern = _centred(np.where(np.isfinite(values), pattern, np.nan), sigma)
    factor = float(np.sum(of_values * of_pattern) / max(float(np.sum(of_pattern**2)), 1e-300))
    return factor, float(np.sum((of_values - factor * of_pattern) ** 2))


def _best_level(values: NDArray[np.float64], sigma: NDArray[np.float64], letters: NDArray[np.str_]) -> _Cause:
    """The channel whose other level explains most."""
    causes = []
    for letter in np.unique(letters).tolist():
        size, squares = _without(values, sigma, np.broadcast_to(letters == letter, values.shape).astype(float))
        causes.append(_Cause(letter, size, squares))
    return min(causes, key=lambda cause: cause.squares)


def _best_shift(ratios: _Ratios, letters: NDArray[np.str_]) -> _Cause:
    """The channel whose displaced table explains most, others as stated."""
    unmoved, causes = ratios.values[int(np.flatnonzero(SHIFTS_NM == 0)[0])], []
    for letter in np.unique(letters).tolist():
        moved = np.where(letters == letter, ratios.values, unmoved)
        squares = np.array([_squares(values, ratios.sigma) for values in moved])
        best = int(np.clip(np.argmin(squares), 1, len(SHIFTS_NM) - 2))
        bend, slope, least = np.polyfit(SHIFTS_NM[best - 1 : best + 2], squares[best - 1 : best + 2], 2)
        if bend > 0:
            size = float(np.clip(-slope / (2 * bend), *SHIFTS_NM[[best - 1, best + 1]]))
            causes.append(_Cause(letter, size, max(float(np.polyval((bend, slope, least), size)), 0.0)))
    return min(causes, key=lambda cause: cause.squares, default=_Cause("", 0.0, np.inf))


def _effects(
    as_stated: _Ratios, letters: NDArray[np.str_], frames: Sequence[tuple[str, ...]], rows: Sequence[str]
) -> float:
    """Least sum of squares that an effect of the sensor on all channels leaves.

    Counts that are added, charge of neighbours, and counts that bend change dim channels more than bright ones, as a
    wrong table of one of them does.
    """
    cell = np.array([[*row] for row in rows])
    neighbours = np.stack([np.roll(cell, step, axis) for step in (-1, 1) for axis in (0, 1)])
    received = np.zeros_like(as_stated.signal)
    for index, letter in enumerate(letters):
        adjacent = neighbours[:, cell == letter]
        for other, other_letter in enumerate(letters):
            if frames[other] == frames[index]:
                received[:, index] += np.mean(adjacent == other_letter) * as_stated.signal[:, other]
    inverse = 1 / np.maximum(as_stated.signal, 1e-300)
    fits = [_without(as_stated.values[0], as_stated.sigma, pattern) for pattern in (inverse, received * inverse)]
    one_sided_squares = [squares for size, squares in fits if size > 0]
    return min([*one_sided_squares, _without(as_stated.values[0], as_stated.sigma, as_stated.signal)[1]])


def _suspicions(as_stated: _Ratios, level: _Cause, shift: _Cause, of_effects: float) -> Iterator[Suspicion]:
    """The suspicion of a channel whose deviation no effect of all channels explains."""
    finite = np.isfinite(as_stated.values[0])
    degrees = max(int(np.count_nonzero(finite) - np.count_nonzero(finite.any(axis=1)) - 1), 1)
    best = min(level.squares, shift.squares)
    if best > LARGEST_MISFIT * degrees or of_effects - best < DECISIVE:
        return
    if level.squares - shift.squares > DECISIVE and abs(shift.size) > SMALLEST_SHIFT_NM:
        yield Suspicion(
            f"the sensitivity of {shift.letter} is displaced by {-shift.size:+.0f} nm in its table",
            f"camera.quantum_efficiency ({shift.letter})",
            f"Its C and the light of the paints deviate from those of the other channels, by up to "
            f"{_largest(as_stated):.0%}; with the table moved by {shift.size:+.0f} nm they agree.",
        )
    elif abs(level.size) > SMALLEST_LEVEL:
        alike = f", or it is displaced by about {-shift.size:+.0f} nm" if shift.letter == level.letter else ""
        yield Suspicion(
            f"the table of the sensitivity of {level.letter} does not suit the references or the lamp",
            f"camera.quantum_efficiency ({level.letter})",
            f"It gives {np.exp(level.size):.3f} times the light of the other channels. Its level is wrong{alike}: "
            "these frames do not decide. Photograph a chart of known reflectances, or a second source of another "
            "spectrum.",
        )


def _largest(as_stated: _Ratios) -> float:
    """Largest deviation of a band from the mean of its quantity, natural log."""
    return float(np.max(np.abs(_centred(as_stated.values[0], as_stated.sigma) * as_stated.sigma)))
