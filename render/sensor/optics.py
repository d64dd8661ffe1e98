"""The optics of a camera: blur by wavelength and field position, and vignetting.

Field height is the distance from the centre of the frame relative to that of a corner pixel, 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["Blur", "Vignetting", "field_height"]

#: Radius of the point spread, standard deviations.
_REACH = 4.0

#: Number of Gaussians that approximate the point spread over the field.
_NODES = 5


def field_height(shape: tuple[int, int], rows: slice) -> NDArray[np.float64]:
    """Field height of some rows of a frame.

    Parameters
    ----------
    shape
        Rows and columns of the frame.
    rows
        The rows.

    Returns
    -------
    NDArray
        (rows, x) distance from the centre over that of a corner pixel, 0 to 1.
    """
    y, x = ((size - 1) / 2 for size in shape)
    v = np.arange(rows.start, rows.stop)[:, None] - y
    return np.hypot(v, np.arange(shape[1]) - x) / max(np.hypot(x, y), 0.5)


@dataclass(frozen=True, eq=False)
class Vignetting:
    """Relative illumination by field height, interpolated linearly."""

    #: (n,) field heights, 0 to 1, ascending.
    field: NDArray[np.float64]
    #: (n,) relative illumination, 0 to 1.
    illumination: NDArray[np.float64]

    def at(self, shape: tuple[int, int], rows: slice) -> NDArray[np.float64]:
        """Relative illumination of some rows of a frame.

        Parameters
        ----------
        shape
            Rows and columns of the frame.
        rows
            The rows.

        Returns
        -------
        NDArray
            (rows, x) relative illumination.
        """
        return np.interp(field_height(shape, rows), self.field, self.illumination)


@dataclass(frozen=True, eq=False)
class Blur:
    """A Gaussian point spread whose variance is linear in the square of the field height."""

    #: (n,) wavelengths, nm; between them standard deviations are interpolated linearly, beyond them constant.
    wavelength_nm: NDArray[np.float64]
    #: (n,) standard deviations at the centre of the frame, px.
    centre_px: NDArray[np.float64]
    #: (n,) standard deviations in its corners, px.
    corner_px: NDArray[np.float64]

    @property
    def reach_px(self) -> int:
        """Largest radius of the point spread, px."""
        return int(_REACH * max(self.centre_px.max(), self.corner_px.max()) + 0.5)

    def spread(
        self, radiance: NDArray, wavelength_nm: NDArray[np.float64], shape: tuple[int, int], rows: slice
    ) -> NDArray[np.float64]:
        """Blurred radiance of some rows of a frame; the sum is unchanged.

        Light is reflected at the borders of the given rows: pass ``reach_px`` rows more than needed. The point spread
        between two field heights is the mixture of their Gaussians with the right variance.

        Parameters
        ----------
        radiance
            (y, x, w) radiance of the rows.
        wavelength_nm
            (w,) wavelengths, nm.
        shape
            Rows and columns of the frame.
        rows
            The rows.

        Returns
        -------
        NDArray
            (y, x, w) blurred radiance.
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
        """Radius of the point spread of a standard deviation, px."""
        return int(_REACH * sigma + 0.5)
