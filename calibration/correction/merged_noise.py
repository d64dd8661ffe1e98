"""Noise of merged pictures, which hold floating-point values without rounding.

The variance of a value x is taken as x / gain + (read_noise / gain)^2, as that of a count, with the gain in electrons
per unit of the pictures. It is stated, or a line is fitted to variances by level of light.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.optimize import nnls

from ..capture import Capture, FrameTable
from .noise import NoiseModel, NoiseSource
from .picture_noise import clipped_variance, second_differences, smooth_pixels, steps_of_cells

__all__ = ["measure_merged_noise"]

#: Levels of light of a table whose variances are compared.
_LEVELS = 16
#: Rounds of the fit: its weights depend on the line.
_ROUNDS = 10
#: Smallest share of the largest variance that a weight assumes, so that a dark level does not decide alone.
_SMALLEST_SHARE = 1e-3
#: Differences of neighbours share pixels: this share of them is independent.
_INDEPENDENT_SHARE = 1 / 3


def _levels(
    values: NDArray[np.float64], levels: NDArray[np.float64], degrees: float
) -> Iterator[tuple[float, float, float]]:
    """Level, variance and degrees of freedom of deviations (n,), in groups by level."""
    for group in np.array_split(np.argsort(levels), _LEVELS):
        variance = clipped_variance(values[group])
        if np.isfinite(variance):
            yield float(levels[group].mean()), variance, degrees * group.size


def _by_repeats(capture: Capture, table: FrameTable) -> Iterator[tuple[float, float, float]]:
    """Variances of repeats by level of light."""
    stack = capture.frames(table)
    good = stack.max(axis=0) < capture.saturation_dn
    count = len(stack)
    mean = stack.mean(axis=0)
    # the lamp's power may differ between repeats: each is scaled to the mean of all
    scale = mean[good].sum() / stack[:, good].sum(axis=1)
    deviations = ((stack * scale[:, None, None] - mean) * np.sqrt(count / (count - 1)))[:, good]
    yield from _levels(deviations.ravel(), np.tile(mean[good], count), (count - 1) / count)


def _by_neighbours(capture: Capture, table: FrameTable) -> Iterator[tuple[float, float, float]]:
    """Variances of one picture by level of light, from neighbouring pixels."""
    steps = steps_of_cells(capture.cell)
    picture = capture.frames(table)[0]
    usable = (picture < capture.saturation_dn) & (picture > 0)
    differences, means = second_differences(picture, smooth_pixels(picture, usable, steps), steps)
    yield from _levels(differences, means, _INDEPENDENT_SHARE)


def _line(points: list[tuple[float, float, float]]) -> NDArray[np.float64]:
    """(floor, slope) of variance against level, neither below 0."""
    level, variance, degrees = np.array(points).T
    model = np.maximum(variance, _SMALLEST_SHARE * variance.max())
    line: NDArray[np.float64] = np.zeros(2)
    for _ in range(_ROUNDS):
        weight = np.sqrt(degrees / 2) / model
        design = np.stack([np.ones_like(level), np.maximum(level, 0.0)], axis=1) * weight[:, None]
        size = np.linalg.norm(design, axis=0)
        line = nnls(design / size, variance * weight)[0] / size
        fitted = line[0] + line[1] * np.maximum(level, 0.0)
        model = np.maximum(fitted, _SMALLEST_SHARE * variance.max())
    return line


def measure_merged_noise(capture: Capture) -> NoiseModel:
    """Noise of merged pictures, of the kind that the capture states.

    Parameters
    ----------
    capture
        A capture with [noise].

    Returns
    -------
    NoiseModel
        Without rounding, with a note that labels where the noise comes from.

    Raises
    ------
    InputError
        For a faulty frame, for "repeats" without repeats, and for pictures without any noise.
    """
    table = capture.manifest.noise
    if table is None:
        raise ValueError("the capture has no [noise]")
    where = f"{capture.folder / 'capture.toml'}: noise.kind"
    if table.kind == "poisson":
        read = table.read_noise_e or 0.0
        note = f"merged pictures: the noise is stated, {table.gain_e_per_unit:g} electrons per unit, {read:g} e- rms"
        return NoiseModel(table.gain_e_per_unit, None, read, None, (note,), "stated", 0.0)
    tables: list[FrameTable] = [*capture.manifest.band]
    source: NoiseSource = "estimated"
    if table.kind == "repeats":
        tables = [each for each in tables if len(each.frames) > 1]
        source = "band repeats"
        if not tables:
            hint = 'List the repeats in frames, or state kind = "estimated".'
            raise InputError(where, "'repeats'", "a band with two frames or more", hint)
    variances = _by_repeats if table.kind == "repeats" else _by_neighbours
    points = [point for each in tables for point in variances(capture, each)]
    if not points or max(point[1] for point in points) <= 0:
        fault = "repeats without any difference" if table.kind == "repeats" else "pictures without smooth areas"
        raise InputError(where, fault, "pictures with noise", 'State kind = "poisson" with its gain.')
    floor, slope = _line(points)
    # without shot noise the gain is so large that it does not count
    gain = 1 / max(slope, 1e-9 * (floor + slope))
    kind = "the repeats of the bands" if source == "band repeats" else "neighbouring pixels (estimated)"
    read = float(gain * np.sqrt(floor))
    note = f"merged pictures: the noise comes from {kind}, {gain:.4g} electrons per unit, {read:.3g} e- rms"
    return NoiseModel(float(gain), None, read, None, (note,), source, 0.0)
