"""Linear fields and their fits: normal equations by band, the scale of the prior from the data, evidence.

A field is a number of images Phi_k that some operator turns into changes of the picture. Coefficients a have a normal
prior of width tau; images are scaled so that one width serves all. With H the information about a after camera, lamp
and shared errors were adjusted, and b the projection of the residual,

    2 ln(evidence) = tau^2 b^T (1 + tau^2 H)^-1 b - ln det(1 + tau^2 H)

(Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, section 5.4); tau is where it is largest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .excess import Excess

__all__ = [
    "FieldFit",
    "Normal",
    "beside_common",
    "each_band",
    "finished",
    "fixed_spectrum",
    "free_spectrum",
    "normal",
    "solved",
    "trial",
]

_WIDTHS = np.logspace(-8, 6, 57)

#: Relative eigenvalue of the information below which a combination of coefficients is not seen.
_UNSEEN = 1e-7

#: The same below which a number is rounding.
_ROUNDING = 1e-13

#: Part of a nuisance that a field may leave at the least: below it products of single precision tell nothing.
_LEAST_LEFT = 1e-5

#: Pixels whose columns are taken in double precision at once.
_TOGETHER = 2**15

#: Rounds of the alternating fit of map and spectrum.
_ROUNDS = 6

#: Change of the largest number of a spectrum's, of itself, below which that fit ends: evidence changes by its square.
_CONVERGED = 1e-3


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of a field in each band. a : (band, k, k). b : (band, k). c : (band, m, k) with nuisances.

    own_a, own_b : a and b of the pixels that trial fits see. images : (k, y, x) Phi, or what stands for it.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    own_a: NDArray[np.float64]
    own_b: NDArray[np.float64]


def normal(excess: Excess, columns: NDArray[Any] | csr_matrix, band: int) -> tuple[NDArray[np.float64], ...]:
    """The parts a, b, c, own_a, own_b of the equations of columns (k, pixel), DN, in one band."""
    pixels = excess.used[band].size
    if isinstance(columns, csr_matrix):
        return _normal_of(excess, columns, band, slice(0, pixels))
    several = (
        _normal_of(excess, columns[:, start : start + _TOGETHER], band, slice(start, start + _TOGETHER))
        for start in range(0, pixels, _TOGETHER)
    )
    return tuple(sum(part) for part in zip(*several, strict=True))


def _normal_of(
    excess: Excess, columns: NDArray[Any] | csr_matrix, band: int, pixels: slice
) -> tuple[NDArray[np.float64], ...]:
    """What some pixels add to the parts of ``normal``."""
    weight = excess.weight[band].ravel()[pixels]
    residual = excess.weighed[band].ravel()[pixels]
    if isinstance(columns, csr_matrix):
        whitened = columns.multiply(weight[None, :]).tocsr()
    else:
        whitened = columns.astype(np.float64) * weight
    own = np.flatnonzero(~excess.half.ravel()[pixels])
    seen = whitened[:, own]
    nuisances = excess.nuisances[band].reshape(excess.used[band].size, -1)[pixels]
    parts = (
        whitened @ whitened.T,
        whitened @ residual,
        (whitened @ nuisances).T,
        seen @ seen.T,
        seen @ residual[own],
    )
    return tuple(np.asarray(p.toarray() if isinstance(p, csr_matrix) else p, np.float64) for p in parts)


@dataclass(frozen=True, eq=False)
class FieldFit:
    """coefficients : (band, k). gain : chi2 that it lowers. evidence : 2 ln of it over that of noise alone.

    heldout : gain in pixels that the trial fit did not see over that in those it saw. freedom : effective number of
    free coefficients. size : (band,) square of the change over sigma in each band.
    """

    coefficients: NDArray[np.float64]
    gain: float
    evidence: float
    heldout: float
    freedom: float
    size: NDArray[np.float64]


def solved(h: NDArray[Any], b: NDArray[Any]) -> tuple[NDArray[Any], float, float, float]:
    """Coefficients, 2 ln evidence, effective number, and the width of the prior where the evidence is largest."""
    mu, v = np.linalg.eigh((h + h.T) / 2)
    seen = mu > _UNSEEN * mu.max(initial=0.0)
    mu, v = mu[seen], v[:, seen]
    square = (v.T @ b) ** 2
    scale = 1 / max(float(mu.max(initial=0.0)), 1e-300)
    widths = _WIDTHS * scale
    inside = 1 + widths[:, None] * mu
    values = (widths[:, None] * square / inside - np.log(inside)).sum(axis=1)
    best = int(np.argmax(values))
    t = widths[best]
    x = v @ (t * (v.T @ b) / (1 + t * mu))
    return x, float(values[best]), float((t * mu / (1 + t * mu)).sum()), float(t)


def trial(a: NDArray[Any], b: NDArray[Any], width: float) -> NDArray[Any]:
    """Coefficients by the pixels that a trial fit sees, under a prior of known width. a, b : of these, no nuisances.

    The prior keeps a field that these do not see from being singular, and rounding where it is too wide for that.
    """
    return np.linalg.solve(a + (1 / width + _ROUNDING * np.trace(a)) * np.eye(len(a)), b)


def _gain(h: NDArray[Any], b: NDArray[Any], x: NDArray[Any]) -> float:
    return float(2 * x @ b - x @ h @ x)


def fixed_spectrum(n: Normal, spectrum: NDArray[Any]) -> FieldFit:
    """One map for all bands, times a known number for each."""
    s = np.asarray(spectrum, float)
    h, b = _combined(n.a, n.c, s), s @ n.b
    x, evidence, freedom, width = solved(h, b)
    coefficients = s[:, None] * x
    seen = trial(np.einsum("b,bjk->jk", s**2, n.own_a), s @ n.own_b, width)
    return finished(n, coefficients, s[:, None] * seen, evidence, freedom)


def _combined(a: NDArray[Any], c: NDArray[Any], s: NDArray[Any]) -> NDArray[Any]:
    with_nuisances = np.einsum("b,bmk->mk", s, c)
    return np.einsum("b,bjk->jk", s**2, a) - with_nuisances.T @ with_nuisances


def each_band(n: Normal) -> FieldFit:
    """A map of its own in every band, each with a width of its own; nuisances bind the bands together."""
    widths, trials = [], []
    for a, b, c, own_a, own_b in zip(n.a, n.b, n.c, n.own_a, n.own_b, strict=True):
        *_, width = solved(a - c.T @ c, b)
        widths.append(width)
        trials.append(trial(own_a, own_b, width))
    inner = np.array([np.linalg.inv(a + np.eye(len(a)) / t) for a, t in zip(n.a, widths, strict=True)])
    alone = np.einsum("bjk,bk->bj", inner, n.b)
    passed = n.c @ inner
    coupling = np.eye(n.c.shape[1]) - np.tensordot(passed, n.c, axes=((0, 2), (0, 2)))
    values, vectors = np.linalg.eigh(coupling)
    values = np.maximum(values, _LEAST_LEFT)
    nuisance = vectors @ ((vectors.T @ np.einsum("bmk,bk->m", n.c, alone)) / values)
    x = alone + nuisance @ passed
    volume = sum(np.linalg.slogdet(np.eye(len(a)) + t * a)[1] for a, t in zip(n.a, widths, strict=True))
    evidence = float(np.sum(x * n.b) - volume - np.log(values).sum())
    freedom = sum(len(a) - np.trace(i) / t for a, i, t in zip(n.a, inner, widths, strict=True))
    return finished(n, x, np.array(trials), evidence, float(freedom))


def beside_common(n: Normal) -> Normal:
    """The same field where another one like it, alike in all bands, is one more nuisance, at its best beside no other.

    Its prior is as wide as makes the evidence of it alone largest.
    """
    with_nuisances = n.c.sum(axis=0)
    h, b = n.a.sum(axis=0) - with_nuisances.T @ with_nuisances, n.b.sum(axis=0)
    common, *_, width = solved(h, b)
    cross = n.a - with_nuisances.T @ n.c
    values, vectors = np.linalg.eigh((h + h.T) / 2)
    whitened = (vectors / np.sqrt(np.maximum(values, 0.0) + 1 / width)).T @ cross
    nuisances = np.concatenate([n.c, whitened], axis=1)
    return Normal(n.a, n.b - common @ cross, nuisances, n.own_a, n.own_b - n.own_a @ common)


def free_spectrum(n: Normal) -> FieldFit:
    """One map for all bands, times a free number for each: fitted in turn, from the maps of single bands and from one
    map for all."""
    alone = each_band(n).coefficients
    u, _, _ = np.linalg.svd(alone * np.sqrt(np.einsum("bkk->k", n.a)), full_matrices=False)
    return max((_in_turn(n, start) for start in (u[:, 0], np.ones(len(u)))), key=lambda fit: fit.evidence)


def _in_turn(n: Normal, start: NDArray[Any]) -> FieldFit:
    s = np.asarray(start, float) / np.abs(start).max()
    for _ in range(_ROUNDS):
        x, evidence, freedom, width = solved(_combined(n.a, n.c, s), s @ n.b)
        nuisance = n.c @ x
        h = np.diag(n.a @ x @ x) - nuisance @ nuisance.T
        s = np.linalg.lstsq(h, n.b @ x, rcond=1e-9)[0]
        largest = np.abs(s).max()
        if not largest > 0:
            break
        before, s = s, s / largest
        if np.abs(s - before).max() < _CONVERGED:
            break
    x, evidence, freedom, width = solved(_combined(n.a, n.c, s), s @ n.b)
    seen = trial(np.einsum("b,bjk->jk", s**2, n.own_a), s @ n.own_b, width)
    free = len(s) - 1
    penalty = free * np.log(max(_gain(_combined(n.a, n.c, s), s @ n.b, x), 2.0))
    return finished(n, s[:, None] * x, s[:, None] * seen, evidence - penalty, freedom + free)


def finished(n: Normal, x: NDArray[Any], seen: NDArray[Any], evidence: float, freedom: float) -> FieldFit:
    """A fit of coefficients x (band, k); seen : those by the pixels that the trial fit sees."""
    size = (x[:, None] @ n.a @ x[..., None]).ravel()
    nuisance = np.einsum("bmk,bk->m", n.c, x)
    gain = float(2 * np.sum(x * n.b) - size.sum() + nuisance @ nuisance)
    own = _plain(n.own_a, n.own_b, seen)
    other = _plain(n.a - n.own_a, n.b - n.own_b, seen)
    heldout = other / own if own > 0 else 0.0
    return FieldFit(x, gain, evidence, heldout, freedom, size)


def _plain(a: NDArray[Any], b: NDArray[Any], x: NDArray[Any]) -> float:
    return float(2 * np.sum(x * b) - np.sum(x[:, None] @ a @ x[..., None]))
