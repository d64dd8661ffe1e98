"""Offsets and gains that are fixed on the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps, parts_of_levels
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .excess import Excess
from .field import each_band, fixed_spectrum
from .form import Columns, Form, equations, scaled
from .spot_cells import cells
from .waves import strongest_waves

__all__ = ["sensor_forms"]

_ORDER = 10

#: Cosines by which the strength and the phase of interference vary over the picture.
_ENVELOPE_ORDER = 8

#: How offsets and gains go with the time of exposure: light that leaks in, and a shutter that opens unevenly.
_BY_TIME = {"sensor-offset": "that grows with the exposure", "sensor-gain": "as of a shutter's opening"}

_ACTS: dict[str, Acts] = {"sensor-offset": "offset", "sensor-gain": "gain"}


def sensor_forms(
    excess: Excess, spot: NDArray[np.bool_] | None, of_one_band: NDArray[np.bool_] | None
) -> Iterator[Form]:
    """All offsets and gains: over rows, columns, smoothly, as waves or rings, in a spot; in all bands or in each.

    spot, of_one_band : (y, x) where the excess of all bands, and where that of one band, is densest.
    """
    bases = {
        "rows": ImageMaps("rows"),
        "columns": ImageMaps("columns"),
        "a smooth pattern": ImageMaps("cosines", order=_ORDER),
    }
    for words, maps in bases.items():
        yield from _both(excess, words, maps, sharp=words != "a smooth pattern")
    for family, operator in _operators(excess).items():
        for maps, band, count in strongest_waves(excess, operator):
            made = _columns(operator, maps.matrix(excess.shape))
            n = equations(excess, made)
            only = np.ones(len(excess.bands)) if band is None else np.eye(len(excess.bands))[band]
            acts, words = _ACTS[family], "rings" if maps.curvature else "a wave"
            alone = words if band is None else f"{words} in one band"
            count *= 1 if band is None else len(excess.bands)
            yield Form(family, alone, fixed_spectrum(n, only), made, acts, maps, sharp=True, choices=count)
            if family == "sensor-gain" and band is not None:
                yield _interference(excess, replace(maps, order=_ENVELOPE_ORDER, nm=float(excess.nm[band])), count)
            else:
                each = each_band(n)
                yield Form(family, f"{words} in each band", each, made, acts, maps, sharp=True, choices=count)
    if spot is not None:
        yield from _both(excess, "a spot", cells(spot), local=True)
    if of_one_band is not None:
        # alike in all bands it would have fewer cells than families that are fitted where all bands are off
        yield from _both(excess, "a spot", cells(of_one_band), local=True, together=False)
    yield _by_level(excess)


def _interference(excess: Excess, maps: ImageMaps, choices: int) -> Form:
    """Light reflected to and fro in one gap: waves by the wavelength, weaker where orders differ within a band."""

    def made(band: int) -> NDArray[Any] | csr_matrix:
        own = maps.at(float(excess.nm[band]))
        return scaled(own.matrix(excess.shape), excess.signal[band])

    fit = each_band(equations(excess, made))
    words = f"{'rings' if maps.curvature else 'a wave'} by the wavelength"
    return Form("sensor-gain", words, fit, made, "gain", maps, sharp=True, choices=choices)


def _by_level(excess: Excess) -> Form:
    """Counts added by the count: a converter's bits of wrong weight, an amplifier that bends otherwise than evenly."""
    counts = excess.signal * excess.flat
    most = float(counts[excess.used].max())

    def made(band: int) -> NDArray[Any] | csr_matrix:
        return scaled(parts_of_levels(counts[band].ravel(), most), 1 / np.maximum(excess.flat[band], 0.05))

    fit = fixed_spectrum(equations(excess, made), np.ones(len(excess.bands)))
    words, even = "steps or bends of the counts by their level", ImageMaps("cosines")
    return Form("sensor-offset", words, fit, made, "levels", even, most_dn=most)


def _operators(excess: Excess) -> dict[str, NDArray[Any]]:
    return {"sensor-offset": 1 / np.maximum(excess.flat, 0.05), "sensor-gain": excess.signal}


def _columns(operator: NDArray[Any], basis: NDArray[Any] | csr_matrix) -> Columns:
    return lambda band: scaled(basis, operator[band])


def _both(
    excess: Excess, words: str, maps: ImageMaps, *, local: bool = False, sharp: bool = False, together: bool = True
) -> Iterator[Form]:
    """Offsets, then gains, by the same maps. together : in all bands alike, too."""
    bands, basis = len(excess.bands), maps.matrix(excess.shape)
    opened = 1 / excess.exposure_s - 1 / excess.flat_exposure_s
    by_time = {"sensor-offset": excess.exposure_s, "sensor-gain": opened}
    for family, operator in _operators(excess).items():
        acts = _ACTS[family]
        made = _columns(operator, basis)
        n = equations(excess, made)
        if together:
            alike = fixed_spectrum(n, np.ones(bands))
            yield Form(family, words, alike, made, acts, maps, local=local, sharp=sharp)
        each = each_band(n)
        strongest = int(np.argmax(each.size))
        one = fixed_spectrum(n, np.eye(bands)[strongest])
        yield Form(family, f"{words} in one band", one, made, acts, maps, local=local, sharp=True, choices=bands)
        if not local:
            yield Form(family, f"{words} in each band", each, made, acts, maps, sharp=sharp)
            timed = fixed_spectrum(n, by_time[family])
            name = f"{words} {_BY_TIME[family]}"
            yield Form(family, name, timed, made, acts, maps, sharp=sharp)
