"""Effects' numbers fitted in full: Gauss-Newton on exact predictions, and the numbers' standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .hypotheses import Hypothesis
from .search import Candidate, FitModel, FitProblem, NumberStep, least_squares, steps_of

__all__ = ["Fitted", "fit", "gauss_newton", "parameter_variance", "with_all_numbers"]

#: Rounds of Gauss-Newton at most.
_ROUNDS = 4

#: All further rounds together are taken to gain at most this multiple of the gain of the last one.
_MOST_FURTHER_GAIN = 2.0


def _moved(candidate: Candidate, steps: Sequence[NumberStep], by: NDArray[np.float64]) -> Candidate:
    """A candidate with its numbers moved by multiples of steps, inside their bounds."""
    numbers = dict(candidate.numbers)
    for step, times in zip(steps, by, strict=True):
        p = step.parameter
        there = np.clip(p.to_coordinate(numbers[p.name]) + times * step.size, *p.coordinate_bounds)
        numbers[p.name] = p.from_coordinate(float(there))
    return replace(candidate, numbers=numbers)


def _deviations(candidate: Candidate, steps: Sequence[NumberStep], variance: NDArray[np.float64]) -> dict[str, float]:
    """Standard deviations of its numbers from the variances of the multiples of steps."""
    return {
        s.parameter.name: s.parameter.deviation(
            candidate.numbers[s.parameter.name], abs(s.size) * float(np.sqrt(max(v, 0.0)))
        )
        for s, v in zip(steps, variance, strict=True)
    }


def parameter_variance(model: FitModel, design: NDArray, inverse: NDArray, residual: NDArray) -> NDArray[np.float64]:
    """(parameter,) variances by noise, by residuals correlated within patches of the image, and by shared errors.

    Correlated residuals are counted with patches, over all bands, as clusters: Liang and Zeger, "Longitudinal data
    analysis using generalized linear models", Biometrika 73(1), 1986. Errors that a band or a face shares may be fitted
    away by the numbers and leave no residual, so they are added at their known size.
    """
    scores = design[: model.count] * residual[: model.count, None]
    sums = np.array([np.bincount(model.patch, weights=column) for column in scores.T])
    neighbours = np.diag(inverse @ (sums @ sums.T) @ inverse)
    followed = inverse @ (design.T @ model.shared_errors)
    return np.maximum(np.diag(inverse), neighbours) + np.square(followed).sum(axis=1)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Candidates with numbers. left : (n + 11,) projected residual with them in place. averaged : chi2 that they gain
    by averaging noise, see ``Problem.noise_averaging_gain``."""

    candidates: tuple[Candidate, ...]
    left: NDArray[np.float64]
    averaged: float

    @property
    def chi2(self) -> float:
        """With what is gained by averaging noise left out."""
        return float(self.left @ self.left) + self.averaged


def gauss_newton(
    evaluate: Callable[[Sequence[Candidate]], Fitted], model: FitModel, start: Fitted, known: float = np.inf
) -> tuple[Fitted, NDArray[np.float64]]:
    """Refine the numbers of all candidates together on exact predictions, within their bounds.

    evaluate : the candidates with their numbers in place; raises InputError where they cannot be. known : chi2 that
    another effect reaches; the fit ends early where it would not come near it. Returns also the last derivatives, (n +
    11, number): what a step of each number takes off the residual.
    """
    best = start
    for _ in range(_ROUNDS):
        steps = [steps_of(c) if c.hypothesis.free else [] for c in best.candidates]
        ends = np.cumsum([len(own) for own in steps])[:-1]
        stepped = [
            evaluate([*best.candidates[:index], step.after, *best.candidates[index + 1 :]])
            for index, own in enumerate(steps)
            for step in own
        ]
        design = np.array([best.left - there.left for there in stepped]).T
        slope = np.array([there.averaged - best.averaged for there in stepped])
        shift, covariance = least_squares(design, best.left, slope)
        variance = np.split(parameter_variance(model, design, covariance, best.left), ends)
        stated = [
            replace(c, sigma=_deviations(c, own, v)) for c, own, v in zip(best.candidates, steps, variance, strict=True)
        ]
        best = replace(best, candidates=tuple(stated))
        for damping in (1.0, 0.4, 0.15):
            by = np.split(damping * shift, ends)
            trial = _tried(evaluate, [_moved(*each) for each in zip(stated, steps, by, strict=True)])
            if trial is not None and trial.chi2 < best.chi2:
                break
        else:
            break
        gain, best = best.chi2 - trial.chi2, trial
        if gain < max(1.0, 1e-4 * best.chi2) or best.chi2 - _MOST_FURTHER_GAIN * gain >= known:
            break
    return best, design


def _tried(evaluate: Callable[[Sequence[Candidate]], Fitted], candidates: Sequence[Candidate]) -> Fitted | None:
    """The candidates with their numbers in place; None where they cannot be."""
    try:
        return evaluate(candidates)
    except InputError:
        return None


def fit(problem: FitProblem, start: Candidate, residual: NDArray[np.float64], known: float = np.inf) -> Candidate:
    """Refine a screened candidate by Gauss-Newton, numbers without null included.

    known : see ``gauss_newton``.
    """
    hypothesis, residual = start.hypothesis, problem.model.project(residual)
    if not hypothesis.free:
        return start

    def evaluate(candidates: Sequence[Candidate]) -> Fitted:
        (one,) = candidates
        left = residual - problem.change(one.applied)
        return Fitted((one,), left, problem.noise_averaging_gain(one.applied))

    first = with_all_numbers(start)
    starts = [
        first,
        *(replace(first, numbers={**first.numbers, **n}) for n in _other_starts(hypothesis, start)),
    ]
    possible = [found for one in starts if (found := _tried(evaluate, [one])) is not None]
    if not possible:
        return replace(first, chi2=np.inf, predicted=np.zeros_like(residual))
    best, _ = gauss_newton(evaluate, problem.model, min(possible, key=lambda one: one.chi2), known)
    (refined,) = best.candidates
    return replace(refined, chi2=best.chi2, predicted=(residual - best.left).astype(np.float32))


def with_all_numbers(start: Candidate) -> Candidate:
    """A candidate with the numbers, too, that only a fit in full frees: those without null."""
    hypothesis = start.hypothesis
    return replace(
        start,
        numbers={
            p.name: float(start.numbers.get(p.name, hypothesis.fixed.get(p.name, 0.0)))
            for p in hypothesis.effect.numbers
            if p.name in start.numbers or (p.null is None and p.name not in hypothesis.held)
        },
    )


def _other_starts(hypothesis: Hypothesis, start: Candidate) -> list[dict[str, float]]:
    """A start at the square root of the first-order amplitude, for effects that grow with the square (blurs)."""
    if len(hypothesis.free) != 1:
        return []
    p = hypothesis.free[0]
    null, probe = p.null_coordinate, p.coordinate_step
    ratio = (p.to_coordinate(start.numbers[p.name]) - null) / probe
    return [{p.name: p.from_coordinate(null + probe * float(np.sqrt(ratio)))}] if ratio > 0 else []
