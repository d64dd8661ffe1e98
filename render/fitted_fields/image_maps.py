"""Maps over the picture, fixed on the sensor: rows, columns, smooth waves, one wave, bells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, identity, kron, lil_matrix

__all__ = ["ImageMaps"]

#: Order beyond which cosines are scaled down: the prior width of smooth fields falls there.
_CORNER = 3.0

#: A bell has this width in units of the distance between bells, and is cut off at so many widths.
_BELL, _CUT = 0.6, 5.0


@dataclass(frozen=True)
class ImageMaps:
    """A number k of maps over a picture.

    kind : "rows" and "columns" (one map each), "cosines" (products with up to ``order`` half waves together), "wave"
    (cosine and sine of ``per_px``, waves per px downwards and to the right, and of ``curvature`` times the squared
    distance from the first pixel, waves per px^2: rings about some centre; each times the cosines up to ``order``),
    "bells" (about ``centres``, (x, y) px, ``pitch`` px apart). nm : the wavelength for which a wave is given where it
    goes as the inverse of the wavelength, as interference in one gap does; 0 where it is the same in all bands.
    """

    kind: Literal["rows", "columns", "cosines", "wave", "bells"]
    order: int = 0
    per_px: tuple[float, float] = (0.0, 0.0)
    curvature: float = 0.0
    centres: tuple[tuple[float, float], ...] = ()
    pitch: float = 1.0
    nm: float = 0.0

    def at(self, nm: float) -> ImageMaps:
        """The maps of a band of this mean wavelength."""
        if not self.nm:
            return self
        down, right = (self.nm / nm * f for f in self.per_px)
        return replace(self, per_px=(down, right), curvature=self.nm / nm * self.curvature, nm=nm)

    def count(self, shape: tuple[int, int]) -> int:
        """Their number k in a picture of rows and columns."""
        if self.kind == "bells":
            return len(self.centres)
        products = (self.order + 1) * (self.order + 2) // 2
        return {"rows": shape[0], "columns": shape[1], "cosines": products, "wave": 2 * products}[self.kind]

    def matrix(self, shape: tuple[int, int]) -> NDArray[np.float64] | csr_matrix:
        """(k, pixel) the maps' values in a picture of rows and columns."""
        if self.kind == "rows":
            return csr_matrix(kron(identity(shape[0]), np.ones((1, shape[1]))))
        if self.kind == "columns":
            return csr_matrix(kron(np.ones((1, shape[0])), identity(shape[1])))
        if self.kind == "cosines":
            return _cosines(shape, self.order)
        if self.kind == "wave":
            y, x = np.indices(shape)
            waves = self.per_px[0] * y + self.per_px[1] * x + self.curvature * (y**2 + x**2)
            phase = 2 * np.pi * waves.ravel()
            strength = _cosines(shape, self.order)
            return np.concatenate([strength * np.cos(phase), strength * np.sin(phase)])
        return _bells(shape, self.centres, self.pitch)


def _cosines(shape: tuple[int, int], order: int) -> NDArray[np.float64]:
    y, x = ((np.arange(n) + 0.5) / n for n in shape)
    found = []
    for i in range(order + 1):
        for j in range(order + 1 - i):
            size = 1 / (1 + (np.hypot(i, j) / _CORNER) ** 2)
            found.append(size * np.outer(np.cos(np.pi * i * y), np.cos(np.pi * j * x)).ravel())
    return np.array(found)


def _bells(shape: tuple[int, int], centres: tuple[tuple[float, float], ...], pitch: float) -> csr_matrix:
    y, x = np.indices(shape)
    wide = _BELL * pitch
    found = lil_matrix((len(centres), shape[0] * shape[1]))
    for index, (u, v) in enumerate(centres):
        square = ((y - v) ** 2 + (x - u) ** 2).ravel()
        near = np.flatnonzero(square < (_CUT * wide) ** 2)
        found[index, near] = np.exp(-square[near] / (2 * wide**2))
    return csr_matrix(found)
