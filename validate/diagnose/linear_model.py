"""The linear model of a residual in units of its noise, with camera and lamp projected out.

To first order the measured signals are r = D t + s a + noise, with D the derivatives with respect to the
eleven nuisances t, whose priors stand as further rows, and s an effect's signature. Minimising over t is a
projection, so an effect's gain in chi2 is that of the projected signature alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter

from ..compare import NuisanceFit, Nuisances
from ..predict import PictureErrors

__all__ = [
    "BandErrors",
    "LinearModel",
    "build_linear_model",
    "model_variance",
    "nuisance_priors",
    "smooth_excess",
    "smooth_part",
]

#: Standard deviations of the base picture's own errors: relative, and of the position of its edges, px.
#: Measured against an independent simulator: surface means within 0.15 %, edges within 0.005 px.
_RELATIVE_ERROR = 0.0015
_EDGE_ERROR_PX = 0.005

#: Relative standard deviations of errors that all pixels of a band, or of a flat face, share. Bands of an independent
#: simulator's captures scatter by 0.06 to 0.08 %, differently in each capture; faces are compared with the same one.
_BAND_ERROR, _FACE_ERROR = 0.0007, 0.001

#: An error of the dark level by rounding below this is left out, DN: noise of half a count makes it 0.002.
_LEAST_DARK_ERROR_DN = 0.001

#: So many standard deviations of a shared error are no sign of an effect.
_SHARED_MOST = 2.0

#: Distance from faces' edges from which a pixel counts as interior, px: contact shadows depend on gaps below 1 mm.
_FROM_EDGE_PX = 2


#: Relative singular-value cutoff of the changes that several numbers make.
_RELATIVE_CUTOFF = 1e-5

#: Patches of the image across and down; residuals may be correlated within each.
_PATCHES = 8


def model_variance(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """(band, y, x) DN^2: variance of the base picture's own error, by level and by local contrast."""
    contrast = maximum_filter(signal, (0, 3, 3)) - minimum_filter(signal, (0, 3, 3))
    return (_RELATIVE_ERROR * signal) ** 2 + (_EDGE_ERROR_PX * contrast) ** 2


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearModel:
    """used : (band, y, x). interior : (n,) whether a used pixel lies well inside one flat face. patch : (n,) number
    of the patch of the image that it lies in. sigma : (n,) DN. priors : (11, 11) see ``nuisance_priors``.
    by_lamp : (n,) DN, derivative by the lamp's scale.
    basis : (n + 11, k) orthonormal, of the nuisances: camera, lamp, and what ``marginalised_over`` adds.
    shared_errors : (n + 11, m) over sigma, one standard deviation each of errors that a band or a face shares.
    dark_errors : so many of them, the first, are of bands' dark levels.
    errors : of the picture itself, with which vectors are whitened beside sigma; None where they are not counted.

    residual : (n + 11,) measured less base, over sigma, then the priors' own rows; already projected.
    """

    used: NDArray[np.bool_]
    interior: NDArray[np.bool_]
    patch: NDArray[np.int64]
    sigma: NDArray[np.float64]
    priors: NDArray[np.float64]
    by_lamp: NDArray[np.float64]
    basis: NDArray[np.float64]
    shared_errors: NDArray[np.float32]
    residual: NDArray[np.float64]
    dark_errors: int = 0
    errors: PictureErrors | None = None

    @property
    def count(self) -> int:
        """Number of used samples."""
        return len(self.sigma)

    def project(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """What of a whitened vector (n + 11,) no nuisance can imitate."""
        return vector - self.basis @ (self.basis.T @ vector)

    def whiten(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change (band, y, x) in DN over sigma, projected; priors do not speak of it."""
        return self.whiten_used(change[self.used])

    def whiten_used(self, change: NDArray) -> NDArray[np.float64]:
        """The same of a change (n,) at the used pixels only."""
        pixels = change / self.sigma
        return self.project(_without_priors(pixels if self.errors is None else self.errors.whitened(pixels)))

    def counting(self, errors: PictureErrors) -> LinearModel:
        """With the picture's own errors in the covariance: all vectors are whitened by them, too. What bands and faces
        share is among them, so that nothing is left in ``shared_errors``."""

        def whitened(vector: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.append(errors.whitened(vector[: self.count]), vector[self.count :])

        basis = np.linalg.qr(np.array([whitened(column) for column in self.basis.T]).T)[0]
        none = np.zeros((len(self.residual), 0), np.float32)
        model = replace(self, errors=errors, basis=basis, shared_errors=none, dark_errors=0)
        return replace(model, residual=model.project(whitened(self.residual)))

    def marginalised_over(self, columns: Sequence[NDArray[np.float64]]) -> LinearModel:
        """With further nuisances: the changes, (n + 11,) each, projected, that other effects' numbers make."""
        sizes = [float(np.linalg.norm(column)) for column in columns]
        moving = [column / size for column, size in zip(columns, sizes, strict=True) if size > 0]
        if not moving:
            return self
        u, values, _ = np.linalg.svd(np.array(moving).T, full_matrices=False)
        basis = np.hstack([self.basis, u[:, values > _RELATIVE_CUTOFF * values[0]]])
        free = replace(self, basis=basis)
        return replace(free, residual=free.project(self.residual))

    def gain_of_dark_errors(self, change: NDArray) -> float:
        """The chi2 that a change (n + 11,), projected, gains on average by errors of the bands' dark levels."""
        along = self.shared_errors[:, : self.dark_errors].T @ change
        return float(along @ along) / max(float(change @ change), 1e-300)

    def without_shared_errors(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """A residual (n + 11,), projected, less what errors shared by a band or a face explain of it, each at most
        two standard deviations large."""
        shared = self.projected_shared_errors()
        size = np.linalg.solve(np.eye(shared.shape[1]) + shared.T @ shared, shared.T @ residual)
        return residual - shared @ np.clip(size, -_SHARED_MOST, _SHARED_MOST)

    def projected_shared_errors(self) -> NDArray[np.float64]:
        """(n + 11, m) ``shared_errors``, projected; in place, for there are dozens of them."""
        shared = self.shared_errors.astype(float)
        for column in shared.T:
            column -= self.basis @ (self.basis.T @ column)
        return shared

    def camera_change(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change (10,) of the camera's parameters, projected.

        The camera's fit can do the same to the picture, so only the rows of the priors differ, and no error of the
        picture enters.
        """
        return self._of_priors(Nuisances(change, 0.0).vector)

    def lamp_change(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change (band, y, x) in DN by the lamp's power, projected: only the row of its prior differs, too.

        ``by_lamp`` may be of a picture with effects that the change's base lacks: their difference is no change.
        """
        ours, theirs = self.by_lamp / self.sigma, change[self.used] / self.sigma
        vector = np.zeros(Nuisances.count)
        vector[Nuisances.of_lamp] = (ours @ theirs) / (ours @ ours)
        return self._of_priors(vector)

    def _of_priors(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """The change (n + 11,) by nuisances (11,), projected, their part in the picture taken off."""
        return self.project(np.append(np.zeros(self.count), -self.priors @ vector))

    @property
    def chi2(self) -> float:
        """Sum of squares with the nuisances at their best."""
        return float(self.residual @ self.residual)

    def image(self, vector: NDArray[np.floating]) -> NDArray[np.float64]:
        """The pixel part of a whitened vector as (band, y, x), NaN where unused."""
        picture = np.full(self.used.shape, np.nan)
        picture[self.used] = vector[: self.count]
        return picture


def smooth_excess(model: LinearModel, residual: NDArray[np.float64], block_px: int = 8) -> float:
    """Mean square of interior blocks' means less what the scatter within blocks makes of it, in chi2 per sample.

    Noise averages out in a block, an error of the model does not: 0.1 standard deviations everywhere are lost in
    chi2 and significant here. Its expectation is 0 for noise, also for noise larger than stated.
    """
    blocks = _blocks(model.image(np.where(model.interior, residual[: model.count], np.nan)), block_px)
    counts = np.isfinite(blocks).sum(axis=1)
    full = counts >= block_px**2 // 4
    if not full.any():
        return 0.0
    means, scatter = np.nanmean(blocks[full], axis=1), np.nanvar(blocks[full], axis=1, ddof=1)
    return float(np.sum(counts[full] * means**2 - scatter) / counts[full].sum())


def smooth_part(model: LinearModel, change: NDArray[np.float64], block_px: int = 8) -> float:
    """The part of a change's square that block means keep: near 1 for changes of surfaces, near 0 at edges."""
    blocks = _blocks(model.image(change), block_px)
    counts = np.isfinite(blocks).sum(axis=1)
    means = np.nansum(blocks, axis=1) / np.maximum(counts, 1)
    return float(np.sum(counts * means**2) / max(np.nansum(blocks**2), 1e-300))


def _blocks(picture: NDArray[np.float64], block_px: int) -> NDArray[np.float64]:
    """(block, pixel) of a picture (band, y, x), what does not fill a block left out."""
    bands, height, width = picture.shape
    rows, columns = height // block_px, width // block_px
    cut = picture[:, : rows * block_px, : columns * block_px]
    return cut.reshape(bands, rows, block_px, columns, block_px).swapaxes(2, 3).reshape(-1, block_px**2)


def nuisance_priors(calibrated: Camera, lamp_sigma: float | None) -> NDArray[np.float64]:
    """(11, 11) rows that bind camera and lamp scale to what is known of them; zero where nothing is."""
    of_camera, of_lamp = Nuisances.of_camera, Nuisances.of_lamp
    rows = np.zeros((Nuisances.count, Nuisances.count))
    if calibrated.covariance is not None:
        rows[of_camera, of_camera] = np.linalg.inv(np.linalg.cholesky(calibrated.covariance))
    if lamp_sigma is not None:
        rows[of_lamp, of_lamp] = 1 / lamp_sigma
    return rows


def _without_priors(pixels: NDArray) -> NDArray[np.float64]:
    """A whitened vector (n + 11,) of which the priors say nothing."""
    return np.append(pixels, np.zeros(Nuisances.count))


@dataclass(frozen=True, eq=False)
class BandErrors:
    """Errors that all pixels of a band share, one standard deviation. relative : (band,) of the signal, by tables of
    spectra. dark_dn : of the dark level."""

    relative: NDArray[np.float64]
    dark_dn: float

    @property
    def dark_counts(self) -> bool:
        """Whether the error of the dark level is large enough to be counted."""
        return self.dark_dn > _LEAST_DARK_ERROR_DN


def build_linear_model(
    *,
    measured: NDArray,
    base: NDArray,
    variance: NDArray,
    used: NDArray,
    coverage: NDArray,
    derivative: NDArray,
    fit: NuisanceFit,
    calibrated: Camera,
    lamp_sigma: float | None,
    band_errors: BandErrors,
) -> LinearModel:
    """base : (band, y, x) DN at the lamp's stated power, as the fitted camera sees it.

    coverage : (y, x, f) of flat faces. derivative : (11, band, y, x) of the best signal known by camera and lamp.
    """
    inside = binary_erosion(coverage.max(axis=-1) == 1, np.ones((3, 3)), _FROM_EDGE_PX, border_value=1)
    sigma = np.sqrt(variance[used])
    design = np.array([_without_priors(d[used] / sigma) for d in derivative]).T
    count = len(sigma)
    priors = nuisance_priors(calibrated, lamp_sigma)
    design[count:] = priors
    residual = np.zeros(count + Nuisances.count)
    residual[:count] = (measured - fit.lamp_scale * base)[used] / sigma
    residual[count:] = priors @ fit.missed(calibrated).vector
    design /= np.linalg.norm(design, axis=0)
    basis = np.linalg.qr(design)[0]
    projected = residual - basis @ (basis.T @ residual)
    rows, columns = np.indices(used.shape[1:]) * _PATCHES // np.array(used.shape[1:])[:, None, None]
    patch = np.broadcast_to(rows * _PATCHES + columns, used.shape)[used]
    interior = np.broadcast_to(inside, used.shape)[used]
    return LinearModel(
        used=used,
        interior=interior,
        patch=patch,
        sigma=sigma,
        priors=priors,
        by_lamp=derivative[Nuisances.of_lamp][used],
        basis=basis,
        shared_errors=_shared_errors(fit.lamp_scale * base, coverage, used, sigma, band_errors),
        residual=projected,
        dark_errors=len(base) if band_errors.dark_counts else 0,
    )


def _shared_errors(
    signal: NDArray, coverage: NDArray, used: NDArray, sigma: NDArray, errors: BandErrors
) -> NDArray[np.float32]:
    each = np.eye(len(signal))[:, :, None, None]
    bands = [size * one * signal for size, one in zip(np.hypot(_BAND_ERROR, errors.relative), each, strict=True)]
    darks = [errors.dark_dn * one * np.ones_like(signal) for one in each] if errors.dark_counts else []
    faces = [_FACE_ERROR * part * signal for part in np.moveaxis(coverage, -1, 0) if part.any()]
    rows = [_without_priors(error[used] / sigma).astype(np.float32) for error in (*darks, *bands, *faces)]
    return np.array(rows).T
