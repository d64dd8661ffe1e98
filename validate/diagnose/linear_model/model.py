"""Linear model of a residual over sigma, with camera and lamp projected out.

To first order the measured signals are r = D t + s a + noise. D holds the derivatives by the eleven nuisances t,
their priors as further rows; s is an effect's signature and a its amplitude. Minimising over t is a projection, so
an effect's gain in chi2 is that of the projected signature alone. A vector (n + 11,) holds the n used samples over
sigma, then the eleven rows of the priors. Without darks, rows of the bands' dark levels stand between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter

from ...compare import NuisanceFit, Nuisances
from ...predict import PictureErrors

__all__ = [
    "BandErrors",
    "LinearModel",
    "build_linear_model",
    "model_variance",
    "nuisance_priors",
    "smooth_excess",
    "smooth_part",
]

#: Relative standard deviation of a rendering's own error. Surface means of an independent simulator's pictures agree
#: within 0.15 %.
_RELATIVE_ERROR = 0.0015
#: Standard deviation of the position of a rendering's edges, px: edges of an independent simulator agree within this.
_EDGE_ERROR_PX = 0.005

#: Relative standard deviation of an error that all samples of a band share. Bands of an independent simulator's
#: captures scatter by 0.06 to 0.08 %, differently in each capture.
_BAND_ERROR = 0.0007

#: Relative standard deviation of an error that all samples of a flat face share, compared with the same simulator.
_FACE_ERROR = 0.001

#: Error of the dark level by rounding below which it is left out, DN: noise of half a count makes it 0.002.
_MIN_DARK_ERROR_DN = 0.001

#: Shared errors are taken off a residual up to this many of their standard deviations: a size that chance gives.
_MAX_SHARED_ERROR_SIGMA = 2.0

#: Distance from a face's edges at which a pixel counts as interior, px: contact shadows depend on gaps below 1 mm.
_INTERIOR_DISTANCE_PX = 2

#: Numerics: relative singular-value cutoff of the changes that several numbers make: below it they repeat one another.
_RELATIVE_CUTOFF = 1e-5

#: Patches of the image across and down, within which residuals may be correlated.
_PATCHES = 8


def model_variance(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance of a rendering's own error, by level and by local contrast.

    (0.0015 signal)^2 + (0.005 px x contrast)^2, where contrast is the range of the signal over 3 x 3 pixels.

    Parameters
    ----------
    signal
        (band, y, x) predicted signal, DN.

    Returns
    -------
    NDArray
        (band, y, x) variance, DN^2.
    """
    contrast = maximum_filter(signal, (0, 3, 3)) - minimum_filter(signal, (0, 3, 3))
    return (_RELATIVE_ERROR * signal) ** 2 + (_EDGE_ERROR_PX * contrast) ** 2


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearModel:
    """Residual of one capture over sigma, with what is needed to project and to whiten changes."""

    #: (band, y, x) whether a sample is used; n of them are.
    used: NDArray[np.bool_]
    #: (n,) whether a used sample lies well inside one flat face.
    interior: NDArray[np.bool_]
    #: (n,) number of the patch of the image that a sample lies in, from 0.
    patch: NDArray[np.int64]
    #: (n,) standard deviation of measured minus predicted, DN.
    sigma: NDArray[np.float64]
    #: (11, 11) rows of the priors of camera and lamp, see `nuisance_priors`.
    priors: NDArray[np.float64]
    #: (n,) derivative of the signal by the lamp's scale, DN.
    by_lamp: NDArray[np.float64]
    #: (n + 11, k) orthonormal basis of the nuisances: camera, lamp, and what `marginalised_over` adds.
    basis: NDArray[np.float64]
    #: (n + 11, m) over sigma, one standard deviation each of errors that a band or a face shares.
    shared_errors: NDArray[np.float32]
    #: (n + 11,) measured minus base over sigma, then the rows of the priors; already projected.
    residual: NDArray[np.float64]
    #: Number of leading columns of `shared_errors` that are errors of bands' dark levels.
    dark_errors: int = 0
    #: Rendering errors by which vectors are whitened in addition to sigma; None where they are not counted.
    errors: PictureErrors | None = None
    #: (band,) share of the pixels that each band sees behind a mosaic, 0 to 1; None without a mosaic.
    seen_share: tuple[float, ...] | None = None

    @property
    def count(self) -> int:
        """Number n of used samples."""
        return len(self.sigma)

    def project(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """The part of a whitened vector that no nuisance can imitate.

        Parameters
        ----------
        vector
            (..., n + 11) over sigma.

        Returns
        -------
        NDArray
            (..., n + 11) orthogonal to `basis`.
        """
        return vector - (vector @ self.basis) @ self.basis.T

    def whiten(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change of the picture over sigma, projected.

        Parameters
        ----------
        change
            (band, y, x) DN.

        Returns
        -------
        NDArray
            (n + 11,) projected; the rows of the priors were 0 before the projection.
        """
        return self.whiten_used(change[self.used])

    def whiten_used(self, change: NDArray) -> NDArray[np.float64]:
        """A change of the used samples over sigma, projected.

        Several changes at once take a quarter of their time one by one, since `basis` is read once.

        Parameters
        ----------
        change
            (..., n) DN.

        Returns
        -------
        NDArray
            (..., n + 11), each as of `whiten`.
        """
        pixels = change / self.sigma
        vectors = np.zeros((*pixels.shape[:-1], len(self.residual)))
        vectors[..., : self.count] = pixels if self.errors is None else self.errors.whitened(pixels)
        return self.project(vectors)

    def counting(self, errors: PictureErrors) -> LinearModel:
        """The model with rendering errors in the covariance, which then whiten all vectors.

        Errors that bands and faces share are among them, so `shared_errors` is empty afterwards.

        Parameters
        ----------
        errors
            Rendering errors at the used samples.

        Returns
        -------
        LinearModel
            With basis and residual whitened by the errors.
        """

        def whitened(vector: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.append(errors.whitened(vector[: self.count]), vector[self.count :])

        basis = np.linalg.qr(np.array([whitened(column) for column in self.basis.T]).T)[0]
        none = np.zeros((len(self.residual), 0), np.float32)
        model = replace(self, errors=errors, basis=basis, shared_errors=none, dark_errors=0)
        return replace(model, residual=model.project(whitened(self.residual)))

    def marginalised_over(self, columns: Sequence[NDArray[np.float64]]) -> LinearModel:
        """The model with further nuisances: the changes that other effects' numbers make.

        Parameters
        ----------
        columns
            (n + 11,) projected changes, one per number; changes of size 0 are left out.

        Returns
        -------
        LinearModel
            With a larger basis, its residual projected again.
        """
        sizes = [float(np.linalg.norm(column)) for column in columns]
        moving = [column / size for column, size in zip(columns, sizes, strict=True) if size > 0]
        if not moving:
            return self
        u, values, _ = np.linalg.svd(np.array(moving).T, full_matrices=False)
        basis = np.hstack([self.basis, u[:, values > _RELATIVE_CUTOFF * values[0]]])
        free = replace(self, basis=basis)
        return replace(free, residual=free.project(self.residual))

    def with_priors_of(self, columns: Sequence[NDArray[np.float64]], missed: NDArray[np.float64]) -> LinearModel:
        """The model with further nuisances, bound to priors by rows before those of camera and lamp.

        Parameters
        ----------
        columns
            (n,) over sigma each, changes by one standard deviation of a prior.
        missed
            (k,) prior values minus those of the base, in standard deviations.

        Returns
        -------
        LinearModel
            With a larger basis, its residual projected again.
        """
        rows = np.full(len(columns), self.count)
        residual = np.insert(self.residual, rows, missed)
        basis, shared = np.insert(self.basis, rows, 0, axis=0), np.insert(self.shared_errors, rows, 0, axis=0)
        model = replace(self, residual=residual, basis=basis, shared_errors=shared)
        projected = [
            model.project(np.concatenate([column, unit, np.zeros(Nuisances.count)]))
            for column, unit in zip(columns, np.eye(len(columns)), strict=True)
        ]
        return model.marginalised_over(projected)

    def gain_of_dark_errors(self, change: NDArray) -> float:
        """Mean chi2 that a change gains by fitting errors of the bands' dark levels.

        Parameters
        ----------
        change
            (n + 11,) projected, over sigma.

        Returns
        -------
        float
            Chi2.
        """
        along = self.shared_errors[:, : self.dark_errors].T @ change
        return float(along @ along) / max(float(change @ change), 1e-300)

    def without_shared_errors(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """A residual minus the part that errors shared by a band or a face explain.

        Each error is fitted with its prior of unit variance, and clipped to two standard deviations.

        Parameters
        ----------
        residual
            (n + 11,) projected, over sigma.

        Returns
        -------
        NDArray
            (n + 11,) over sigma.
        """
        shared = self.projected_shared_errors()
        size = np.linalg.solve(np.eye(shared.shape[1]) + shared.T @ shared, shared.T @ residual)
        return residual - shared @ np.clip(size, -_MAX_SHARED_ERROR_SIGMA, _MAX_SHARED_ERROR_SIGMA)

    def projected_shared_errors(self) -> NDArray[np.float64]:
        """Projected `shared_errors`; computed in place, since there are dozens of columns.

        Returns
        -------
        NDArray
            (n + 11, m) over sigma.
        """
        shared = self.shared_errors.astype(float)
        for column in shared.T:
            column -= self.basis @ (self.basis.T @ column)
        return shared

    def camera_change(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change of the camera's parameters, projected.

        The camera's fit can make the same change of the picture. So only the rows of the priors differ, and no
        rendering error enters.

        Parameters
        ----------
        change
            (10,) in the parameters' units.

        Returns
        -------
        NDArray
            (n + 11,) projected.
        """
        return self._of_priors(Nuisances(change, 0.0).vector)

    def lamp_change(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """A change of the picture by the lamp's power, projected.

        Only the row of the lamp's prior differs. A projection on `by_lamp` turns the change into one of the lamp's
        scale. This may belong to a picture with effects that the base of the change lacks; their difference does
        not count as a change.

        Parameters
        ----------
        change
            (band, y, x) DN.

        Returns
        -------
        NDArray
            (n + 11,) projected.
        """
        ours, theirs = self.by_lamp / self.sigma, change[self.used] / self.sigma
        vector = np.zeros(Nuisances.count)
        vector[Nuisances.of_lamp] = (ours @ theirs) / (ours @ ours)
        return self._of_priors(vector)

    def _of_priors(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change (n + 11,), projected, by nuisances (11,) whose part in the picture is taken off."""
        return self.project(np.append(np.zeros(len(self.residual) - Nuisances.count), -self.priors @ vector))

    @property
    def chi2(self) -> float:
        """Sum of squares with the nuisances at their best."""
        return float(self.residual @ self.residual)

    def image(self, vector: NDArray[np.floating]) -> NDArray[np.float64]:
        """The samples of a whitened vector as pictures.

        Parameters
        ----------
        vector
            (n + 11,) or longer than n; rows after the first n are left out.

        Returns
        -------
        NDArray
            (band, y, x) over sigma, NaN where unused.
        """
        picture = np.full(self.used.shape, np.nan)
        picture[self.used] = vector[: self.count]
        return picture


def smooth_excess(model: LinearModel, residual: NDArray[np.float64], block_px: int = 8) -> float:
    """Mean square of interior blocks' means, minus its expectation from the scatter inside them.

    Noise averages out in a block, an error of the model does not: 0.1 standard deviations everywhere are not
    significant in chi2, but are here. The expectation is 0 for noise, also for noise larger than stated. Blocks with
    less than a quarter of their samples interior are left out; behind a mosaic a quarter of those that a band sees.

    Parameters
    ----------
    model
        Model of the capture, for its used and interior samples.
    residual
        (n + 11,) over sigma.
    block_px
        Side of a block, px.

    Returns
    -------
    float
        Chi2 per sample; 0 where no block is filled.
    """
    blocks = _blocks(model.image(np.where(model.interior, residual[: model.count], np.nan)), block_px)
    counts = np.isfinite(blocks).sum(axis=1)
    full = counts >= block_px**2 // 4
    if model.seen_share is not None:
        expected = block_px**2 / 4 * np.repeat(model.seen_share, len(blocks) // len(model.seen_share))
        full = counts >= np.maximum(expected, 2)
    if not full.any():
        return 0.0
    means, scatter = np.nanmean(blocks[full], axis=1), np.nanvar(blocks[full], axis=1, ddof=1)
    return float(np.sum(counts[full] * means**2 - scatter) / counts[full].sum())


def smooth_part(model: LinearModel, change: NDArray[np.float64], block_px: int = 8) -> float:
    """Share of a change's sum of squares that block means keep.

    Parameters
    ----------
    model
        Model of the capture, for its used samples.
    change
        (n + 11,) over sigma.
    block_px
        Side of a block, px.

    Returns
    -------
    float
        Near 1 for changes of surfaces, near 0 for changes at edges.
    """
    blocks = _blocks(model.image(change), block_px)
    counts = np.isfinite(blocks).sum(axis=1)
    means = np.nansum(blocks, axis=1) / np.maximum(counts, 1)
    return float(np.sum(counts * means**2) / max(np.nansum(blocks**2), 1e-300))


def _blocks(picture: NDArray[np.float64], block_px: int) -> NDArray[np.float64]:
    """(block, pixel) of a picture (band, y, x); incomplete blocks at its end are left out."""
    bands, height, width = picture.shape
    rows, columns = height // block_px, width // block_px
    cut = picture[:, : rows * block_px, : columns * block_px]
    return cut.reshape(bands, rows, block_px, columns, block_px).swapaxes(2, 3).reshape(-1, block_px**2)


def nuisance_priors(calibrated: Camera, lamp_sigma: float | None) -> NDArray[np.float64]:
    """Rows that bind camera and lamp scale to the survey and to the lamp's stated power.

    The camera's rows are the inverse Cholesky factor of its covariance, the lamp's row is 1 / sigma. Rows times a
    deviation (11,) give independent standard deviations.

    Parameters
    ----------
    calibrated
        Camera with the covariance of its ten parameters; None leaves its rows 0.
    lamp_sigma
        Relative standard deviation of the lamp's stated power; None leaves its row 0.

    Returns
    -------
    NDArray
        (11, 11) rows.
    """
    of_camera, of_lamp = Nuisances.of_camera, Nuisances.of_lamp
    rows = np.zeros((Nuisances.count, Nuisances.count))
    if calibrated.covariance is not None:
        rows[of_camera, of_camera] = np.linalg.inv(np.linalg.cholesky(calibrated.covariance))
    if lamp_sigma is not None:
        rows[of_lamp, of_lamp] = 1 / lamp_sigma
    return rows


def _without_priors(pixels: NDArray) -> NDArray[np.float64]:
    """A whitened vector (n + 11,) with zeros in the rows of the priors."""
    return np.append(pixels, np.zeros(Nuisances.count))


@dataclass(frozen=True, eq=False)
class BandErrors:
    """Errors that all samples of a band share, one standard deviation each."""

    #: (band,) relative to the signal, by the tabulation of spectra.
    relative: NDArray[np.float64]
    #: Of the dark level in the signal, DN.
    dark_dn: float

    @property
    def dark_counts(self) -> bool:
        """Whether the error of the dark level is large enough to be counted."""
        return self.dark_dn > _MIN_DARK_ERROR_DN


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
    """Linear model of a capture about the fitted camera and lamp.

    Parameters
    ----------
    measured
        (band, y, x) signal above dark, DN.
    base
        (band, y, x) signal predicted at the lamp's stated power through the fitted camera, DN.
    variance
        (band, y, x) variance of measured minus base, DN^2.
    used
        (band, y, x) whether a sample is used.
    coverage
        (y, x, face) share of a pixel that each flat face covers, 0 to 1.
    derivative
        (11, band, y, x) derivatives of the best prediction by camera and lamp, DN.
    fit
        The fitted camera and lamp scale.
    calibrated
        Camera of the survey, with its covariance.
    lamp_sigma
        Relative standard deviation of the lamp's stated power, or None.
    band_errors
        Errors that bands share.

    Returns
    -------
    LinearModel
        With its residual projected.
    """
    inside = binary_erosion(coverage.max(axis=-1) == 1, np.ones((3, 3)), _INTERIOR_DISTANCE_PX, border_value=1)
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
    """(n + 11, m) over sigma: dark levels where they count, then bands, then visible flat faces."""
    unit_bands = np.eye(len(signal))[:, :, None, None]
    bands = [
        size * band * signal for size, band in zip(np.hypot(_BAND_ERROR, errors.relative), unit_bands, strict=True)
    ]
    darks = [band * np.full(signal.shape, errors.dark_dn) for band in unit_bands] if errors.dark_counts else []
    faces = [_FACE_ERROR * part * signal for part in np.moveaxis(coverage, -1, 0) if part.any()]
    rows = [_without_priors(error[used] / sigma).astype(np.float32) for error in (*darks, *bands, *faces)]
    return np.array(rows).T
