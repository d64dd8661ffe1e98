"""Waves over the picture: straight ones by their frequency, rings by the curvature of their phase besides."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.fft import fft2

from .excess import Excess

__all__ = ["strongest_waves"]

#: Fewer waves than this over the picture are left to cosines.
_FEWEST = 3

#: Highest change of frequency across the picture, waves per px: from the finest one way to the finest the other.
_MOST_CURVED = 1.0

#: Pictures of fewer pixels a side hold no rings that are more than a few waves and not too fine.
_LEAST_FOR_RINGS = 48

#: Pictures are averaged to at most so many pixels a side to find the rings' curvature.
_COARSE = 128


def strongest_waves(excess: Excess, operator: NDArray[Any]) -> Iterator[tuple[ImageMaps, int | None, int]]:
    """The strongest wave and the strongest rings over all bands together and in one band alone.

    operator : (band, y, x) DN that a map of 1 changes. Yields the maps, the band or None, and among how many
    frequencies it is the strongest. Rings about any centre have the phase c r^2 of interference between curved faces.
    """
    shapes = operator * excess.weight
    images = shapes * excess.weighed
    size = np.sum(shapes**2, axis=(1, 2))
    for rings in (False, True) if min(excess.shape) >= _LEAST_FOR_RINGS else (False,):
        alone = [_strongest(image, rings)[0] / max(s, 1e-30) for image, s in zip(images, size, strict=True)]
        for band in (None, int(np.argmax(alone))):
            image = images.sum(axis=0) if band is None else images[band]
            _, found, count = _strongest(image, rings)
            frequency, curvature = _refined(image, found, rings)
            yield ImageMaps("wave", per_px=frequency, curvature=float(curvature)), band, count


def _strongest(image: NDArray[Any], rings: bool) -> tuple[float, tuple[float, float, float], int]:
    """Power, (frequency down, frequency right, curvature) per px and px^2, and the number of trials."""
    step = -(-max(image.shape) // _COARSE) if rings else 1
    rows, columns = (n // step for n in image.shape)
    coarse = image[: rows * step, : columns * step].reshape(rows, step, columns, step).sum(axis=(1, 3))
    coarse = coarse.astype(np.float32)
    side = max(rows, columns)
    y, x = np.arange(rows)[:, None], np.arange(columns)
    frequencies = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)
    slow = np.hypot(rows * frequencies[0], columns * frequencies[1]) < _FEWEST
    # neighbouring curvatures differ by half a wave from the centre to a corner
    curvatures = np.arange(2 * _FEWEST / side**2, _MOST_CURVED / (2 * side), 1 / side**2) if rings else [0.0]
    best = (-1.0, (0.0, 0.0, 0.0))
    for c in curvatures:
        down, right = (
            np.exp(-2j * np.pi * c * (place - n / 2) ** 2).astype(np.complex64)
            for place, n in ((y, rows), (x, columns))
        )
        power = np.abs(fft2(coarse * down * right)) ** 2
        if not rings:
            power[slow] = 0
        i, j = np.unravel_index(int(np.argmax(power)), power.shape)
        if power[i, j] > best[0]:
            own = float(frequencies[0][i, 0]), float(frequencies[1][j])
            # about the picture's corner, as in the maps: (y - m)^2 = y^2 - 2 m y + m^2
            best = (float(power[i, j]), (own[0] - c * rows, own[1] - c * columns, float(c)))
    per_row, per_column, c = best[1]
    return best[0], (per_row / step, per_column / step, c / step**2), len(curvatures) * rows * columns // 2


def _refined(image: NDArray[Any], start: tuple[float, float, float], rings: bool) -> tuple[tuple[float, float], float]:
    """The frequency and curvature between those tried, by power."""
    y, x = (np.arange(n) for n in image.shape)
    side = max(image.shape)

    def power(f: tuple[float, ...]) -> float:
        left, right = (np.exp(-2j * np.pi * (f[k] * n + f[2] * n**2)) for k, n in ((0, y), (1, x)))
        return float(np.abs(left @ image @ right) ** 2)

    best, step = start, 0.5 / side
    for _ in range(6):
        moves = product((-1, 0, 1), (-1, 0, 1), (-1, 0, 1) if rings else (0,))
        trials = [(best[0] + (i - k) * step, best[1] + (j - k) * step, best[2] + k * step / side) for i, j, k in moves]
        best = max(trials, key=power)
        step /= 2
    return (best[0], best[1]), best[2]
