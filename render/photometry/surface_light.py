"""Mean luminance and chromaticity of each surface, over pixels that it covers completely."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.calibration.instrument import chromaticity
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..image import RenderedImage
from .observer import tristimulus_weights

__all__ = ["PartLight", "Photometry", "SurfaceSums", "surface_sums"]

#: Part of a pixel that may be covered by something else: the rounding of shares.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class PartLight:
    """Light of one part of the picture; NaN for a part without pixels."""

    #: Number of pixels.
    pixels: int
    #: (3,) means of X, Y, Z over the pixels, Y in cd m^-2.
    xyz: NDArray[np.float64]
    #: (3, 3) covariance of ``xyz``, from the scatter of the picture's batches; NaN for a single batch.
    covariance: NDArray[np.float64]

    @property
    def luminance(self) -> float:
        """Mean luminance, cd m^-2."""
        return float(self.xyz[1])

    @property
    def luminance_sigma(self) -> float:
        """Standard error of the luminance, cd m^-2."""
        return float(np.sqrt(self.covariance[1, 1]))

    @property
    def chromaticity(self) -> NDArray[np.float64]:
        """(2,) CIE 1931 x, y; NaN where there is no light."""
        return chromaticity(self.xyz)

    @property
    def chromaticity_sigma(self) -> NDArray[np.float64]:
        """(2,) standard errors of x and y, to first order."""
        total = float(self.xyz.sum())
        if not total > 0:
            return np.full(2, np.nan)
        slopes = (np.eye(3)[:2] - self.chromaticity[:, None]) / total
        variance = np.einsum("ai,ij,aj->a", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0)))  # rounding takes that of one spectrum below 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON.

        Returns
        -------
        dict
            Luminance, chromaticity, their standard errors and the number of pixels; None for what is not known.
        """
        values = {
            "luminance_cd_m2": self.luminance,
            "luminance_sigma_cd_m2": self.luminance_sigma,
            **dict(zip(("x", "y"), self.chromaticity.tolist(), strict=True)),
            **dict(zip(("x_sigma", "y_sigma"), self.chromaticity_sigma.tolist(), strict=True)),
        }
        return {**{name: _finite_or_none(value) for name, value in values.items()}, "pixels": self.pixels}


@dataclass(frozen=True, eq=False)
class SurfaceSums:
    """Sums over n parts: the pixels of each surface, of all lamps together, and of the picture."""

    #: Names of the surfaces.
    surface_names: tuple[str, ...]
    #: (n,) number of pixels.
    pixels: NDArray[np.int64]
    #: (n, 3) sums of X, Y, Z, Y in cd m^-2.
    xyz: NDArray[np.float64]
    #: (n, 3, 3) covariances of the sums.
    covariance: NDArray[np.float64]

    def __add__(self, other: SurfaceSums) -> SurfaceSums:
        """The sums over both of two strips of one picture."""
        return SurfaceSums(
            self.surface_names,
            self.pixels + other.pixels,
            self.xyz + other.xyz,
            self.covariance + other.covariance,
        )

    def text(self) -> str:
        """Sums as one line of text, exact to the bit.

        Returns
        -------
        str
            JSON.
        """
        arrays = (self.pixels, self.xyz, self.covariance)
        return json.dumps([self.surface_names, *(array.tolist() for array in arrays)])

    @classmethod
    def from_text(cls, text: str) -> SurfaceSums:
        """Sums from a line of ``text``.

        Parameters
        ----------
        text
            JSON.

        Returns
        -------
        SurfaceSums
            The same sums.
        """
        names, pixels, xyz, covariance = json.loads(text)
        return cls(tuple(names), np.array(pixels, int), np.array(xyz, float), np.array(covariance, float))

    def part(self, index: int) -> PartLight:
        """Means of one part.

        Parameters
        ----------
        index
            Index of the part.

        Returns
        -------
        PartLight
            Its light.
        """
        count = int(self.pixels[index])
        if not count:
            return PartLight(0, np.full(3, np.nan), np.full((3, 3), np.nan))
        return PartLight(count, self.xyz[index] / count, self.covariance[index] / count**2)


