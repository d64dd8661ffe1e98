"""Fits of linear fields: normal equations by band, width of the prior, evidence.

A field is a set of images Phi_k that an operator turns into changes of the signal. Its coefficients a have a normal
prior of width tau; the images are scaled so that one width serves all. H is the information about a after adjustment
of camera, lamp and shared errors, and b the projection of the residual. Then

    2 ln(evidence) = tau^2 b^T (1 + tau^2 H)^-1 b - ln det(1 + tau^2 H)

(Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, section 5.4). The width tau is the one at
which the evidence is largest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.sparse import csr_matrix

from .residual_data import ResidualData

__all__ = [
    "FieldFit",
    "NormalEquations",
    "cross_validate",
    "each_band",
    "fit_result",
    "fixed_spectrum",
    "free_spectrum",
    "next_to_common_field",
    "normal_equations",
    "pixel_fit",
    "solve_coefficients",
]

#: Numerics: squared widths of the prior that are tried, times the largest eigenvalue of the information, in quarter
#: decades.
_RELATIVE_WIDTHS = np.logspace(-8, 6, 57)

#: Numerics: relative eigenvalue of the information below which a combination of coefficients is undetermined.
_MIN_EIGENVALUE = 1e-7

#: Numerics: ridge of a trial fit, relative to the trace of its matrix: rounding of double precision.
_TRIAL_RIDGE = 1e-13

#: Numerics: smallest part of a nuisance that a field leaves: columns of single precision do not resolve less.
_MIN_NUISANCE_PART = 1e-5

#: Numerics: pixels whose columns are converted to double precision at once: limits the memory.
_BLOCK_PIXELS = 2**15

#: Numerics: rounds of the alternating fit of map and spectrum.
_MAX_ROUNDS = 6

#: Numerics: change of a spectrum, relative to its largest number, that ends the alternating fit: evidence changes by
#: its square.
_MAX_SPECTRUM_CHANGE = 1e-3

#: Fewest bands of a map for holding out every other one: two are fitted and one is tested, or more.
_MIN_BANDS_TO_HOLD_OUT = 3

#: Parts of the pixels that may deviate: all of an old flat, few that are hot.
_DEVIATING_PARTS = (1.0, 0.3, 0.1, 0.03, 0.01)

#: Side of the squares whose means are taken off before neighbours are compared, px: smooth patterns are not of pixels.
_LOCAL_MEAN_PX = 5


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of a field of k images in each band, with m nuisances."""

    #: (band, k, k) products of the whitened columns, X^T X.
    a: NDArray[np.float64]
    #: (band, k) products of the whitened columns with the residual.
    b: NDArray[np.float64]
    #: (band, m, k) products of the nuisances with the whitened columns, W^T X.
    c: NDArray[np.float64]
    #: (band, k, k) ``a`` of the pixels of the trial fit alone.
    trial_a: NDArray[np.float64]
    #: (band, k) ``b`` of the pixels of the trial fit alone.
    trial_b: NDArray[np.float64]
    #: (band, k) ``b`` of the pixels held out from it, next to other fields there; None for ``b`` less ``trial_b``.
    held_out_b: NDArray[np.float64] | None = None

    def of_sums(self, parts: NDArray[np.float64]) -> NormalEquations:
        """Normal equations of sums of the images.

        Parameters
        ----------
        parts
            (q, k) coefficients of the images in each sum.

        Returns
        -------
        NormalEquations
            Those of a field of q images.
        """
        return NormalEquations(
            parts @ self.a @ parts.T,
            self.b @ parts.T,
            self.c @ parts.T,
            parts @ self.trial_a @ parts.T,
            self.trial_b @ parts.T,
        )


def normal_equations(
    data: ResidualData, columns: NDArray[Any] | csr_matrix, band: int
) -> tuple[NDArray[np.float64], ...]:
    """Normal equations of a field in one band.

    Parameters
    ----------
    data
        Residual to be fitted.
    columns
        (k, pixel) change of the signal by each image of the field, DN.
    band
        Index of the band.

    Returns
    -------
    tuple
        a, b, c, trial_a and trial_b of ``NormalEquations``, without the axis of the bands.
    """
    pixels = data.used[band].size
    if isinstance(columns, csr_matrix):
        return _of_pixels(data, columns, band, slice(0, pixels))
    several = (
        _of_pixels(data, columns[:, start : start + _BLOCK_PIXELS], band, slice(start, start + _BLOCK_PIXELS))
        for start in range(0, pixels, _BLOCK_PIXELS)
    )
    return tuple(sum(part) for part in zip(*several, strict=True))


