"""Colours encoded for a screen by sRGB's curve, or decoded once too often."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Linear value up to which sRGB's curve is a line (IEC 61966-2-1).
_LINEAR = 0.0031308
#: Slope of that line.
_SLOPE = 12.92
#: Exponent of the curve above it.
_EXPONENT = 2.4
#: Offset of the curve above it.
_OFFSET = 0.055


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """In colour only: encoded, cut off at 1 or not, and decoded."""
    if pictures.wavelength_nm is not None:
        return
    base = np.maximum(pictures.baseline, 0.0)
    versions = {
        "encoded": _encoded(base),
        "encoded and cut off at 1": _encoded(np.minimum(base, 1.0)),
        "decoded": _decoded(base),
    }
    for name, picture in versions.items():
        yield Trial(fixed_values({"curve": f"sRGB, {name}"}), fixed=picture - pictures.baseline, selected=1)


def _encoded(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of sRGB's curve."""
    curved = (1 + _OFFSET) * np.maximum(linear, _LINEAR) ** (1 / _EXPONENT) - _OFFSET
    return np.where(linear <= _LINEAR, _SLOPE * linear, curved)


def _decoded(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear values of sRGB's curve."""
    line = _SLOPE * _LINEAR
    curved = ((np.maximum(values, line) + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
    return np.where(values <= line, values / _SLOPE, curved)


CAUSE = Cause("screen-values", "Colours are encoded for a screen, or decoded once too often.", _trials)
