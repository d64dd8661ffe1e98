"""A rendered image: radiance in every pixel at every wavelength, stored in a short spectral basis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LAMP", "NOTHING", "RenderedImage"]

#: Surface ids of pixels that see a lamp, or no surface.
LAMP, NOTHING = -1, -2


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """Spectral radiance as coefficients of spectra, in independent batches.

    coefficients : (batch, y, x, n). spectra : (n, w), W m^-2 sr^-1 nm^-1. wavelength_nm : (w,).
    coverage : (y, x, f) share of the pixel that each flat face covers, 0 to 1, the lamps last.
    facet_surface : (f,) index into surface_names of each face; len(surface_names) for those of lamps.
    """

    coefficients: NDArray[np.float32]
    spectra: NDArray[np.float64]
    wavelength_nm: NDArray[np.float64]
    coverage: NDArray[np.float32]
    facet_surface: NDArray[np.int64]
    surface_names: tuple[str, ...]

    @property
    def surface(self) -> NDArray[np.int16]:
        """(y, x) index into surface_names of the surface that covers most of the pixel, or LAMP or NOTHING.

        Pixels at edges see other surfaces, too, or a part of a lamp: no mean of a surface may contain them.
        """
        each = [self.coverage[..., self.facet_surface == s].sum(-1) for s in range(len(self.surface_names) + 1)]
        most = np.argmax(np.stack(each, axis=-1), axis=-1).astype(np.int16)
        most[most == len(self.surface_names)] = LAMP
        most[self.coverage.sum(axis=-1) < 0.5] = NOTHING
        return most

    @property
    def sees_lamp(self) -> NDArray[np.bool_]:
        """(y, x) whether any part of the pixel sees a lamp."""
        return np.asarray((self.coverage[..., self._faces :] > 0).any(axis=-1))

    @property
    def sees_surfaces(self) -> NDArray[np.bool_]:
        """(y, x) whether any part of the pixel sees a surface that is no lamp."""
        return np.asarray((self.coverage[..., : self._faces] > 0).any(axis=-1))

    @property
    def _faces(self) -> int:
        """Number of faces without those of lamps."""
        return int(np.count_nonzero(self.facet_surface < len(self.surface_names)))

    @property
    def single_surface(self) -> NDArray[np.bool_]:
        """(y, x) whether the pixel sees one flat face only."""
        return self.coverage.max(axis=-1) == 1

    def averaged(self) -> RenderedImage:
        """The same with the mean of its batches as the only one: a batch's part of the memory, and no variance."""
        rows = (self.coefficients[:, row].mean(axis=0, dtype=np.float64) for row in range(len(self.coverage)))
        return replace(self, coefficients=np.stack([row.astype(np.float32) for row in rows])[None])

    def mean(self, weights: NDArray) -> NDArray[np.float64]:
        """Mean (y, x, q) of ``project`` alone, which takes a tenth of its time."""
        mixed = self.spectra @ weights
        mean = np.empty((*self.coefficients.shape[1:3], mixed.shape[1]))
        for row in range(len(mean)):  # all rows at once would need a batch in double precision
            mean[row] = self.coefficients[:, row].mean(axis=0, dtype=np.float64) @ mixed
        return mean

    def project(self, weights: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and variance of the mean (y, x, q) of the radiance times ``weights`` (w, q).

        The variance is estimated from the scatter of the batches; NaN with a single batch.
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
        """The spectral cube: radiance and standard_error (y, x, wavelength), surface (y, x)."""
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
