"""Sizes of the base's flaws in a residual, and whether an effect is needed next to them.

Columns of a kind have one width s of their normal prior, in standard deviations of its tolerance. With D the squared
widths, G the products of the columns and b theirs with the residual r,

    -2 ln(evidence) = r^T r - b^T (D^-1 + G)^-1 b + ln det(1 + D G),

and each width is where the evidence is largest (MacKay, "Bayesian Interpolation", Neural Computation 4(3), 1992),
within the kind's bound. Deviations of single pixels, alike in all bands, whiten columns and residual beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, hstack

from ...predict import PictureErrors, errors_of_cells, sample_blocks, squares_of
from .columns import FlawColumns
from .parts import LEVELS, PLACES, PartAmplitudes, amplitudes_by_part, thirds_by_level

__all__ = ["FittedFlaws", "Flaw", "FlawModel", "build_flaw_model"]

#: Errors that bands and faces share: their width stays as it is.
_SHARED = "shared"

#: Deviations of single pixels, alike in all bands.
_PIXELS = "pixels"

#: Largest width of a kind, in its tolerance: a flaw is small, or it is a cause.
_MAX_WIDTH = 3.0

#: Smallest width, in its tolerance.
_MIN_WIDTH = 0.01

#: Largest relative deviation of single pixels: a flaw is small, or it is a cause.
_MAX_PIXEL_ERROR = 0.005

#: Numerics: rounds of the widths' fit.
_ROUNDS = 12

#: Numerics: rounds of the fit of an effect's numbers and the widths in turn.
_ROUNDS_WITH_EFFECT = 2

#: Side of the blocks of pixels that are held out in turn, px.
_HELDOUT_BLOCK_PX = 8


class Whitening(Protocol):
    """Interface of a capture's linear model, as flaws need it."""

    @property
    def count(self) -> int: ...
    @property
    def used(self) -> NDArray[np.bool_]: ...
    @property
    def patch(self) -> NDArray[np.int64]: ...
    @property
    def sigma(self) -> NDArray[np.float64]: ...
    @property
    def basis(self) -> NDArray[np.float64]: ...
    @property
    def shared_errors(self) -> NDArray[np.float32]: ...
    @property
    def errors(self) -> PictureErrors | None: ...
    def project(self, vector: NDArray[np.float64], /) -> NDArray[np.float64]: ...
    def counting(self, errors: PictureErrors, /) -> Self: ...


W = TypeVar("W", bound=Whitening)


@dataclass(frozen=True, eq=False)
class Flaw:
    """A kind of flaw that a residual shows."""

    #: Kind: creases, edges, shading, slopes, paints, lens, field or pixels.
    kind: str
    #: Chi2 per sample that it makes.
    chi2_per_dof: float
    #: Width of its prior, in tolerances; relative to the signal for pixels.
    width: float
    #: Gain in pixels held out from its fit, over that in the fitted ones.
    heldout: float

    @property
    def of_single_pixels(self) -> bool:
        """Whether single pixels deviate, which no effect of the catalogue imitates."""
        return self.kind == _PIXELS


