"""What a lens does to the light before the sensor: blur by wavelength and field position, vignetting.

Field height is the distance from the middle of the frame over that of a corner pixel, 0 .. 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["Blur", "Vignetting", "field_height"]

# Standard deviations at which the point spread ends, and mixtures of how many Gaussians stand for a field.
_REACH = 4.0
_NODES = 5


def field_height(shape: tuple[int, int], rows: slice) -> NDArray[np.float64]:
    """(rows, x) field height of those rows of a frame of ``shape`` (y, x)."""
    y, x = ((size - 1) / 2 for size in shape)
    v = np.arange(rows.start, rows.stop)[:, None] - y
    return np.hypot(v, np.arange(shape[1]) - x) / max(np.hypot(x, y), 0.5)


@dataclass(frozen=True, eq=False)
class Vignetting:
    """Relative illumination (n,) by field height (n,), linear in between; 1 in the middle of most lenses."""

    field: NDArray[np.float64]
    illumination: NDArray[np.float64]

    def at(self, shape: tuple[int, int], rows: slice) -> NDArray[np.float64]:
        """(rows, x) factor for those rows of a frame."""
        return np.interp(field_height(shape, rows), self.field, self.illumination)


@dataclass(frozen=True, eq=False)
class Blur:
    """The optical point spread: Gaussian, its variance linear in the square of the field height.

    wavelength_nm, centre_px, corner_px : (n,) standard deviations in px in the middle of the frame and in its
    corners, linear in wavelength between the samples, held beyond.
    """

    wavelength_nm: NDArray[np.float64]
    centre_px: NDArray[np.float64]
    corner_px: NDArray[np.float64]

    @property
    def reach_px(self) -> int:
        """How far light spreads at most."""
        return int(_REACH * max(self.centre_px.max(), self.corner_px.max()) + 0.5)

    def spread(
        self, radiance: NDArray, wavelength_nm: NDArray[np.float64], shape: tuple[int, int], rows: slice
    ) -> NDArray[np.float64]:
        """Blurred radiance (y, x, wavelength) of ``rows`` of a frame of ``shape``, as bright in sum.

        Light that would leave the given rows is mirrored back: pass ``reach_px`` rows more than are wanted. A
        point between two heights of field spreads as the mixture of their Gaussians that has its variance.
        """
        centre = np.interp(wavelength_nm, self.wavelength_nm, self.centre_px)
        corner = np.interp(wavelength_nm, self.wavelength_nm, self.corner_px)
        same = np.array_equal(centre, corner)
        nodes = np.zeros(1) if same else np.linspace(0, 1, _NODES)
        square = field_height(shape, rows) ** 2
        spread = np.zeros(radiance.shape)
        for index, node in enumerate(nodes):
            share = 1.0 if same else np.maximum(1 - np.abs(square - node) * (_NODES - 1), 0)
            for k, (low, high) in enumerate(zip(centre, corner, strict=True)):
                sigma = float(np.sqrt(low**2 + (high**2 - low**2) * nodes[index]))
                plane = radiance[..., k].astype(np.float64) * share
                spread[..., k] += gaussian_filter(plane, sigma, mode="reflect", radius=self._radius(sigma))
        return spread

    @staticmethod
    def _radius(sigma: float) -> int:
        return int(_REACH * sigma + 0.5)
