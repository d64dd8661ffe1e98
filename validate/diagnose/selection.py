"""Search among the catalogue's effects: best single ones and sets, elimination, replacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from .evidence import beyond_tolerance, largest_gain_of_errors, least_gain, penalised, price_of, square
from .fitting import fit
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, Problem, Signature, column_batches, screen

__all__ = ["NUM_FITTED", "NormalEquations", "backward_elimination", "best_set", "best_singles", "pairs_replaced"]

#: Number of effects in a role that are fitted in full, best to first order first: further ones, and replacements.
NUM_FITTED = 3

#: Minimum first-order gain of a candidate to be fitted in full, over the gain of the best fitted one, or over the gain
#: that any effect needs: a full fit is taken to gain at most 2.5 times as much.
_MIN_PROMISED_PART = 0.4

#: Number of sets of each size that are extended by one more effect, the best ones.
_MAX_EXTENDED_SETS = 100

#: Numerics: share of the identity added to the products of unit columns: effects that are alike get no huge numbers.
_RIDGE = 1e-6


def best_singles(
    problem: Problem,
    signatures: Sequence[Signature],
    residual: NDArray,
    refined: int,
    rival_chi2: float = np.inf,
    least: float = 0.0,
    progress: Progress = NO_PROGRESS,
) -> list[Candidate]:
    """The best hypothesis of every effect, best first; the first ones fitted in full.

    Not fitted are candidates that gain much less to first order than the best fit so far, or than `least`. Nor are
    candidates whose numbers are within their tolerances, which are no finding; as rivals of a fit they are fitted.

    Parameters
    ----------
    problem
        The capture with the effects already in its model.
    signatures
        Signatures of the hypotheses.
    residual
        (n + 11,) residual with the effects already in the model.
    refined
        Number of effects to fit in full at most.
    rival_chi2
        Chi2 of a fit with which these effects compete; infinite for none.
    least
        Chi2 that any effect must gain.
    progress
        Reports the completed share.

    Returns
    -------
    list of Candidate
        One per effect, by chi2 with the price of its numbers.
    """
    best_by_effect: dict[str, Candidate] = {}
    residual = problem.model.project(residual)
    for index, candidate in enumerate(screen(problem, signatures, residual), 1):
        progress.part(0.5 * index / len(signatures))
        rival = best_by_effect.setdefault(candidate.hypothesis.effect.id, candidate)
        if penalised(candidate) < penalised(rival):
            best_by_effect[rival.hypothesis.effect.id] = candidate
    ranked = sorted(best_by_effect.values(), key=penalised)
    start = square(residual)
    fitted_chi2: list[float] = []
    for index, candidate in enumerate(ranked[:refined]):
        lowest = min(fitted_chi2, default=rival_chi2)
        rival_gain = start - lowest if np.isfinite(lowest) else 0.0
        needed = _MIN_PROMISED_PART * max(rival_gain, least)
        if start - candidate.chi2 < needed:
            break
        if np.isfinite(rival_chi2) or beyond_tolerance(candidate):
            ranked[index] = fit(problem, candidate, residual, lowest)
            fitted_chi2.append(ranked[index].chi2)
        progress.part(0.5 + 0.5 * (index + 1) / refined)
    return sorted(ranked, key=penalised)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of all signatures together, to first order, in unit columns."""

    #: (column,) index of the signature that a column belongs to.
    owner: NDArray[np.int64]
    #: (column, column) products of unit columns, with a small ridge.
    products: NDArray[np.float32]
    #: (column,) products of unit columns with the residual, minus half the slope by averaged noise.
    aim: NDArray[np.float64]
    #: (column,) norms of the columns before scaling.
    size: NDArray[np.float64]
    #: (column,) lowest multiples of unit columns, by the numbers' bounds.
    low: NDArray[np.float64]
    #: (column,) highest multiples.
    high: NDArray[np.float64]

    @classmethod
    def of(cls, problem: Problem, signatures: Sequence[Signature], residual: NDArray) -> NormalEquations:
        """Normal equations of signatures for a residual.

        Parameters
        ----------
        problem
            The capture with the effects already in its model.
        signatures
            Signatures with free numbers, see `screen` for their columns.
        residual
            (n + 11,) residual over sigma.

        Returns
        -------
        NormalEquations
            With columns in single precision.
        """
        owner = np.repeat(np.arange(len(signatures)), [len(signature.steps) for signature in signatures])
        columns, size, aim = np.empty((len(residual), len(owner)), np.float32), *np.empty((2, len(owner)))
        projected = problem.model.project(residual)
        start = 0
        for _, changes in column_batches(problem, signatures):
            some = slice(start, start := start + len(changes))
            size[some] = np.maximum(np.linalg.norm(changes, axis=1), 1e-30)
            changes /= size[some, None]
            aim[some], columns[:, some] = changes @ projected, changes.T
        slope = [problem.noise_averaging_gain(effect) for signature in signatures for effect in signature.stepped]
        low, high = size * np.concatenate([signature.bounds for signature in signatures]).T
        return cls(
            owner,
            columns.T @ columns + _RIDGE * np.eye(len(size), dtype=np.float32),
            aim - np.array(slope) / size / 2,
            size,
            low,
            high,
        )

    def solve(self, members: Sequence[int]) -> tuple[float, NDArray[np.float64]]:
        """Chi2 that several signatures gain together, and the multiples of their steps.

        Parameters
        ----------
        members
            Indices of the signatures.

        Returns
        -------
        gain : float
            Chi2; -inf where a number leaves its bounds.
        amplitude : NDArray
            (number,) multiples of the steps, in the order of the columns.
        """
        columns = np.flatnonzero(np.isin(self.owner, members))
        amplitude = np.linalg.solve(self.products[np.ix_(columns, columns)], self.aim[columns])
        inside = np.all((self.low[columns] <= amplitude) & (amplitude <= self.high[columns]))
        return float(self.aim[columns] @ amplitude) if inside else -np.inf, amplitude / self.size[columns]


