"""Mean luminance and chromaticity of each surface in a rendered image, over the pixels that it covers whole."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.calibration.instrument import chromaticity
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

from ..image import RenderedImage
from .observer import tristimulus_weights

__all__ = ["PartLight", "Photometry", "SurfaceSums", "surface_sums"]

#: Part of a pixel that may be covered by something else: the rounding of shares.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class PartLight:
    """The light of one part of the picture: the means of X, Y, Z over its pixels; NaN without pixels.

    xyz : (3,), Y in cd m^-2. covariance : (3, 3) of it, from the scatter of the picture's batches, NaN for a single
    one.
    """

    pixels: int
    xyz: NDArray[np.float64]
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
        whole = float(self.xyz.sum())
        if not whole > 0:
            return np.full(2, np.nan)
        slopes = (np.eye(3)[:2] - self.chromaticity[:, None]) / whole
        variance = np.einsum("ai,ij,aj->a", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0)))  # rounding takes that of one spectrum below 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values; None for what is not known."""
        values = {
            "luminance_cd_m2": self.luminance,
            "luminance_sigma_cd_m2": self.luminance_sigma,
            **dict(zip(("x", "y"), self.chromaticity.tolist(), strict=True)),
            **dict(zip(("x_sigma", "y_sigma"), self.chromaticity_sigma.tolist(), strict=True)),
        }
        return {**{name: _known(value) for name, value in values.items()}, "pixels": self.pixels}


@dataclass(frozen=True, eq=False)
class SurfaceSums:
    """Sums of X, Y, Z over pixels, for each surface, then the lamps, then the whole picture: n parts.

    pixels : (n,). xyz : (n, 3). covariance : (n, 3, 3) of the sums.
    """

    surface_names: tuple[str, ...]
    pixels: NDArray[np.int64]
    xyz: NDArray[np.float64]
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
        """All of it as one line, exact to the bit."""
        arrays = (self.pixels, self.xyz, self.covariance)
        return json.dumps([self.surface_names, *(array.tolist() for array in arrays)])

    @classmethod
    def from_text(cls, text: str) -> SurfaceSums:
        """What ``text`` made the line of."""
        names, pixels, xyz, covariance = json.loads(text)
        return cls(tuple(names), np.array(pixels, int), np.array(xyz, float), np.array(covariance, float))

    def part(self, index: int) -> PartLight:
        """The means of one part."""
        count = int(self.pixels[index])
        if not count:
            return PartLight(0, np.full(3, np.nan), np.full((3, 3), np.nan))
        return PartLight(count, self.xyz[index] / count, self.covariance[index] / count**2)


def surface_sums(image: RenderedImage) -> SurfaceSums:
    """Sums over the pixels that each surface covers whole, those that the lamps cover whole, and all pixels.

    Pixels that see several surfaces, or the background beside one, count in the picture alone. The errors of different
    pixels are taken as independent.
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
        own = np.einsum("bxi,bxj->xij", scatter, scatter) / max(batches - 1, 1) / batches
        covariance += np.einsum("nx,xij->nij", inside, own)
    pixels = where.sum(axis=(1, 2))
    if batches == 1:
        covariance[pixels > 0] = np.nan
    return SurfaceSums(names, pixels, xyz, covariance)


@dataclass(frozen=True, eq=False)
class Photometry(OwnMappings):
    """Luminances, chromaticities and illuminances of a rendered box.

    sums : see ``surface_sums``. wavelength_nm : (w,) over which luminance was integrated. illuminance_lx : mean of each
    surface, NaN for one that is covered; None where it was not computed.
    """

    sums: SurfaceSums
    wavelength_nm: NDArray[np.float64]
    illuminance_lx: Mapping[str, float] | None = None

    @property
    def surfaces(self) -> dict[str, PartLight]:
        """The light of each surface, by name."""
        return {name: self.sums.part(index) for index, name in enumerate(self.sums.surface_names)}

    @property
    def lamp(self) -> PartLight:
        """Of all lamps together: what they emit and reflect."""
        return self.sums.part(len(self.sums.surface_names))

    @property
    def picture(self) -> PartLight:
        """Of all pixels, those of edges, lamps and background included."""
        return self.sums.part(len(self.sums.surface_names) + 1)

    @property
    def range_text(self) -> str:
        """The wavelengths in words."""
        grid = self.wavelength_nm
        return f"integrated over {grid.size} wavelengths from {grid[0]:g} to {grid[-1]:g} nm"

    def illuminance(self, name: str) -> float:
        """Mean illuminance of a surface, lx; NaN where it is not known."""
        return float("nan") if self.illuminance_lx is None else self.illuminance_lx[name]

    def to_dict(self) -> dict[str, Any]:
        """Plain values; None for what is not known."""
        surfaces = {
            name: {**light.to_dict(), "illuminance_lx": _known(self.illuminance(name))}
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


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