def _of_pixels(
    data: ResidualData, columns: NDArray[Any] | csr_matrix, band: int, pixels: slice
) -> tuple[NDArray[np.float64], ...]:
    """Contribution of some pixels to the normal equations of one band."""
    weight = data.weight[band].ravel()[pixels]
    residual = data.marginal_residual[band].ravel()[pixels]
    if isinstance(columns, csr_matrix):
        whitened = columns.multiply(weight[None, :]).tocsr()
    else:
        whitened = columns.astype(np.float64) * weight
    in_trial = np.flatnonzero(~data.held_out.ravel()[pixels])
    trial = whitened[:, in_trial]
    nuisances = data.nuisances[band].reshape(data.used[band].size, -1)[pixels]
    parts = (
        whitened @ whitened.T,
        whitened @ residual,
        (whitened @ nuisances).T,
        trial @ trial.T,
        trial @ residual[in_trial],
    )
    return tuple(np.asarray(p.toarray() if isinstance(p, csr_matrix) else p, np.float64) for p in parts)


@dataclass(frozen=True, eq=False)
class FieldFit:
    """Fitted field with its gain and evidence."""

    #: (band, k) coefficients.
    coefficients: NDArray[np.float64]
    #: Decrease of chi2.
    gain: float
    #: 2 ln of the evidence over that of noise alone.
    evidence: float
    #: Gain per gain of a trial fit: in the pixels held out, over that in the pixels fitted.
    heldout: float
    #: Effective number of free coefficients.
    freedom: float
    #: (band,) sum of squares of the change over sigma.
    size: NDArray[np.float64]
    #: The same for bands held out from a trial fit of a map that all bands share; NaN for other fits.
    heldout_bands: float = float("nan")

    @property
    def predicts(self) -> float:
        """Gain per gain of a trial fit, the larger of pixels and bands held out.

        A small spot is not predicted from the pixels around it, but from the same pixels in other bands.
        """
        return float(np.fmax(self.heldout, self.heldout_bands))


def solve_coefficients(h: NDArray[Any], b: NDArray[Any]) -> tuple[NDArray[Any], float, float, float]:
    """Coefficients under the prior width that maximises the evidence.

    Parameters
    ----------
    h
        (k, k) information.
    b
        (k,) projection of the residual.

    Returns
    -------
    tuple
        (k,) coefficients, 2 ln evidence, effective number of coefficients, squared width tau^2 of the prior.
    """
    mu, v = np.linalg.eigh((h + h.T) / 2)
    determined = mu > _MIN_EIGENVALUE * mu.max(initial=0.0)
    mu, v = mu[determined], v[:, determined]
    square = (v.T @ b) ** 2
    scale = 1 / max(float(mu.max(initial=0.0)), 1e-300)
    widths = _RELATIVE_WIDTHS * scale
    inside = 1 + widths[:, None] * mu
    values = (widths[:, None] * square / inside - np.log(inside)).sum(axis=1)
    best = int(np.argmax(values))
    t = widths[best]
    x = v @ (t * (v.T @ b) / (1 + t * mu))
    return x, float(values[best]), float((t * mu / (1 + t * mu)).sum()), float(t)


def cross_validate(a: NDArray[Any], b: NDArray[Any], width: float) -> NDArray[Any]:
    """Coefficients of a trial fit, to be tested in the pixels that it holds out.

    The prior keeps the system regular for a field that is not visible in these pixels. A small ridge does so against
    rounding where the prior is too wide for that.

    Parameters
    ----------
    a
        (k, k) products of the whitened columns in the pixels of the trial fit, without nuisances.
    b
        (k,) their products with the residual.
    width
        Squared width of the prior, from the fit to all pixels.

    Returns
    -------
    NDArray
        (k,) coefficients.
    """
    return np.linalg.solve(a + (1 / width + _TRIAL_RIDGE * np.trace(a)) * np.eye(len(a)), b)


def _gain(h: NDArray[Any], b: NDArray[Any], x: NDArray[Any]) -> float:
    return float(2 * x @ b - x @ h @ x)


def fixed_spectrum(n: NormalEquations, spectrum: NDArray[Any]) -> FieldFit:
    """Fit of one map for all bands, times a given number for each band.

    Parameters
    ----------
    n
        Normal equations of the field.
    spectrum
        (band,) factors of the map.

    Returns
    -------
    FieldFit
        The fit; its coefficients are the map's times the spectrum.
    """
    s = np.asarray(spectrum, float)
    h, b = _combined(n.a, n.c, s), s @ n.b
    x, evidence, freedom, width = solve_coefficients(h, b)
    coefficients = s[:, None] * x
    trial = cross_validate(np.einsum("b,bjk->jk", s**2, n.trial_a), s @ n.trial_b, width)
    fit = fit_result(n, coefficients, s[:, None] * trial, evidence, freedom)
    return replace(fit, heldout_bands=_held_out_bands(n, s, width))