def best_set(problem: Problem, signatures: Sequence[Signature], residual: NDArray, most: int) -> list[Candidate]:
    """The effects that together explain most chi2 to first order, each number at its price.

    Of all pairs the best ones are tried with every further effect. Effects that the priors judge, or that have no free
    number, take no part.

    Parameters
    ----------
    problem
        The capture with the effects already in its model.
    signatures
        Signatures of the hypotheses.
    residual
        (n + 11,) residual over sigma.
    most
        Largest number of effects in the set; the smallest is two.

    Returns
    -------
    list of Candidate
        Each one's `chi2` is that of all together. Empty where no set keeps its numbers within their bounds.
    """
    usable = [signature for signature in signatures if signature.changes is not None and signature.hypothesis.free]
    if len(usable) < 2:
        return []
    equations = NormalEquations.of(problem, usable, residual)
    effects = [signature.hypothesis.effect.id for signature in usable]

    def priced_gain(members: Sequence[int]) -> float:
        gain, steps = equations.solve(members)
        return gain - price_of(len(steps))

    best: tuple[float, tuple[int, ...]] = (0.0, ())
    extended: list[tuple[int, ...]] = [(index,) for index in range(len(usable))]
    for _ in range(most - 1):
        larger = {
            tuple(sorted((*members, more)))
            for members in extended
            for more, effect in enumerate(effects)
            if effect not in {effects[m] for m in members}
        }
        ranked = sorted(((priced_gain(members), members) for members in larger), reverse=True)
        best, extended = max([best, *ranked]), [members for _, members in ranked[:_MAX_EXTENDED_SETS]]
    if not best[1]:
        return []
    gain, steps = equations.solve(best[1])
    chi2 = square(problem.model.project(residual)) - gain
    best_signatures = [usable[m] for m in best[1]]
    amplitudes = np.split(steps, np.cumsum([len(signature.steps) for signature in best_signatures])[:-1])
    return [
        Candidate(signature.hypothesis, signature.numbers(amplitude), {}, chi2, np.zeros(0, np.float32))
        for signature, amplitude in zip(best_signatures, amplitudes, strict=True)
    ]


def backward_elimination(linearised: LinearisedFit, selected: Sequence[Candidate]) -> list[Candidate]:
    """Drop effects whose loss costs less chi2 than an effect must gain, least needed first.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Effects fitted together.

    Returns
    -------
    list of Candidate
        The effects that remain, at least one, fitted together. One that the priors judge ends the elimination.
    """
    current = list(selected)
    while len(current) > 1:
        full = residual_with(linearised, current)
        costs = []
        for index, candidate in enumerate(current):
            rest = refitted_together(linearised, [c for c in current if c is not candidate])
            remainder = residual_with(linearised, rest)
            costs.append((square(remainder) - square(full), index, rest))
        cost, index, rest = min(costs, key=lambda item: item[0])
        least = least_gain(current[index], linearised.model)
        if cost > least or current[index].by_priors:
            break
        current = rest
    return current


def pairs_replaced(
    linearised: LinearisedFit, selected: Sequence[Candidate], signatures: Sequence[Signature]
) -> list[Candidate]:
    """Replace two of three effects by one that fits as well.

    Two effects together may imitate one, and the first of them was selected while the others were missing. Effects that
    the priors judge gain too little chi2 to be compared so: with one of them nothing is replaced.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Effects fitted together.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    list of Candidate
        The effects, or two of them fitted together.
    """
    if len(selected) < 3 or any(c.by_priors for c in selected):
        return list(selected)
    together = residual_with(linearised, selected)
    limit = square(together) + largest_gain_of_errors(linearised.model)
    best = list(selected)
    for candidate in selected:
        rest = [s for s in signatures if s.hypothesis.effect.id != candidate.hypothesis.effect.id]
        alternatives = best_singles(
            linearised.problem([candidate]), rest, residual_with(linearised, [candidate]), NUM_FITTED
        )
        trial = refitted_together(linearised, [candidate, alternatives[0]])
        remainder = residual_with(linearised, trial)
        if square(remainder) < limit:
            best, limit = trial, square(remainder)
    return best
