"""Maps over the picture, fixed on the sensor: lines, pixels, repeats, waves, bells.

A wave follows the two-beam interference of a plate or wedge: cos(2 pi (f . x + c |x|^2)), f and c in waves per px and
per px^2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, identity, kron, lil_matrix

__all__ = ["ImageMaps"]

#: Order beyond which cosines are scaled down as 1 / (1 + (order / 3)^2): smooth fields are more likely.
_CORNER = 3.0

#: Standard deviation of a bell, in units of the distance between bells: sums of bells are then smooth.
_BELL = 0.6

#: Distance at which a bell is cut off, in standard deviations: it is 4e-6 of its height there.
_CUT = 5.0


@dataclass(frozen=True)
class ImageMaps:
    """A number k of maps over a picture.

    - "rows" and "columns": one map for each row or column, 1 in it and 0 elsewhere
    - "pixels": one map for each pixel, 1 in it and 0 elsewhere
    - "repeat": one map for each place of a pattern that repeats every ``repeat`` rows and columns, 1 in that place
    - "quarters": one map for each quarter of the picture, 1 in it and 0 elsewhere
    - "cosines": products of cosines along rows and columns with up to ``order`` half waves together
    - "wave": cosine and sine of one wave, each times the cosines up to ``order``
    - "bells": Gaussians about ``centres``
    """

    #: Kind of the maps.
    kind: Literal["rows", "columns", "pixels", "repeat", "quarters", "cosines", "wave", "bells"]
    #: Most half waves of "cosines", and of the strength of a "wave".
    order: int = 0
    #: Frequency of a "wave" downwards and to the right, waves per px.
    per_px: tuple[float, float] = (0.0, 0.0)
    #: Curvature of a "wave", waves per px^2 of the squared distance from the first pixel, for rings about some centre.
    curvature: float = 0.0
    #: Centres (x, y) of "bells", px.
    centres: tuple[tuple[float, float], ...] = ()
    #: Distance between "bells", px.
    pitch: float = 1.0
    #: Wavelength of ``per_px`` and ``curvature``, nm, if they are proportional to its inverse; 0 if not.
    nm: float = 0.0
    #: Rows and columns of one "repeat", px.
    repeat: tuple[int, int] = (1, 1)

    def at(self, nm: float) -> ImageMaps:
        """Maps in a band.

        Parameters
        ----------
        nm
            Mean wavelength of the band, nm.

        Returns
        -------
        ImageMaps
            A wave whose frequency is scaled by the inverse of the wavelength; the same maps if ``nm`` is 0.
        """
        if not self.nm:
            return self
        down, right = (self.nm / nm * f for f in self.per_px)
        return replace(self, per_px=(down, right), curvature=self.nm / nm * self.curvature, nm=nm)

    def count(self, shape: tuple[int, int]) -> int:
        """Number k of the maps.

        Parameters
        ----------
        shape
            Rows and columns of the picture.

        Returns
        -------
        int
            The number of rows of ``matrix``.
        """
        if self.kind == "bells":
            return len(self.centres)
        products = (self.order + 1) * (self.order + 2) // 2
        counts = {"rows": shape[0], "columns": shape[1], "pixels": shape[0] * shape[1], "quarters": 4}
        counts["repeat"] = self.repeat[0] * self.repeat[1]
        return {**counts, "cosines": products, "wave": 2 * products}[self.kind]

    def matrix(self, shape: tuple[int, int]) -> NDArray[np.float64] | csr_matrix:
        """Values of the maps.

        Parameters
        ----------
        shape
            Rows and columns of the picture.

        Returns
        -------
        NDArray or csr_matrix
            (k, pixel) values, pixels row by row; dense for cosines and waves alone.
        """
        if self.kind == "rows":
            return csr_matrix(kron(identity(shape[0]), np.ones((1, shape[1]))))
        if self.kind == "columns":
            return csr_matrix(kron(np.ones((1, shape[0])), identity(shape[1])))
        if self.kind == "pixels":
            return csr_matrix(identity(shape[0] * shape[1]))
        if self.kind in ("repeat", "quarters"):
            y, x = np.indices(shape)
            height, width = self.repeat if self.kind == "repeat" else (2, 2)
            down, right = (y % height, x % width) if self.kind == "repeat" else (2 * y // shape[0], 2 * x // shape[1])
            index = (down * width + right).ravel()
            return csr_matrix((np.ones(index.size), (index, np.arange(index.size))), (height * width, index.size))
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
    """(k, pixel) products of cosines, those of high order scaled down."""
    y, x = ((np.arange(n) + 0.5) / n for n in shape)
    maps = []
    for i in range(order + 1):
        for j in range(order + 1 - i):
            size = 1 / (1 + (np.hypot(i, j) / _CORNER) ** 2)
            maps.append(size * np.outer(np.cos(np.pi * i * y), np.cos(np.pi * j * x)).ravel())
    return np.array(maps)


def _bells(shape: tuple[int, int], centres: tuple[tuple[float, float], ...], pitch: float) -> csr_matrix:
    """(k, pixel) Gaussians about centres, 1 there and 0 beyond the cut."""
    y, x = np.indices(shape)
    wide = _BELL * pitch
    bells = lil_matrix((len(centres), shape[0] * shape[1]))
    for index, (u, v) in enumerate(centres):
        square = ((y - v) ** 2 + (x - u) ** 2).ravel()
        near = np.flatnonzero(square < (_CUT * wide) ** 2)
        bells[index, near] = np.exp(-square[near] / (2 * wide**2))
    return csr_matrix(bells)
