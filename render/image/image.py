"""A rendered image: spectral radiance of every pixel, in a short spectral basis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LAMP", "NOTHING", "RenderedImage"]

#: Index of surface of pixels that show a lamp.
LAMP = -1
#: Index of surface of pixels that show no surface.
NOTHING = -2


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """Spectral radiance as coefficients of spectra, in independent batches.

    The radiance of a batch is ``coefficients @ spectra``, W m^-2 sr^-1 nm^-1.
    """

    #: (batch, y, x, n) coefficients.
    coefficients: NDArray[np.float32]
    #: (n, w) spectra, W m^-2 sr^-1 nm^-1.
    spectra: NDArray[np.float64]
    #: (w,) wavelengths, nm.
    wavelength_nm: NDArray[np.float64]
    #: (y, x, f) share of the pixel that each flat face covers, 0 to 1, the lamps last.
    coverage: NDArray[np.float32]
    #: (f,) index into `surface_names` of each face; their number for faces of lamps.
    facet_surface: NDArray[np.int64]
    #: Names of the surfaces without the lamps.
    surface_names: tuple[str, ...]

    @property
    def surface(self) -> NDArray[np.int16]:
        """(y, x) index into `surface_names` of the surface with the largest share of the pixel.

        LAMP where a lamp has it, NOTHING where less than half of the pixel is covered. Pixels at edges show other
        surfaces, too, or a part of a lamp: no mean of a surface may contain them.
        """
        each = [self.coverage[..., self.facet_surface == s].sum(-1) for s in range(len(self.surface_names) + 1)]
        most = np.argmax(np.stack(each, axis=-1), axis=-1).astype(np.int16)
        most[most == len(self.surface_names)] = LAMP
        most[self.coverage.sum(axis=-1) < 0.5] = NOTHING
        return most

    @property
    def sees_lamp(self) -> NDArray[np.bool_]:
        """(y, x) whether any part of the pixel shows a lamp."""
        return np.asarray((self.coverage[..., self._faces :] > 0).any(axis=-1))

    @property
    def sees_surfaces(self) -> NDArray[np.bool_]:
        """(y, x) whether any part of the pixel shows a surface that is no lamp."""
        return np.asarray((self.coverage[..., : self._faces] > 0).any(axis=-1))

    @property
    def _faces(self) -> int:
        """Number of faces without those of lamps."""
        return int(np.count_nonzero(self.facet_surface < len(self.surface_names)))

    @property
    def single_surface(self) -> NDArray[np.bool_]:
        """(y, x) whether the pixel shows one flat face only."""
        return self.coverage.max(axis=-1) == 1

    def averaged(self) -> RenderedImage:
        """The image with the mean of its batches as the only batch.

        It takes a batch's part of the memory, and has no variance.

        Returns
        -------
        RenderedImage
            Image of one batch.
        """
        rows = (self.coefficients[:, row].mean(axis=0, dtype=np.float64) for row in range(len(self.coverage)))
        return replace(self, coefficients=np.stack([row.astype(np.float32) for row in rows])[None])

    def mean(self, weights: NDArray) -> NDArray[np.float64]:
        """Mean over batches of the weighted radiance, in a tenth of the time of `project`.

        Parameters
        ----------
        weights
            (w, q) weights of the wavelengths in q signals.

        Returns
        -------
        NDArray
            (y, x, q) mean.
        """
        mixed = self.spectra @ weights
        mean = np.empty((*self.coefficients.shape[1:3], mixed.shape[1]))
        for row in range(len(mean)):  # all rows at once would need a batch in double precision
            mean[row] = self.coefficients[:, row].mean(axis=0, dtype=np.float64) @ mixed
        return mean

    def project(self, weights: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean over batches of the weighted radiance, and the variance of this mean.

        The variance is the scatter of the batches over their number. Since wavelengths are weighted within each batch,
        the correlation of their errors is taken into account.

        Parameters
        ----------
        weights
            (w, q) weights of the wavelengths in q signals.

        Returns
        -------
        tuple[NDArray, NDArray]
            (y, x, q) mean and variance; the variance is NaN with a single batch.
        """
        mixed = self.spectra @ weights
        count, *shape = self.coefficients.shape[:-1]
        mean = np.empty((*shape, mixed.shape[1]))
        variance = np.full_like(mean, np.nan)
        for row in range(shape[0]):  # all rows at once would need every batch in double precision
            values = self.coefficients[:, row] @ mixed
            mean[row] = values.mean(axis=0)
            if count > 1:
                variance[row] = values.var(axis=0, ddof=1) / count
        return mean, variance

    def cube(self) -> xr.Dataset:
        """Spectral cube of the image.

        Returns
        -------
        Dataset
            radiance and standard_error (y, x, wavelength), surface (y, x).
        """
        import xarray as xr  # slow to import (0.5 s), and only needed here

        mean, variance = self.project(np.eye(len(self.wavelength_nm)))
        unit = {"units": "W m^-2 sr^-1 nm^-1"}
        return xr.Dataset(
            {
                "radiance": (("y", "x", "wavelength"), mean.astype(np.float32), unit),
                "standard_error": (("y", "x", "wavelength"), np.sqrt(variance).astype(np.float32), unit),
                "surface": (
                    ("y", "x"),
                    self.surface,
                    {"names": ", ".join(self.surface_names), "lamp": LAMP, "nothing": NOTHING},
                ),
            },
            coords={"wavelength": ("wavelength", self.wavelength_nm, {"units": "nm"})},
        )
