"""Strongest waves over the image: straight ones and rings."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.fft import fft2

from .residual_data import ResidualData

__all__ = ["Wave", "strongest_waves"]

#: Fewest waves over the image; longer ones are fitted by cosines.
_MIN_WAVES = 3

#: Smallest side of an image with rings, px: smaller ones hold no rings of several waves that pixels resolve.
_MIN_SIDE_FOR_RINGS_PX = 48

#: Numerics: side to which images are averaged to find the curvature of rings, px: limits the time.
_COARSE_SIDE_PX = 128

#: Numerics: halvings of the steps in frequency and curvature when a wave is refined.
_REFINEMENTS = 6


class Wave(NamedTuple):
    """The strongest wave of its kind."""

    #: Cosine and sine of the wave over the image.
    maps: ImageMaps
    #: Index of the band in which it is strongest; None for all bands together.
    band: int | None
    #: Number of frequencies and curvatures among which it is the strongest.
    num_trials: int


def strongest_waves(data: ResidualData, operator: NDArray[Any]) -> Iterator[Wave]:
    """Strongest wave and strongest rings, in all bands together and in one band alone.

    Rings about any centre have the phase c r^2 of interference between curved faces.

    Parameters
    ----------
    data
        Residual.
    operator
        (band, y, x) change of the signal by a map that is 1 everywhere, DN.

    Yields
    ------
    Wave
        Straight waves, then rings if the image is large enough for them; each of all bands, then of one band.
    """
    shapes = operator * data.weight
    images = shapes * data.marginal_residual
    size = np.sum(shapes**2, axis=(1, 2))
    for rings in (False, True) if min(data.shape) >= _MIN_SIDE_FOR_RINGS_PX else (False,):
        alone = [_strongest(image, rings)[0] / max(s, 1e-30) for image, s in zip(images, size, strict=True)]
        for band in (None, int(np.argmax(alone))):
            image = images.sum(axis=0) if band is None else images[band]
            _, coarse_wave, count = _strongest(image, rings)
            frequency, curvature = _refined(image, coarse_wave, rings)
            yield Wave(ImageMaps("wave", per_px=frequency, curvature=float(curvature)), band, count)


def _strongest(image: NDArray[Any], rings: bool) -> tuple[float, tuple[float, float, float], int]:
    """Power, (frequency down, right; curvature) per px and px^2, and the number of trials."""
    step = -(-max(image.shape) // _COARSE_SIDE_PX) if rings else 1
    rows, columns = (n // step for n in image.shape)
    coarse = image[: rows * step, : columns * step].reshape(rows, step, columns, step).sum(axis=(1, 3))
    coarse = coarse.astype(np.float32)
    side = max(rows, columns)
    y, x = np.arange(rows)[:, None], np.arange(columns)
    frequencies = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)
    slow = np.hypot(rows * frequencies[0], columns * frequencies[1]) < _MIN_WAVES
    # neighbouring curvatures differ by half a wave from the centre to a corner
    largest = 1 / (2 * side)  # from the finest wave one way to the finest the other across the image
    curvatures = np.arange(2 * _MIN_WAVES / side**2, largest, 1 / side**2) if rings else [0.0]
    best = (-1.0, (0.0, 0.0, 0.0))
    for c in curvatures:
        down, right = (
            np.exp(-2j * np.pi * c * (position - n / 2) ** 2).astype(np.complex64)
            for position, n in ((y, rows), (x, columns))
        )
        power = np.abs(fft2(coarse * down * right)) ** 2
        if not rings:
            power[slow] = 0
        i, j = np.unravel_index(int(np.argmax(power)), power.shape)
        if power[i, j] > best[0]:
            per_row, per_column = float(frequencies[0][i, 0]), float(frequencies[1][j])
            # about the corner of the image, as in the maps: (y - m)^2 = y^2 - 2 m y + m^2
            best = (float(power[i, j]), (per_row - c * rows, per_column - c * columns, float(c)))
    per_row, per_column, c = best[1]
    return best[0], (per_row / step, per_column / step, c / step**2), len(curvatures) * rows * columns // 2


def _refined(image: NDArray[Any], start: tuple[float, float, float], rings: bool) -> tuple[tuple[float, float], float]:
    """Frequency and curvature of the largest power between the values tried."""
    y, x = (np.arange(n) for n in image.shape)
    side = max(image.shape)

    def power(f: tuple[float, ...]) -> float:
        left, right = (np.exp(-2j * np.pi * (f[k] * n + f[2] * n**2)) for k, n in ((0, y), (1, x)))
        return float(np.abs(left @ image @ right) ** 2)

    best, step = start, 0.5 / side
    for _ in range(_REFINEMENTS):
        moves = product((-1, 0, 1), (-1, 0, 1), (-1, 0, 1) if rings else (0,))
        trials = [(best[0] + (i - k) * step, best[1] + (j - k) * step, best[2] + k * step / side) for i, j, k in moves]
        best = max(trials, key=power)
        step /= 2
    return (best[0], best[1]), best[2]