def _held_out_bands(n: NormalEquations, s: NDArray[Any], width: float) -> float:
    """Gain by trial fits of a map in the bands held out, over that in the fitted bands.

    The fits are to every other band; NaN for too few bands.
    """
    visible = np.flatnonzero(s)
    if len(visible) < _MIN_BANDS_TO_HOLD_OUT:
        return float("nan")
    a, b = s[:, None, None] ** 2 * n.a, s[:, None] * n.b
    gains = np.zeros(2)
    for some, others in ((visible[::2], visible[1::2]), (visible[1::2], visible[::2])):
        trial = cross_validate(a[some].sum(axis=0), b[some].sum(axis=0), width)
        gains += [_gain(a[part].sum(axis=0), b[part].sum(axis=0), trial) for part in (some, others)]
    return float(gains[1] / gains[0]) if gains[0] > 0 else 0.0


def _combined(a: NDArray[Any], c: NDArray[Any], s: NDArray[Any]) -> NDArray[Any]:
    """(k, k) information about one map that all bands share, times the numbers s (band,)."""
    with_nuisances = np.einsum("b,bmk->mk", s, c)
    return np.einsum("b,bjk->jk", s**2, a) - with_nuisances.T @ with_nuisances


def each_band(n: NormalEquations) -> FieldFit:
    """Fit of a separate map in each band; nuisances couple the bands.

    Each band has its own width of the prior.

    Parameters
    ----------
    n
        Normal equations of the field.

    Returns
    -------
    FieldFit
        The fit.
    """
    widths, trials = [], []
    for a, b, c, trial_a, trial_b in zip(n.a, n.b, n.c, n.trial_a, n.trial_b, strict=True):
        *_, width = solve_coefficients(a - c.T @ c, b)
        widths.append(width)
        trials.append(cross_validate(trial_a, trial_b, width))
    inner = np.array([np.linalg.inv(a + np.eye(len(a)) / t) for a, t in zip(n.a, widths, strict=True)])
    alone = np.einsum("bjk,bk->bj", inner, n.b)
    passed = n.c @ inner
    coupling = np.eye(n.c.shape[1]) - np.tensordot(passed, n.c, axes=((0, 2), (0, 2)))
    values, vectors = np.linalg.eigh(coupling)
    values = np.maximum(values, _MIN_NUISANCE_PART)
    nuisance = vectors @ ((vectors.T @ np.einsum("bmk,bk->m", n.c, alone)) / values)
    x = alone + nuisance @ passed
    volume = sum(np.linalg.slogdet(np.eye(len(a)) + t * a)[1] for a, t in zip(n.a, widths, strict=True))
    evidence = float(np.sum(x * n.b) - volume - np.log(values).sum())
    freedom = sum(len(a) - np.trace(i) / t for a, i, t in zip(n.a, inner, widths, strict=True))
    return fit_result(n, x, np.array(trials), evidence, float(freedom))


def next_to_common_field(n: NormalEquations) -> NormalEquations:
    """Normal equations of a field next to the same field that is common to all bands.

    The common field is one more nuisance, at its best fit without the other. Its prior has the width that maximises
    the evidence of the common field alone. It is fitted again to the pixels of the trial fit, and to those held out:
    errors of rendered edges differ between the two, and are no failure of the prediction.

    Parameters
    ----------
    n
        Normal equations of the field.

    Returns
    -------
    NormalEquations
        Normal equations of the deviations of single bands from the common field.
    """
    with_nuisances = n.c.sum(axis=0)
    h, b = n.a.sum(axis=0) - with_nuisances.T @ with_nuisances, n.b.sum(axis=0)
    common, *_, width = solve_coefficients(h, b)
    cross = n.a - with_nuisances.T @ n.c
    values, vectors = np.linalg.eigh((h + h.T) / 2)
    whitened = (vectors / np.sqrt(np.maximum(values, 0.0) + 1 / width)).T @ cross
    nuisances = np.concatenate([n.c, whitened], axis=1)
    trial_b, held_out_b = (
        b - a @ solve_coefficients(a.sum(axis=0), b.sum(axis=0))[0]
        for a, b in ((n.trial_a, n.trial_b), (n.a - n.trial_a, n.b - n.trial_b))
    )
    return NormalEquations(n.a, n.b - common @ cross, nuisances, n.trial_a, trial_b, held_out_b)


