"""Displacements of the picture and blurs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

from .excess import Excess
from .field import each_band, fixed_spectrum
from .form import Columns, Form, equations
from .image_bases import cosines

__all__ = ["optics_forms"]

_ORDER, _ORDER_OF_BLUR = 4, 2
_RADIUS = 2
_WIDE_PX = (1.5, 3.0, 6.0, 12.0, 24.0)


def optics_forms(excess: Excess) -> Iterator[Form]:
    """The picture moved or blurred: alike everywhere or not, in all bands, in one, or in each."""
    for words, order in (("the whole picture", 0), ("a smooth field", _ORDER)):
        made = _moves(excess, cosines(excess.shape, order))
        yield from _spectra(excess, "displacement", words, made)
    for words, order in (("the whole picture", 0), ("unevenly over the picture", _ORDER_OF_BLUR)):
        made = _near(excess, cosines(excess.shape, order), 1 if order else _RADIUS)
        yield from _spectra(excess, "blur", words, made)
    yield from _spectra(excess, "blur", "a wide halo", _halo(excess))


def _spectra(excess: Excess, family: str, words: str, made: Columns) -> Iterator[Form]:
    n, bands = equations(excess, made), len(excess.bands)
    yield Form(family, words, fixed_spectrum(n, np.ones(bands)), made)
    each = each_band(n)
    yield Form(family, f"{words}, in each band otherwise", each, made)
    strongest = int(np.argmax(each.size))
    yield Form(
        family,
        f"{words}, in one band",
        fixed_spectrum(n, np.eye(bands)[strongest]),
        made,
        sharp=True,
        choices=bands,
    )


def _moves(excess: Excess, basis: NDArray[Any]) -> Columns:
    def made(band: int) -> NDArray[Any]:
        return np.concatenate([way[band].ravel() * basis for way in excess.moved]).astype(np.float32)

    return made


def _near(excess: Excess, basis: NDArray[Any], radius: int) -> Columns:
    """Light exchanged with neighbours on opposite sides alike: that moves nothing."""
    steps = [(i, j) for i in range(radius + 1) for j in range(-radius, radius + 1) if (i > 0 or j > 0)]

    def made(band: int) -> NDArray[Any]:
        signal = excess.signal[band]
        found = []
        for step in steps:
            ends = [shift(signal, np.multiply(sign, step), order=0, mode="nearest") for sign in (1, -1)]
            found.append(((sum(ends) / 2 - signal).ravel() * basis).astype(np.float32))
        return np.concatenate(found)

    return made


def _halo(excess: Excess) -> Columns:
    def made(band: int) -> NDArray[Any]:
        signal = excess.signal[band]
        return np.array(
            [(gaussian_filter(signal, width, mode="nearest") - signal).ravel() for width in _WIDE_PX],
            np.float32,
        )

    return made
