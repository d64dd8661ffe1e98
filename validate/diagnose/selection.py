"""Search among the catalogue's effects: the best single ones and sets, backward elimination, pairs replaced by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from .evidence import beyond_tolerance, largest_gain_of_errors, least_gain, penalised, price_of, square
from .fitting import fit
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, Problem, Signature, columns_of, screen

__all__ = ["NormalEquations", "backward_elimination", "best_set", "best_singles", "pairs_replaced"]

#: So many of the effects that could replace two others are fitted in full.
_MOST_FITTED = 3

#: Fewer effects than these are not tried with two of them replaced: every single one has been compared by then.
_REPLACED_FROM = 3

#: A candidate is not fitted in full whose first-order gain is below the first part of the best fitted one's, or below
#: the second part of what any effect must gain: one as small as that is nearly linear.
_LEAST_PROMISING, _LEAST_PROMISING_ALONE = 0.4, 0.6

#: So many sets of each size are extended by one more effect.
_MOST_EXTENDED = 100

#: Part of the identity that is added to the products of unit columns: effects that are alike get no huge numbers.
_RIDGE = 1e-6


def best_singles(
    problem: Problem,
    signatures: Sequence[Signature],
    residual: NDArray,
    refined: int,
    known: float = np.inf,
    least: float = 0.0,
    progress: Progress = NO_PROGRESS,
) -> list[Candidate]:
    """The best hypothesis of every effect, best first; the first ``refined`` of them fitted in full.

    Those that gain much less to first order than the best known fit, or than ``least``, are not fitted. Nor are those
    whose numbers are within their tolerances, which are no finding, but beside a known fit they are its rivals. known :
    chi2 of a fit that is known already.
    """
    best: dict[str, Candidate] = {}
    residual = problem.model.project(residual)
    for index, one in enumerate(signatures, 1):
        candidate = screen(problem, one, residual)
        progress.part(0.5 * index / len(signatures))
        rival = best.setdefault(candidate.hypothesis.effect.id, candidate)
        if penalised(candidate) < penalised(rival):
            best[rival.hypothesis.effect.id] = candidate
    ranked = sorted(best.values(), key=penalised)
    start = square(residual)
    done: list[float] = []
    for index, candidate in enumerate(ranked[:refined]):
        lowest = min(done, default=known)
        beside_others = start - lowest if np.isfinite(lowest) else 0.0
        needed = max(_LEAST_PROMISING * beside_others, _LEAST_PROMISING_ALONE * least)
        if start - candidate.chi2 < needed:
            break
        if np.isfinite(known) or beyond_tolerance(candidate):
            ranked[index] = fit(problem, candidate, residual, lowest)
            done.append(ranked[index].chi2)
        progress.part(0.5 + 0.5 * (index + 1) / refined)
    return sorted(ranked, key=penalised)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Of all signatures together, to first order. owner : (column,) which of the signatures it belongs to.

    products : (column, column) of unit columns. aim : (column,) their products with the residual. size : (column,)
    norms. low, high : (column,) bounds of the multiples of unit columns.
    """

    owner: NDArray[np.int64]
    products: NDArray[np.float32]
    aim: NDArray[np.float64]
    size: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @classmethod
    def of(cls, problem: Problem, signatures: Sequence[Signature], residual: NDArray) -> NormalEquations:
        """See ``screen`` for the columns."""
        owner = np.repeat(np.arange(len(signatures)), [len(one.steps) for one in signatures])
        columns, size, aim = np.empty((len(residual), len(owner)), np.float32), *np.empty((2, len(owner)))
        projected = problem.model.project(residual)
        for index, one in enumerate(signatures):
            mine, changes = owner == index, columns_of(problem, one)
            size[mine] = np.maximum(np.linalg.norm(changes, axis=0), 1e-30)
            changes /= size[mine]
            aim[mine], columns[:, mine] = projected @ changes, changes
        slope = [problem.noise_averaging_gain(effect) for one in signatures for effect in one.stepped]
        low, high = size * np.concatenate([one.bounds for one in signatures]).T
        return cls(
            owner,
            columns.T @ columns + _RIDGE * np.eye(len(size), dtype=np.float32),
            aim - np.array(slope) / size / 2,
            size,
            low,
            high,
        )

    def solved(self, members: Sequence[int]) -> tuple[float, NDArray[np.float64]]:
        """The chi2 that signatures gain together, -inf where a number leaves its bounds, and the multiples of their
        steps."""
        own = np.flatnonzero(np.isin(self.owner, members))
        amplitude = np.linalg.solve(self.products[np.ix_(own, own)], self.aim[own])
        inside = np.all((self.low[own] <= amplitude) & (amplitude <= self.high[own]))
        return float(self.aim[own] @ amplitude) if inside else -np.inf, amplitude / self.size[own]