def free_spectrum(n: NormalEquations) -> FieldFit:
    """Fit of one map for all bands, times a free number for each band.

    Map and spectrum are fitted in turn, from two starts: the maps of single bands, and one map for all bands. The
    fit with the larger evidence is returned.

    Parameters
    ----------
    n
        Normal equations of the field.

    Returns
    -------
    FieldFit
        The fit; each free number of the spectrum costs the logarithm of the gain in evidence.
    """
    alone = each_band(n).coefficients
    u, _, _ = np.linalg.svd(alone * np.sqrt(np.einsum("bkk->k", n.a)), full_matrices=False)
    return max((_in_turn(n, start) for start in (u[:, 0], np.ones(len(u)))), key=lambda fit: fit.evidence)


def _in_turn(n: NormalEquations, start: NDArray[Any]) -> FieldFit:
    """Alternating fit of map and spectrum from a starting spectrum (band,)."""
    s = np.asarray(start, float) / np.abs(start).max()
    for _ in range(_MAX_ROUNDS):
        x, evidence, freedom, width = solve_coefficients(_combined(n.a, n.c, s), s @ n.b)
        nuisance = n.c @ x
        h = np.diag(n.a @ x @ x) - nuisance @ nuisance.T
        s = np.linalg.lstsq(h, n.b @ x, rcond=1e-9)[0]
        largest = np.abs(s).max()
        if not largest > 0:
            break
        before, s = s, s / largest
        if np.abs(s - before).max() < _MAX_SPECTRUM_CHANGE:
            break
    x, evidence, freedom, width = solve_coefficients(_combined(n.a, n.c, s), s @ n.b)
    trial = cross_validate(np.einsum("b,bjk->jk", s**2, n.trial_a), s @ n.trial_b, width)
    free = len(s) - 1
    penalty = free * np.log(max(_gain(_combined(n.a, n.c, s), s @ n.b, x), 2.0))
    fit = fit_result(n, s[:, None] * x, s[:, None] * trial, evidence - penalty, freedom + free)
    return replace(fit, heldout_bands=_held_out_bands(n, s, width))


