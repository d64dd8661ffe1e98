"""What is to be explained: a residual over its noise, the picture it belongs to, and what may be adjusted beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

__all__ = ["Excess", "Transport"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Transport:
    """Light exchange between patches and pixels, see ``render.perturbation``. Radiances are relative to the lamp's.

    pixel, coverage, surface, material, position : (f,) flat pixel index, share of the pixel, indices, (f, 3) mm of
    each fragment. gather : (f, p). patch_surface, patch_material, patch_position : of the patches. form_factors :
    (p, p). reflectance : (material, band). arriving, patch_arriving : (f, band), (p, band) irradiance over pi; direct,
    patch_direct : what of it comes from the lamps. view, incidence, patch_incidence : (f,), (f,), (p,) cosines of the
    angles between normal and camera, and between normal and lamps (mean over those that light it).
    picture : (band, y, x). coats : (roughness, band, y, x) what a specular coat of index 1.5 on all surfaces would add,
    for each of several roughnesses (GGX alpha).
    """

    pixel: NDArray[np.int64]
    coverage: NDArray[np.float64]
    surface: NDArray[np.int64]
    material: NDArray[np.int64]
    position: NDArray[np.float64]
    gather: csr_array
    patch_surface: NDArray[np.int64]
    patch_material: NDArray[np.int64]
    patch_position: NDArray[np.float64]
    form_factors: NDArray[np.float32]
    reflectance: NDArray[np.float64]
    arriving: NDArray[np.float64]
    direct: NDArray[np.float64]
    view: NDArray[np.float64]
    incidence: NDArray[np.float64]
    patch_arriving: NDArray[np.float64]
    patch_direct: NDArray[np.float64]
    patch_incidence: NDArray[np.float64]
    picture: NDArray[np.float64]
    coats: NDArray[np.float32]
    roughness: tuple[float, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Excess:
    """A residual of which something is not noise.

    residual : (band, y, x) over sigma, 0 where unused, camera and lamp at their best. weighed : the same less what
    errors that bands or faces share explain of it. used : (band, y, x). sigma, signal : (band, y, x) DN. nuisances :
    (band, y, x, m) columns W such that X^T X - (W^T X)^T (W^T X) is the information about columns X that nuisances
    leave; the first ``unknown`` of them are camera and lamp, the others shared errors. moved : (2, band, y, x) DN per
    px that the picture moves to the right and down. flat : (band, y, x) by which counts were divided. surface : (y, x)
    index of the surface, -1 for none. names : of surfaces. materials : names. bands, nm, minutes, exposure_s : of each
    band. flat_exposure_s : (band,) of its flat.
    repeats : (band, repeat) relative differences of the frames' levels from their mean, NaN where there is no frame.
    repeat_sigma : (band,) their standard deviations by noise.
    """

    residual: NDArray[np.float32]
    weighed: NDArray[np.float64]
    used: NDArray[np.bool_]
    sigma: NDArray[np.float64]
    signal: NDArray[np.float64]
    noise: NDArray[np.float64]
    nuisances: NDArray[np.float32]
    unknown: int
    moved: NDArray[np.float32]
    flat: NDArray[np.float64]
    surface: NDArray[np.int64]
    names: tuple[str, ...]
    materials: tuple[str, ...]
    bands: tuple[str, ...]
    nm: NDArray[np.float64]
    minutes: NDArray[np.float64]
    exposure_s: NDArray[np.float64]
    flat_exposure_s: NDArray[np.float64]
    repeats: NDArray[np.float64]
    repeat_sigma: NDArray[np.float64]
    transport: Transport

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        rows, columns = self.used.shape[1:]
        return rows, columns

    def reflectance_of(self, surface: int) -> NDArray[np.float64]:
        """(band,) reflectance of a surface's paint, by its index."""
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
        """(band, y, x) 1 / sigma, 0 where unused."""
        return np.where(self.used, 1 / np.where(self.used, self.sigma, 1.0), 0.0)

    def whitened(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change (band, y, x) in DN over sigma, less what camera and lamp can do."""
        vector = change * self.weight
        columns = self.nuisances[..., : self.unknown]
        return np.where(self.used, vector - columns @ np.einsum("byxm,byx->m", columns, vector), 0.0)

    @cached_property
    def half(self) -> NDArray[np.bool_]:
        """(y, x) squares of 2 x 2 pixels, every other one, that stay out of trial fits."""
        rows, columns = np.indices(self.shape)
        return ((rows // 2 + columns // 2) % 2).astype(bool)