def surface_sums(image: RenderedImage) -> SurfaceSums:
    """Sums of X, Y, Z over the parts of an image.

    A surface's part, and that of the lamps, are the pixels that it covers completely. Pixels that see several
    surfaces, or a surface and the background, count in the picture alone. The errors of different pixels are taken as
    independent.

    Parameters
    ----------
    image
        Rendered image.

    Returns
    -------
    SurfaceSums
        Sums; of an image of a single batch the covariances are NaN.
    """
    names = image.surface_names
    shares = np.stack([image.coverage[..., image.facet_surface == s].sum(-1) for s in range(len(names) + 1)])
    where = np.concatenate([shares >= 1 - _ROUNDING, np.ones((1, *shares.shape[1:]), bool)])
    mixed = image.spectra @ tristimulus_weights(image.wavelength_nm)
    batches = len(image.coefficients)
    xyz, covariance = np.zeros((len(where), 3)), np.zeros((len(where), 3, 3))
    for row in range(where.shape[1]):  # all rows at once would need every batch in double precision
        values = image.coefficients[:, row] @ mixed
        inside = where[:, row].astype(float)
        xyz += inside @ values.mean(axis=0)
        scatter = values - values.mean(axis=0)
        pixel_covariance = np.einsum("bxi,bxj->xij", scatter, scatter) / max(batches - 1, 1) / batches
        covariance += np.einsum("nx,xij->nij", inside, pixel_covariance)
    pixels = where.sum(axis=(1, 2))
    if batches == 1:
        covariance[pixels > 0] = np.nan
    return SurfaceSums(names, pixels, xyz, covariance)


@dataclass(frozen=True, eq=False)
class Photometry(FrozenMappings):
    """Luminances, chromaticities and illuminances of a rendered box."""

    #: Sums over surfaces, lamps and picture.
    sums: SurfaceSums
    #: (w,) wavelengths over which luminance was integrated, nm.
    wavelength_nm: NDArray[np.float64]
    #: Mean illuminance by surface, lx, NaN for one that others cover; None where it was not computed.
    illuminance_lx: Mapping[str, float] | None = None

    @property
    def surfaces(self) -> dict[str, PartLight]:
        """The light of each surface, by name."""
        return {name: self.sums.part(index) for index, name in enumerate(self.sums.surface_names)}

    @property
    def lamp(self) -> PartLight:
        """Light of all lamps together: what they emit and reflect."""
        return self.sums.part(len(self.sums.surface_names))

    @property
    def picture(self) -> PartLight:
        """Light of all pixels, those of edges, lamps and background included."""
        return self.sums.part(len(self.sums.surface_names) + 1)

    @property
    def range_text(self) -> str:
        """The wavelengths in words."""
        grid = self.wavelength_nm
        return f"integrated over {grid.size} wavelengths from {grid[0]:g} to {grid[-1]:g} nm"

    def illuminance(self, name: str) -> float:
        """Mean illuminance of a surface.

        Parameters
        ----------
        name
            Name of the surface.

        Returns
        -------
        float
            lx; NaN where it is not known.
        """
        return float("nan") if self.illuminance_lx is None else self.illuminance_lx[name]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON.

        Returns
        -------
        dict
            Range of wavelengths, observer, and the light of surfaces, lamps and picture; None for what is not known.
        """
        surfaces = {
            name: {**light.to_dict(), "illuminance_lx": _finite_or_none(self.illuminance(name))}
            for name, light in self.surfaces.items()
        }
        grid = self.wavelength_nm
        return {
            "first_nm": float(grid[0]),
            "last_nm": float(grid[-1]),
            "wavelengths": int(grid.size),
            "observer": "CIE 1931 2 degree",
            "lm_per_w": 683.0,
            "surfaces": surfaces,
            "lamp": self.lamp.to_dict(),
            "picture": self.picture.to_dict(),
        }


def _finite_or_none(value: float) -> float | None:
    """A finite value, else None."""
    return value if np.isfinite(value) else None
