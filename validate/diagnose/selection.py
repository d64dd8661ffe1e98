"""Search among the catalogue's effects: the best single ones, backward elimination, pairs replaced by one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.scenes.progress import QUIET, Progress
from numpy.typing import NDArray

from .evidence import largest_gain_of_errors, least_gain, penalised, square
from .fitting import fit
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, Problem, Signature, screen

__all__ = ["backward_elimination", "best_singles", "pairs_replaced"]

#: So many of the effects that could replace two others are fitted in full.
_MOST_FITTED = 3

#: Fewer effects than these are not tried with two of them replaced: every single one has been compared by then.
_REPLACED_FROM = 3

#: A candidate whose first-order gain is below this part of the best fitted one's is not fitted in full.
_LEAST_PROMISING = 0.4


def best_singles(
    problem: Problem, signatures: Sequence[Signature], residual: NDArray, refined: int, known: float = np.inf,
    progress: Progress = QUIET,
) -> list[Candidate]:  # fmt: skip
    """The best hypothesis of every effect, best first; the first ``refined`` of them fitted in full.

    Those that gain much less to first order than the best known fit are not fitted. known : chi2 of a fit that is
    known already.
    """
    best: dict[str, Candidate] = {}
    for index, one in enumerate(signatures, 1):
        candidate = screen(problem, one, residual)
        progress.part(0.5 * index / len(signatures))
        rival = best.setdefault(candidate.hypothesis.effect.id, candidate)
        if penalised(candidate) < penalised(rival):
            best[rival.hypothesis.effect.id] = candidate
    ranked = sorted(best.values(), key=penalised)
    start = square(problem.model.project(residual))
    done: list[Candidate] = []
    for candidate in ranked[:refined]:
        lowest = min((c.chi2 for c in done), default=known)
        if np.isfinite(lowest) and start - candidate.chi2 < _LEAST_PROMISING * (start - lowest):
            break
        done.append(fit(problem, candidate, residual, lowest))
        progress.part(0.5 + 0.5 * len(done) / refined)
    return sorted([*done, *ranked[len(done) :]], key=penalised)


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
        found = best_singles(
            linearised.problem([kept]), rest, residual_with(linearised, [kept]), _MOST_FITTED
        )
        trial = refitted_together(linearised, [kept, found[0]])
        left = residual_with(linearised, trial)
        if square(left) < limit:
            best, limit = trial, square(left)
    return best