@dataclass(frozen=True, eq=False)
class FittedFlaws(FrozenMappings):
    """Widths of all kinds that fit a residual."""

    #: By kind, the width.
    width: Mapping[str, float]
    #: -2 ln(evidence) of the residual.
    score: float
    #: (k,) multiples of the columns.
    amount: NDArray[np.float64]
    #: (k, k) covariance of the amounts.
    covariance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FlawModel(Generic[W]):
    """Columns of flaws in a capture's linear model."""

    #: The capture's linear model, single pixels' deviations in its covariance.
    model: W
    #: Relative standard deviation of single pixels, as estimated.
    pixel_error: float
    #: -2 ln(evidence) of the residual without flaws, over that of this model's covariance without columns.
    nothing: float
    #: (k,) kind of each column.
    kind: NDArray[np.str_]
    #: (n, k) columns over sigma, 0 in most samples.
    change: csr_array
    #: (n, k) the same, whitened by single pixels' deviations; not projected.
    columns: csr_array
    #: (band, y, x) predicted signal, DN.
    signal: NDArray[np.float64]
    #: (n,) place that a sample lies in, an index of ``PLACES``.
    sample_place: NDArray[np.int64]

    @cached_property
    def _squares(self) -> NDArray[np.float64]:
        """(k, k) products of the columns."""
        return squares_of(self.columns)

    @cached_property
    def _along(self) -> NDArray[np.float64]:
        """(r, k) products of the nuisances with the columns, which the projection takes off."""
        return np.asarray(self.columns.T @ self.model.basis[: self.model.count]).T

    @cached_property
    def products(self) -> NDArray[np.float64]:
        """(k, k) products of the projected columns."""
        return self._squares - self._along.T @ self._along

    def whitened(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """A residual of the plain model, in this one.

        Parameters
        ----------
        residual
            (..., n + 11) residual of the plain model.

        Returns
        -------
        NDArray
            (..., n + 11) whitened and projected.
        """
        count = self.model.count
        if self.model.errors is None:
            return residual
        pixels = self.model.errors.whitened(residual[..., :count])
        return self.model.project(np.concatenate([pixels, residual[..., count:]], axis=-1))

    @property
    def beyond_flaws(self) -> bool:
        """Whether single pixels deviate by more than flats do that were taken a while ago."""
        return self.pixel_error > _MAX_PIXEL_ERROR

    def _aim(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, ...) products of the projected columns with vectors (n + 11, ...)."""
        onto = self.columns.T @ residual[: self.model.count]
        return np.asarray(onto - self._along.T @ (self.model.basis.T @ residual))

    def _sum(self, amounts: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n + 11, ...) multiples (k, ...) of the projected columns."""
        vectors = -self.model.basis @ (self._along @ amounts)
        vectors[: self.model.count] += self.columns @ amounts
        return np.asarray(vectors)

    def fit(self, residual: NDArray[np.float64]) -> FittedFlaws:
        """Widths at which the evidence of a residual is largest.

        Parameters
        ----------
        residual
            (n + 11,) residual of the whitened model.

        Returns
        -------
        FittedFlaws
            Widths, and the amounts of all columns.
        """
        aim, square = self._aim(residual), float(residual @ residual)
        kinds = [str(kind) for kind in np.unique(self.kind) if kind != _SHARED]
        width = dict.fromkeys(kinds, 0.3) | {_SHARED: 1.0}
        for _ in range(_ROUNDS):
            amount, covariance = self._posterior(width, aim)
            for kind in kinds:
                members = self.kind == kind
                free = members.sum() - np.trace(covariance[np.ix_(members, members)]) / width[kind] ** 2
                fitted = np.sqrt(float(amount[members] @ amount[members]) / max(float(free), 1e-3))
                width[kind] = float(np.clip(fitted, _MIN_WIDTH, _MAX_WIDTH))
        amount, covariance = self._posterior(width, aim)
        return FittedFlaws(width, self._score(width, aim, square), amount, covariance)

    @staticmethod
    def amounts(weighted: NDArray, columns: NDArray, residual: NDArray) -> NDArray[np.float64]:
        """Multiples of columns in a residual, by generalised least squares.

        Parameters
        ----------
        weighted
            (n + 11, p) columns times the inverse covariance.
        columns
            (n + 11, p) changes by a unit of each amount.
        residual
            (n + 11,) residual.

        Returns
        -------
        NDArray
            (p,) multiples.
        """
        return np.asarray(np.linalg.lstsq(weighted.T @ columns, weighted.T @ residual, rcond=1e-9)[0])

    def fit_with(
        self, columns: NDArray[np.float64], residual: NDArray[np.float64], start: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], FittedFlaws]:
        """Multiples of an effect's columns and widths of the flaws, fitted in turn.

        Parameters
        ----------
        columns
            (n + 11, p) whitened changes by the effect's numbers.
        residual
            (n + 11,) residual of the whitened model, without the effect.
        start
            (p,) multiples from which the widths are fitted first.

        Returns
        -------
        NDArray
            (p,) multiples.
        FittedFlaws
            Widths, and the amounts of all flaws.
        """
        amount, fitted = start, self.fit(residual - columns @ start)
        for _ in range(_ROUNDS_WITH_EFFECT):
            amount = self.amounts(self.weighted(fitted, columns), columns, residual)
            fitted = self.fit(residual - columns @ amount)
        return amount, fitted

    def without(self, fitted: FittedFlaws) -> FittedFlaws:
        """The same with all flaws but shared errors as small as possible.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.

        Returns
        -------
        FittedFlaws
            With the smallest widths; score and amounts are the old ones.
        """
        width = {kind: size if kind == _SHARED else _MIN_WIDTH for kind, size in fitted.width.items()}
        return replace(fitted, width=width)

    def score(self, fitted: FittedFlaws, residual: NDArray[np.float64]) -> float:
        """-2 ln(evidence) of a residual with the widths of a fit.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.
        residual
            (n + 11,) residual of the whitened model.

        Returns
        -------
        float
            The score; the smaller, the better.
        """
        return self._score(fitted.width, self._aim(residual), float(residual @ residual))

    def _prior(self, width: Mapping[str, float]) -> NDArray[np.float64]:
        return np.array([width[str(kind)] for kind in self.kind])

    def _posterior(
        self, width: Mapping[str, float], aim: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        covariance = np.asarray(np.linalg.inv(self.products + np.diag(1 / self._prior(width) ** 2)), float)
        return covariance @ aim, covariance

    def _score(self, width: Mapping[str, float], aim: NDArray[np.float64], square: float) -> float:
        prior = self._prior(width)
        inside = np.eye(len(prior)) + prior[:, None] * self.products * prior
        volume = np.linalg.slogdet(inside)[1]
        return float(square - (prior * aim) @ np.linalg.solve(inside, prior * aim) + volume)

    def weighted(self, fitted: FittedFlaws, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns times the inverse covariance by noise and flaws.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.
        columns
            (n + 11, p) whitened columns.

        Returns
        -------
        NDArray
            (n + 11, p) weighted columns.
        """
        return columns - self._sum(fitted.covariance @ self._aim(columns))

    def part(self, fitted: FittedFlaws, kind: str = "") -> NDArray[np.float64]:
        """Change by the fitted flaws of one kind, or of all but shared errors.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.
        kind
            The kind; empty for all.

        Returns
        -------
        NDArray
            (n + 11,) in the whitened model.
        """
        members = self._of_kind(kind) if kind else self.kind != _SHARED
        return self._sum(np.where(members, fitted.amount, 0.0))

    def amplitudes_by_part(
        self, fitted: FittedFlaws, shape: NDArray[np.float64], residual: NDArray[np.float64]
    ) -> PartAmplitudes:
        """Amplitudes of an effect in disjoint parts of its pattern, next to the flaws.

        Parameters
        ----------
        fitted
            Widths and amounts of the flaws next to the effect.
        shape
            (n + 11,) change by the effect in the whitened model.
        residual
            (n + 11,) residual without it.

        Returns
        -------
        PartAmplitudes
            By place or by level of the signal, whichever differ more.
        """
        model, pixels = self.model, shape[: self.model.count]
        band = np.broadcast_to(np.arange(len(model.used))[:, None, None], model.used.shape)[model.used]
        level = thirds_by_level(self.signal[model.used], band, pixels)
        flaws, ways = self.part(fitted) + self.part(fitted, _SHARED), list[PartAmplitudes]()
        for names, part in ((PLACES, self.sample_place), (LEVELS, level)):
            columns = np.zeros((len(shape), len(names)))
            columns[np.arange(model.count), part] = pixels
            columns = model.project(columns.T).T
            weigh = partial(self.weighted, fitted)
            ways.append(amplitudes_by_part(names, columns, part, model.patch, weigh, residual, flaws))
        return max(ways, key=lambda way: way.lead)

    def _of_kind(self, kind: str) -> NDArray[np.bool_]:
        """(k,) columns of a kind, in all its forms."""
        return np.array([str(each).partition(":")[0] == kind for each in self.kind])

    def kind_dn(self, fitted: FittedFlaws, kind: str) -> NDArray[np.float64]:
        """Change of the used samples by the flaws of one kind, in all its forms.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.
        kind
            The kind, as of `Flaw`.

        Returns
        -------
        NDArray
            (n,) DN.
        """
        return np.asarray(self.model.sigma * (self.change @ np.where(self._of_kind(kind), fitted.amount, 0.0)))

    def change_dn(self, fitted: FittedFlaws, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change of the used samples by all fitted flaws, single pixels included.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.
        residual
            (n + 11,) residual of the plain model.

        Returns
        -------
        NDArray
            (n,) DN.
        """
        flaws = self.change @ np.where(self.kind != _SHARED, fitted.amount, 0.0)
        if self.model.errors is not None:
            flaws += self.model.errors.of_cells(residual[: self.model.count] - self.change @ fitted.amount)
        return np.asarray(self.model.sigma * flaws)

    def counted_in(self, plain: W, fitted: FittedFlaws) -> W:
        """A linear model with the flaws in its covariance.

        Parameters
        ----------
        plain
            The model without errors in its covariance.
        fitted
            Fitted widths and amounts.

        Returns
        -------
        LinearModel
            Shared errors are counted as well.
        """
        cells = _pixel_errors(plain, self.signal, self.pixel_error)
        return plain.counting(cells.with_columns(self.columns, self._prior(fitted.width), self._squares))

    def errors_of(self, fitted: FittedFlaws) -> csr_array:
        """Flaws, and errors that bands and faces share, as errors that many samples share.

        Single pixels are left out.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.

        Returns
        -------
        csr_array
            (n, k) over sigma, one standard deviation each.
        """
        width = self._prior(fitted.width).astype(np.float32)[self.change.indices]
        return csr_array((self.change.data * width, self.change.indices, self.change.indptr), self.change.shape)

    def flaws(self, fitted: FittedFlaws, residual: NDArray[np.float64]) -> list[Flaw]:
        """Size of every kind in a residual.

        Parameters
        ----------
        fitted
            Fitted widths and amounts.
        residual
            (n + 11,) residual of the whitened model.

        Returns
        -------
        list of Flaw
            The largest first.
        """
        count, flaws = self.model.count, []
        for kind in dict.fromkeys(str(each).partition(":")[0] for each in self.kind):
            if kind == _SHARED:
                continue
            part, members = self.part(fitted, kind), self._of_kind(kind)
            width = float(self._prior(fitted.width)[members].max())
            flaws.append(Flaw(kind, float(part @ part) / count, width, self._heldout(fitted, residual, kind)))
        if self.pixel_error > 0 and self.model.errors is not None:
            cells = self.model.errors
            weight = float(cells.weight @ cells.weight)
            flaws.append(Flaw(_PIXELS, weight / count, min(self.pixel_error, _MAX_PIXEL_ERROR), 1.0))
        return sorted(flaws, key=lambda flaw: -flaw.chi2_per_dof)

    def _heldout(self, fitted: FittedFlaws, residual: NDArray[np.float64], kind: str) -> float:
        """Gain of a kind in blocks held out over that in the fitted ones, all others in place."""
        members, count = self._of_kind(kind), self.model.count
        rest = (residual - self.part(fitted) + self.part(fitted, kind))[:count]
        v, u = np.indices(self.model.used.shape[1:])
        board = (v // _HELDOUT_BLOCK_PX + u // _HELDOUT_BLOCK_PX) % 2
        colour, number = np.broadcast_to(board, self.model.used.shape)[self.model.used], int(members.sum())
        products, aims, basis = np.zeros((2, number, number)), np.zeros((2, number)), self.model.basis[:count]
        for rows in sample_blocks(count):
            projected = self.columns[rows][:, members].toarray() - basis[rows] @ self._along[:, members]
            for part in (0, 1):
                some = projected[colour[rows] == part]
                products[part] += some.T @ some
                aims[part] += some.T @ rest[rows][colour[rows] == part]
        ridge = np.diag(1 / self._prior(fitted.width)[members] ** 2)
        gains = np.zeros(2)
        for inside in (0, 1):
            amount = np.linalg.solve(products[inside] + ridge, aims[inside])
            for index, part in enumerate((inside, 1 - inside)):
                gains[index] += float(2 * amount @ aims[part] - amount @ products[part] @ amount)
        return float(gains[1] / max(gains[0], 1e-30))


def build_flaw_model(
    model: W, flaws: FlawColumns, signal: NDArray[np.float64], residual: NDArray[np.float64]
) -> FlawModel[W]:
    """Columns of flaws in a linear model, deviations of single pixels estimated and whitened.

    Parameters
    ----------
    model
        Linear model of the capture, without errors in its covariance.
    flaws
        Columns of the flaws.
    signal
        (band, y, x) predicted signal, DN.
    residual
        (n + 11,) residual with the effects that are in question.

    Returns
    -------
    FlawModel
        In the covariance with single pixels' deviations.
    """
    shared = csc_array(model.shared_errors[: model.count])
    change = hstack([flaws.change, shared], format="csc").tocsr()
    kind = np.append(flaws.kind, np.full(shared.shape[1], _SHARED))
    plain = FlawModel(model, 0.0, 0.0, kind, change, change, signal, flaws.sample_place)
    fitted = plain.fit(residual)
    nothing = plain.score(plain.without(fitted), residual)
    remaining = residual - plain.part(fitted) - plain.part(fitted, _SHARED)
    error = _pixel_error(model, signal, remaining)
    if error == 0:
        return replace(plain, nothing=nothing)
    cells = _pixel_errors(model, signal, error)
    return replace(
        plain,
        model=model.counting(cells),
        pixel_error=error,
        nothing=nothing - cells.volume_of_cells,
        columns=cells.by_cells(change),
    )


def _pixel_index(model: Whitening) -> NDArray[np.int64]:
    """(n,) pixel of each used sample."""
    return np.broadcast_to(np.arange(model.used[0].size).reshape(model.used[0].shape), model.used.shape)[model.used]


def _pixel_error(model: Whitening, signal: NDArray[np.float64], residual: NDArray[np.float64]) -> float:
    """Relative deviation of single pixels alike in all bands, less that of neighbours."""
    level = signal[model.used] / model.sigma
    pixel, size = _pixel_index(model), model.used[0].size
    r = residual[: model.count]
    weight = np.bincount(pixel, level**2, size)
    each = np.bincount(pixel, level * r, size)
    alone = np.bincount(pixel, (level * r) ** 2, size)
    fourth = np.bincount(pixel, level**4, size)
    common = float(np.sum(each**2 - alone)) / max(float(np.sum(weight**2 - fourth)), 1e-300)
    shape = model.used.shape[1:]
    e, w = each.reshape(shape), weight.reshape(shape)
    shared = sum(float(np.sum(a * b)) for a, b in ((e[1:], e[:-1]), (e[:, 1:], e[:, :-1])))
    weights = sum(float(np.sum(a * b)) for a, b in ((w[1:], w[:-1]), (w[:, 1:], w[:, :-1])))
    return float(np.sqrt(max(common - max(shared / max(weights, 1e-300), 0.0), 0.0)))


def _pixel_errors(model: Whitening, signal: NDArray[np.float64], error: float) -> PictureErrors:
    """Deviations of single pixels as a covariance."""
    cell = np.unique(_pixel_index(model), return_inverse=True)[1].reshape(-1)
    weight = min(error, _MAX_PIXEL_ERROR) * signal[model.used] / model.sigma
    return errors_of_cells(cell, weight)
