"""Offsets and gains that are fixed on the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..fields import Acts, ImageMaps
from .excess import Excess
from .field import each_band, fixed_spectrum
from .form import Columns, Form, equations, scaled
from .spot_cells import Spot, cells

__all__ = ["sensor_forms"]

_ORDER = 10

_ACTS: dict[str, Acts] = {"sensor-offset": "offset", "sensor-gain": "gain"}

#: Frequencies below this, in waves over the picture, are left to cosines.
_FEWEST_WAVES = 3


def sensor_forms(excess: Excess, spot: Spot | None) -> Iterator[Form]:
    """All offsets and gains: over rows, columns, smoothly, as one wave, in one spot; in all bands or in each."""
    bases = {
        "rows": ImageMaps("rows"), "columns": ImageMaps("columns"),
        "a smooth pattern": ImageMaps("cosines", order=_ORDER),
    }  # fmt: skip
    for words, maps in bases.items():
        yield from _both(excess, words, maps, sharp=words != "a smooth pattern")
    for family, operator in _operators(excess).items():
        for frequency, band in _waves(excess, operator):
            maps = ImageMaps("wave", per_px=frequency)
            made = _columns(operator, maps.matrix(excess.shape))
            n = equations(excess, made)
            count = excess.shape[0] * excess.shape[1] // 2
            only = np.ones(len(excess.bands)) if band is None else np.eye(len(excess.bands))[band]
            acts = _ACTS[family]
            yield Form(family, "a wave", fixed_spectrum(n, only), made, acts, maps, sharp=True, choices=count)
            each = each_band(n)
            yield Form(family, "a wave in each band", each, made, acts, maps, sharp=True, choices=count)
    if spot is not None:
        yield from _both(excess, "a spot", cells(spot.region), local=True)


def _operators(excess: Excess) -> dict[str, NDArray[Any]]:
    return {"sensor-offset": 1 / np.maximum(excess.flat, 0.05), "sensor-gain": excess.signal}


def _columns(operator: NDArray[Any], basis: NDArray[Any] | csr_matrix) -> Columns:
    return lambda band: scaled(basis, operator[band])


def _both(
    excess: Excess, words: str, maps: ImageMaps, local: bool = False, sharp: bool = False
) -> Iterator[Form]:
    bands, basis = len(excess.bands), maps.matrix(excess.shape)
    for family, operator in _operators(excess).items():
        acts = _ACTS[family]
        made = _columns(operator, basis)
        n = equations(excess, made)
        yield Form(
            family, words, fixed_spectrum(n, np.ones(bands)), made, acts, maps, local=local, sharp=sharp
        )
        strongest = int(np.argmax(each_band(n).size))
        one = fixed_spectrum(n, np.eye(bands)[strongest])
        yield Form(
            family, f"{words} in one band", one, made, acts, maps, local=local, sharp=True, choices=bands
        )
        if not local:
            yield Form(family, f"{words} in each band", each_band(n), made, acts, maps, sharp=sharp)


def _waves(excess: Excess, operator: NDArray[Any]) -> list[tuple[tuple[float, float], int | None]]:
    """The strongest frequency over all bands together and in one band alone."""
    shapes = operator * excess.weight
    images = shapes * excess.weighed
    size = np.maximum(np.sum(shapes**2, axis=(1, 2)), 1e-30)
    power = np.abs(np.fft.rfft2(images)) ** 2 / size[:, None, None]
    together = np.abs(np.fft.rfft2(images.sum(axis=0))) ** 2 / size.sum()
    strongest = int(np.argmax([_highest(p)[0] for p in power]))
    trials: list[tuple[NDArray[Any], int | None]] = [(together, None), (power[strongest], strongest)]
    return [(_refined(images, _highest(image)[1], band), band) for image, band in trials]


def _highest(power: NDArray[Any]) -> tuple[float, tuple[float, float]]:
    down = np.fft.fftfreq(power.shape[0]) * power.shape[0]
    right = np.arange(power.shape[1])
    allowed = np.hypot(down[:, None], right) >= _FEWEST_WAVES
    power = np.where(allowed, power, 0)
    i, j = np.unravel_index(np.argmax(power), power.shape)
    width = 2 * (power.shape[1] - 1)
    return float(power[i, j]), (float(down[i]) / power.shape[0], float(right[j]) / width)


def _refined(images: NDArray[Any], frequency: tuple[float, float], band: int | None) -> tuple[float, float]:
    """The frequency between those of the discrete transform, by power in the band or in all bands together."""
    image = images.sum(axis=0) if band is None else images[band]
    y, x = (np.arange(n) for n in image.shape)

    def power(f: tuple[float, float]) -> float:
        left, right = np.exp(-2j * np.pi * f[0] * y), np.exp(-2j * np.pi * f[1] * x)
        return float(np.abs(left @ image @ right) ** 2)

    best, step = frequency, 0.5 / max(image.shape)
    for _ in range(5):
        trials = [(best[0] + i * step, best[1] + j * step) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        best = max(trials, key=power)
        step /= 2
    return best
