"""A spot on one surface: bell-shaped maps, and the fit of a relative change there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .field import FieldFit, fixed_spectrum, free_spectrum
from .fitted_explanation import equations_in_all_bands, scaled
from .residual_data import ResidualData
from .spot_regions import bells_on

__all__ = ["SurfaceSpot", "surface_spot"]

#: Sum of a bell over the pixels of a surface below which it does not lie on the surface.
_MIN_BELL_SUM = 0.5


@dataclass(frozen=True, eq=False)
class SurfaceSpot:
    """The part of a spot that lies on one surface."""

    #: Residual to be explained.
    data: ResidualData
    #: Index of the surface.
    surface: int
    #: Bells that lie on the surface.
    maps: ImageMaps
    #: (k, pixel) the bells, 0 outside the surface.
    basis: csr_matrix

    @property
    def name(self) -> str:
        """Name of the surface."""
        return self.data.names[self.surface]

    def relative_change(self, band: int) -> csr_matrix:
        """Change of the signal by a relative change of reflectance or of light.

        Parameters
        ----------
        band
            Index of the band.

        Returns
        -------
        csr_matrix
            (k, pixel) change, DN.
        """
        return scaled(self.basis, self.data.signal[band])

    @cached_property
    def fit(self) -> FieldFit:
        """Fit of a relative change with a free or a grey spectrum, by the larger evidence."""
        n = equations_in_all_bands(self.data, self.relative_change)
        fits = free_spectrum(n), fixed_spectrum(n, np.ones(len(self.data.bands)))
        return max(fits, key=lambda fit: fit.evidence)


def surface_spot(data: ResidualData, region: NDArray[np.bool_]) -> SurfaceSpot | None:
    """The part of a region on the surface that covers most of its pixels.

    Parameters
    ----------
    data
        Residual.
    region
        (y, x) region of a spot.

    Returns
    -------
    SurfaceSpot or None
        The spot on the surface; None where no surface is visible in the region, or no bell lies on it.
    """
    bells = bells_on(region, data.cell)
    basis = csr_matrix(bells.matrix(data.shape))
    visible = data.surface[region]
    visible = visible[visible >= 0]
    if not len(visible):
        return None
    owner = int(np.argmax(np.bincount(visible)))
    inside = scaled(basis, data.surface == owner)
    on_surface = np.flatnonzero(np.asarray(inside.sum(axis=1)).ravel() > _MIN_BELL_SUM)
    if not len(on_surface):
        return None
    maps = replace(bells, centres=tuple(bells.centres[i] for i in on_surface))
    return SurfaceSpot(data, owner, maps, inside[on_surface])
