"""Nominal flat field of a lens, by the cosine-fourth law of its field angles.

A real lens falls off further, by its mounts and its pupil. The comparison with a model fits that in a few terms, see
``fall_off_terms``. The sensitivities of single pixels are not known; their
scatter is estimated from the pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .correction import FlatField, uniform_flat
from .dark import DarkLibrary

__all__ = ["LensAxis", "fall_off_terms", "nominal_flat", "with_pixel_scatter"]


@dataclass(frozen=True)
class LensAxis:
    """Axis and focal length of a lens, which give its nominal fall-off."""

    #: Focal length, px.
    focal_length_px: float
    #: Column of the axis, px.
    u_px: float
    #: Row of the axis, px.
    v_px: float

    def radius_px(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Distances of pixels from the axis.

        Parameters
        ----------
        shape
            (height, width) of the frames, px.

        Returns
        -------
        NDArray
            (y, x) distances, px.
        """
        v, u = np.indices(shape)
        return np.hypot(u - self.u_px, v - self.v_px)


def nominal_flat(axis: LensAxis, shape: tuple[int, int], dark: DarkLibrary) -> FlatField:
    """Flat field by the cosine-fourth law.

    Parameters
    ----------
    axis
        Axis and focal length of the lens.
    shape
        (height, width) of the frames, px.
    dark
        The dark levels; all have weight 0 in this flat field.

    Returns
    -------
    FlatField
        Its response has mean 1; its ``mean_dn`` is infinite, since nothing was measured.
    """
    cosine_squared = 1 / (1 + (axis.radius_px(shape) / axis.focal_length_px) ** 2)
    response = cosine_squared**2
    return replace(uniform_flat(shape, dark), response=response / response.mean())


def with_pixel_scatter(flat: FlatField, relative_sigma: float) -> FlatField:
    """The same flat field with an uncertainty of every pixel's sensitivity.

    Parameters
    ----------
    flat
        A flat field that was not measured.
    relative_sigma
        Relative standard deviation of the sensitivities.

    Returns
    -------
    FlatField
        With the variance of its response.
    """
    return replace(flat, relative_variance=(relative_sigma * flat.response) ** 2)


def fall_off_terms(axis: LensAxis, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Shapes of a fall-off beyond the cosine-fourth law.

    The tilts stand for an axis that the survey places a pixel off, and for a decentred lens.

    Parameters
    ----------
    axis
        Axis of the lens.
    shape
        (height, width) of the frames, px.

    Returns
    -------
    NDArray
        (4, y, x) second and fourth power of the distance from the axis, and tilts along x and y; the distance is 1 in
        the farthest corner.
    """
    v, u = np.indices(shape)
    radius = axis.radius_px(shape)
    reach = radius.max()
    square = (radius / reach) ** 2
    return np.stack([square, square**2, (u - axis.u_px) / reach, (v - axis.v_px) / reach])
