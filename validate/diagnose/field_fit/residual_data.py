"""Residual of a capture with its noise, rendering, nuisances and light exchange."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

__all__ = ["LEAST_DIVISOR", "ChargeExchange", "ResidualData", "Transport"]

#: Change (band, y, x) of the signal, DN, by a unit of an exchange of charge. The exchange gives the change of raw
#: frames (band, y, x) above dark by these frames.
ChargeExchange = Callable[[Callable[[NDArray[np.float64]], NDArray[np.float64]]], NDArray[np.float64]]

#: Part of the usual size from which a signal, a flat field or an outline divides: quotients diverge below it.
LEAST_DIVISOR = 0.05

#: Side of the squares that are held out in turn, px; that of a mosaic's repeat where larger.
_HELD_OUT_PX = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class Transport:
    """Light exchange between surface patches and pixels, see ``render.perturbation``.

    A fragment is the part of a pixel that shows one surface: there are f fragments and p patches. Radiances are
    relative to the lamp's radiance.
    """

    #: (f,) flat index of a fragment's pixel.
    pixel: NDArray[np.int64]
    #: (f,) share of the pixel that the fragment covers, 0 to 1.
    coverage: NDArray[np.float64]
    #: (f,) index of the surface.
    surface: NDArray[np.int64]
    #: (f,) index of the material.
    material: NDArray[np.int64]
    #: (f, 3) centre of the fragment in the scene, mm.
    position: NDArray[np.float64]
    #: (f, p) form factors from fragments to patches.
    gather: csr_array
    #: (p,) index of a patch's surface.
    patch_surface: NDArray[np.int64]
    #: (p,) index of a patch's material.
    patch_material: NDArray[np.int64]
    #: (p, 3) centre of a patch, mm.
    patch_position: NDArray[np.float64]
    #: (p, p) form factors between patches.
    form_factors: NDArray[np.float32]
    #: (material, band) reflectance.
    reflectance: NDArray[np.float64]
    #: (f, band) irradiance over pi on fragments.
    arriving: NDArray[np.float64]
    #: (f, band) the part of ``arriving`` that comes directly from the lamps.
    direct: NDArray[np.float64]
    #: (f,) cosine between a fragment's normal and the direction to the camera.
    view: NDArray[np.float64]
    #: (f,) cosine between a fragment's normal and the direction to the lamps, mean over the lamps that light it.
    incidence: NDArray[np.float64]
    #: (p, band) irradiance over pi on patches.
    patch_arriving: NDArray[np.float64]
    #: (p, band) the part of ``patch_arriving`` that comes directly from the lamps.
    patch_direct: NDArray[np.float64]
    #: (p,) cosine between a patch's normal and the direction to the lamps.
    patch_incidence: NDArray[np.float64]
    #: (f,) cosine between the lamps' normal and the direction from them to a fragment, mean over the lamps.
    emission: NDArray[np.float64]
    #: (p,) the same of patches.
    patch_emission: NDArray[np.float64]
    #: (f, 2) mean place on the lamps, -1 to 1 from side to side, from which direct light comes, along both their axes.
    side: NDArray[np.float64]
    #: (p, 2) the same of patches.
    patch_side: NDArray[np.float64]
    #: (band, y, x) radiance of the rendering.
    picture: NDArray[np.float64]
    #: (line,) single wavelengths, nm.
    line_nm: NDArray[np.float64]
    #: (line, y, x) radiance of the rendering at each of them.
    lines: NDArray[np.float64]
    #: (roughness, band, y, x) radiance that a specular coat of refractive index 1.5 on all surfaces would add.
    coats: NDArray[np.float32]
    #: Roughness (GGX alpha) of each of the coats.
    roughness: tuple[float, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualData:
    """Residual of a capture, with the inputs of all families of explanations."""

    #: (band, y, x) measured minus rendered signal over sigma, with the best camera and lamp; 0 where unused.
    residual: NDArray[np.float32]
    #: (band, y, x) the residual after marginalising the errors that bands or faces share.
    marginal_residual: NDArray[np.float64]
    #: (band, y, x) whether a sample is used.
    used: NDArray[np.bool_]
    #: (band, y, x) standard deviation of the measured signal, DN.
    sigma: NDArray[np.float64]
    #: (band, y, x) rendered signal above dark, DN.
    signal: NDArray[np.float64]
    #: (band, y, x) a random draw of the rendering's own noise, DN.
    noise: NDArray[np.float64]
    #: (band, y, x, m) columns W of nuisances: the information about whitened columns X is X^T X - (W^T X)^T (W^T X).
    nuisances: NDArray[np.float32]
    #: Number of the first columns of ``nuisances`` that are camera and lamp; the others are shared errors.
    num_free_nuisances: int
    #: (2, band, y, x) change of the signal by a displacement of the image to the right and down, DN per px.
    moved: NDArray[np.float32]
    #: (band, y, x) flat field by which the counts were divided.
    flat: NDArray[np.float64]
    #: (y, x) index of the surface, -1 for none.
    surface: NDArray[np.int64]
    #: Names of the surfaces.
    names: tuple[str, ...]
    #: Names of the materials.
    materials: tuple[str, ...]
    #: Names of the bands.
    bands: tuple[str, ...]
    #: (band,) mean wavelength, nm.
    nm: NDArray[np.float64]
    #: (band,) time at which the band was taken, min.
    minutes: NDArray[np.float64]
    #: (band,) exposure time, s.
    exposure_s: NDArray[np.float64]
    #: (band,) exposure time of the band's flat field, s; infinite without a flat field.
    flat_exposure_s: NDArray[np.float64]
    #: (band, repeat) relative differences of the frames' levels from the band's mean; NaN where there is no frame.
    repeats: NDArray[np.float64]
    #: (band,) standard deviation of ``repeats`` by noise.
    repeat_sigma: NDArray[np.float64]
    #: Light exchange of the scene.
    transport: Transport
    #: Rows and columns of one repeat of the sensor's mosaic, px; None without a mosaic.
    cell: tuple[int, int] | None = None
    #: Exchange of charge in all raw frames; None without a mosaic, where pixels exchange light of one band alone.
    charge: ChargeExchange | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        rows, columns = self.used.shape[1:]
        return rows, columns

    @property
    def least_signal(self) -> NDArray[np.float64]:
        """(band,) signal with which the changes of darker pixels are compared, DN."""
        return LEAST_DIVISOR * self.signal.mean(axis=(1, 2))

    def reflectance_of(self, surface: int) -> NDArray[np.float64]:
        """Reflectance of a surface's paint.

        Parameters
        ----------
        surface
            Index of the surface.

        Returns
        -------
        NDArray
            (band,) reflectance.
        """
        t = self.transport
        return t.reflectance[t.material[np.argmax(t.surface == surface)]]

    @cached_property
    def count(self) -> int:
        """Number of used samples."""
        return int(self.used.sum())

    @cached_property
    def chi2(self) -> float:
        """Sum of squares of the residual."""
        return float(np.sum(self.residual.astype(float) ** 2))

    @cached_property
    def weight(self) -> NDArray[np.float64]:
        """(band, y, x) 1 / sigma in 1/DN, 0 where unused."""
        return np.where(self.used, 1 / np.where(self.used, self.sigma, 1.0), 0.0)

    def whitened(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change over sigma, projected orthogonally to camera and lamp.

        Parameters
        ----------
        change
            (band, y, x) change of the signal, DN.

        Returns
        -------
        NDArray
            (band, y, x) the part of the change over sigma that camera and lamp cannot imitate; 0 where unused.
        """
        vector = change * self.weight
        columns = self.nuisances[..., : self.num_free_nuisances]
        return np.where(self.used, vector - columns @ np.einsum("byxm,byx->m", columns, vector), 0.0)

    def with_change(self, change: NDArray[np.float64]) -> ResidualData:
        """The residual of a photograph that is changed; camera, lamp and shared errors are adjusted.

        Parameters
        ----------
        change
            (band, y, x) change of the measured signal, DN.

        Returns
        -------
        ResidualData
            With another residual; noise and rendering are the same.
        """
        projected = self.whitened(change)
        shared = self.nuisances[..., self.num_free_nuisances :]
        marginal = projected - shared @ np.einsum("byxm,byx->m", shared, projected)
        return replace(
            self,
            residual=(self.residual + projected).astype(np.float32),
            marginal_residual=self.marginal_residual + np.where(self.used, marginal, 0.0),
        )

    @cached_property
    def held_out(self) -> NDArray[np.bool_]:
        """(y, x) pixels excluded from trial fits: squares as on a chessboard.

        They are 2 x 2 pixels, or repeats of a mosaic: each band then has pixels in either colour.
        """
        rows, columns = np.indices(self.shape)
        height, width = (max(_HELD_OUT_PX, side) for side in self.cell or (1, 1))
        return ((rows // height + columns // width) % 2).astype(bool)
