"""The optics of a camera: blur by wavelength and field position, and vignetting.

Field height is the distance from the centre of the frame relative to that of a corner pixel, 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["Blur", "Vignetting", "field_height"]

# Radius of the point spread in standard deviations, and number of Gaussians that approximate it over the field.
_REACH = 4.0
_NODES = 5


def field_height(shape: tuple[int, int], rows: slice) -> NDArray[np.float64]:
    """(rows, x) field height of some rows of a frame of ``shape`` (y, x)."""
    y, x = ((size - 1) / 2 for size in shape)
    v = np.arange(rows.start, rows.stop)[:, None] - y
    return np.hypot(v, np.arange(shape[1]) - x) / max(np.hypot(x, y), 0.5)


@dataclass(frozen=True, eq=False)
class Vignetting:
    """Relative illumination (n,), 0 to 1, by field height (n,), interpolated linearly."""

    field: NDArray[np.float64]
    illumination: NDArray[np.float64]

    def at(self, shape: tuple[int, int], rows: slice) -> NDArray[np.float64]:
        """(rows, x) relative illumination of some rows of a frame of ``shape`` (y, x)."""
        return np.interp(field_height(shape, rows), self.field, self.illumination)


@dataclass(frozen=True, eq=False)
class Blur:
    """A Gaussian point spread whose variance is linear in the square of the field height.

    wavelength_nm : (n,). centre_px, corner_px : (n,) standard deviations in px at the centre and in the corners of the
    frame, interpolated linearly in wavelength, constant beyond.
    """

    wavelength_nm: NDArray[np.float64]
    centre_px: NDArray[np.float64]
    corner_px: NDArray[np.float64]

    @property
    def reach_px(self) -> int:
        """Largest radius of the point spread, px."""
        return int(_REACH * max(self.centre_px.max(), self.corner_px.max()) + 0.5)

    def spread(
        self, radiance: NDArray, wavelength_nm: NDArray[np.float64], shape: tuple[int, int], rows: slice
    ) -> NDArray[np.float64]:
        """Blurred radiance (y, x, wavelength) of ``rows`` of a frame of ``shape``; the sum is unchanged.

        Light is reflected at the borders of the given rows: pass ``reach_px`` rows more than needed. The point spread
        between two field heights is the mixture of their Gaussians with the right variance.
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