def best_set(problem: Problem, signatures: Sequence[Signature], residual: NDArray, most: int) -> list[Candidate]:
    """The two to ``most`` effects that together explain most chi2 to first order, each number at its price; each one's
    ``chi2`` is that of all together. Empty where no set keeps its numbers within their bounds.

    Of all pairs the best ones are tried with every further effect. Effects that the priors judge, or that have no free
    number, take no part.
    """
    able = [one for one in signatures if one.changes is not None and one.hypothesis.free]
    if len(able) < 2:
        return []
    equations = NormalEquations.of(problem, able, residual)
    effects = [one.hypothesis.effect.id for one in able]

    def worth(members: Sequence[int]) -> float:
        gain, steps = equations.solved(members)
        return gain - price_of(len(steps))

    best: tuple[float, tuple[int, ...]] = (0.0, ())
    extended: list[tuple[int, ...]] = [(index,) for index in range(len(able))]
    for _ in range(most - 1):
        larger = {
            tuple(sorted((*members, more)))
            for members in extended
            for more, effect in enumerate(effects)
            if effect not in {effects[m] for m in members}
        }
        found = sorted(((worth(members), members) for members in larger), reverse=True)
        best, extended = max([best, *found]), [members for _, members in found[:_MOST_EXTENDED]]
    if not best[1]:
        return []
    gain, steps = equations.solved(best[1])
    chi2 = square(problem.model.project(residual)) - gain
    chosen = [able[m] for m in best[1]]
    each = np.split(steps, np.cumsum([len(one.steps) for one in chosen])[:-1])
    return [
        Candidate(one.hypothesis, one.numbers(own), {}, chi2, np.zeros(0, np.float32))
        for one, own in zip(chosen, each, strict=True)
    ]


def backward_elimination(linearised: LinearisedFit, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Drop effects, least needed first, whose loss costs less chi2 than an effect must gain."""
    current = list(chosen)
    while len(current) > 1:
        full = residual_with(linearised, current)
        costs = []
        for index, candidate in enumerate(current):
            rest = refitted_together(linearised, [c for c in current if c is not candidate])
            left = residual_with(linearised, rest)
            costs.append((square(left) - square(full), index, rest))
        cost, index, rest = min(costs, key=lambda item: item[0])
        least = least_gain(current[index], linearised.model)
        if cost > least or current[index].by_priors:
            break
        current = rest
    return current


def pairs_replaced(
    linearised: LinearisedFit, chosen: Sequence[Candidate], signatures: Sequence[Signature]
) -> list[Candidate]:
    """Replace two of three effects by one that fits as well.

    Two effects together may imitate one, and the first of them was chosen while the others were missing. Effects that
    are judged by the priors gain too little chi2 to be compared so: with one of them nothing is replaced.
    """
    if len(chosen) < _REPLACED_FROM or any(c.by_priors for c in chosen):
        return list(chosen)
    together = residual_with(linearised, chosen)
    limit = square(together) + largest_gain_of_errors(linearised.model)
    best = list(chosen)
    for kept in chosen:
        rest = [s for s in signatures if s.hypothesis.effect.id != kept.hypothesis.effect.id]
        found = best_singles(linearised.problem([kept]), rest, residual_with(linearised, [kept]), _MOST_FITTED)
        trial = refitted_together(linearised, [kept, found[0]])
        left = residual_with(linearised, trial)
        if square(left) < limit:
            best, limit = trial, square(left)
    return best