def pixel_fit(
    data: ResidualData, operator: NDArray[np.float64], common_variance: float = 0.0
) -> tuple[FieldFit, float]:
    """Fit of one number for each pixel, alike in all bands, that its neighbours do not predict.

    Each number is the pixel's own less the mean of its eight neighbours. Camera, lamp and shared errors are smooth
    against single pixels and are not adjusted. No pixel predicts another: bands are held out, not pixels.

    Parameters
    ----------
    data
        Residual to be explained.
    operator
        (band, y, x) change of the signal by a number of 1 in every pixel, DN.
    common_variance
        Variance of the numbers by noise that all bands share, as that of their darks.

    Returns
    -------
    tuple
        The fit, with coefficients (band, pixel), and the largest correlation of the numbers with those of a neighbour.
    """
    size = (operator * data.weight) ** 2
    product = operator * data.weight * data.marginal_residual
    numbers = _single_pixels(product, size)
    h, b = size.sum(axis=0).ravel(), (size.sum(axis=0) * numbers).ravel()
    widening = 1 + common_variance * h
    h, b = h / widening, b / widening
    prior = _likeliest_prior(h, b)
    x, part = _pixels_under_prior(h, b, prior)
    gains = np.zeros(2)
    for some, others in ((slice(None, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(None, None, 2))):
        of_some = size[some].sum(axis=0)
        trial, _ = _pixels_under_prior(
            of_some.ravel(), (of_some * _single_pixels(product[some], size[some])).ravel(), prior
        )
        for index, bands in enumerate((some, others)):
            of_part = size[bands].sum(axis=0)
            target = (_single_pixels(product[bands], size[bands]) * of_part).ravel()
            gains[index] += float(np.sum(2 * trial * target - trial**2 * of_part.ravel()))
    heldout = float(gains[1] / gains[0]) if gains[0] > 0 else 0.0
    coefficients = np.tile(x, (len(operator), 1))
    of_bands = np.sum(size.reshape(len(size), -1) * x**2, axis=1)
    freedom = float(np.sum(part * prior.width * h / (1 + prior.width * h)))
    gain = float(np.sum(widening * (2 * x * b - x**2 * h)))
    fit = FieldFit(coefficients, gain, prior.evidence, heldout, freedom, of_bands, heldout)
    return fit, _neighbours_correlation(product, size)


@dataclass(frozen=True)
class _PixelPrior:
    """Prior of pixels: a part of them deviates, by normal numbers."""

    #: Squared width of the deviations.
    width: float
    #: Part of the pixels that deviate.
    part: float
    #: 2 ln of the evidence over that of noise alone.
    evidence: float


def _likeliest_prior(h: NDArray[np.float64], b: NDArray[np.float64]) -> _PixelPrior:
    """Width and part with the largest evidence, for information h and products b (pixel,)."""
    scale = 1 / max(float(h.max(initial=0.0)), 1e-300)
    trials = []
    for width in scale * _RELATIVE_WIDTHS[::2]:
        odds = 0.5 * (width * b**2 / (1 + width * h) - np.log1p(width * h))
        for part in _DEVIATING_PARTS:
            evidence = odds if part == 1 else np.logaddexp(np.log1p(-part), np.log(part) + odds)
            trials.append(_PixelPrior(float(width), part, 2 * float(evidence.sum())))
    return max(trials, key=lambda prior: prior.evidence)


def _pixels_under_prior(
    h: NDArray[np.float64], b: NDArray[np.float64], prior: _PixelPrior
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(pixel,) mean numbers under a prior, and probabilities that a pixel deviates."""
    odds = 0.5 * (prior.width * b**2 / (1 + prior.width * h) - np.log1p(prior.width * h))
    if prior.part < 1:
        odds = odds + np.log(prior.part) - np.log1p(-prior.part)
        deviates = 1 / (1 + np.exp(-np.clip(odds, -500, 500)))
    else:
        deviates = np.ones(len(h))
    return deviates * prior.width * b / (1 + prior.width * h), deviates


def _mean_numbers(product: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) number of each pixel by least squares over the bands."""
    total = size.sum(axis=0)
    return np.asarray(np.where(total > 0, product.sum(axis=0) / np.where(total > 0, total, 1.0), 0.0))


def _single_pixels(product: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) number of each pixel less the weighted mean of its eight neighbours."""
    numbers, used = _mean_numbers(product, size), (size.sum(axis=0) > 0).astype(float)
    around = uniform_filter(used, 3, mode="constant") * 9 - used
    mean = (uniform_filter(numbers * used, 3, mode="constant") * 9 - numbers * used) / np.maximum(around, 1.0)
    return np.asarray(np.where((used > 0) & (around >= 1), numbers - mean, 0.0))


def _neighbours_correlation(product: NDArray[np.float64], size: NDArray[np.float64]) -> float:
    """Largest correlation of the pixels' numbers with neighbours', of four directions.

    Noise is included. It is that of differences to the local mean, 0 or less where pixels have nothing to do with each
    other.
    """
    numbers = _mean_numbers(product, size) * np.sqrt(size.sum(axis=0))
    high = numbers - uniform_filter(numbers, _LOCAL_MEAN_PX, mode="nearest")
    power = float(np.sum(high**2))
    pairs = (
        (high[1:], high[:-1]),
        (high[:, 1:], high[:, :-1]),
        (high[1:, 1:], high[:-1, :-1]),
        (high[1:, :-1], high[:-1, 1:]),
    )
    return max(float(np.sum(first * second)) for first, second in pairs) / max(power, 1e-300)


def fit_result(n: NormalEquations, x: NDArray[Any], trial: NDArray[Any], evidence: float, freedom: float) -> FieldFit:
    """Record of a fit, with its gain in all pixels and in those held out.

    Parameters
    ----------
    n
        Normal equations of the field.
    x
        (band, k) fitted coefficients.
    trial
        (band, k) coefficients of the trial fit.
    evidence
        2 ln of the evidence over that of noise alone.
    freedom
        Effective number of free coefficients.

    Returns
    -------
    FieldFit
        The record; ``heldout`` is 0 where the trial fit gains nothing in its own pixels.
    """
    size = (x[:, None] @ n.a @ x[..., None]).ravel()
    nuisance = np.einsum("bmk,bk->m", n.c, x)
    gain = float(2 * np.sum(x * n.b) - size.sum() + nuisance @ nuisance)
    fitted = _gain_without_nuisances(n.trial_a, n.trial_b, trial)
    held_out_b = n.b - n.trial_b if n.held_out_b is None else n.held_out_b
    other = _gain_without_nuisances(n.a - n.trial_a, held_out_b, trial)
    heldout = other / fitted if fitted > 0 else 0.0
    return FieldFit(x, gain, evidence, heldout, freedom, size)


def _gain_without_nuisances(a: NDArray[Any], b: NDArray[Any], x: NDArray[Any]) -> float:
    return float(2 * np.sum(x * b) - np.sum(x[:, None] @ a @ x[..., None]))
