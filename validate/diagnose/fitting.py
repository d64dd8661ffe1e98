"""Full fit of effects' numbers: Gauss-Newton on exact predictions, with standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from .hypotheses import Hypothesis
from .search import Candidate, FitModel, FitProblem, NumberStep, least_squares, steps_of

__all__ = ["Fitted", "fit", "gauss_newton", "parameter_variance", "with_all_numbers"]

#: Numerics: largest number of Gauss-Newton rounds of a fit: each round predicts the picture once per number.
_ROUNDS = 4

#: Numerics: bound on the chi2 that all further rounds gain, over the gain of the last round. A fit ends early where
#: even this would not reach a rival's chi2.
_MOST_FURTHER_GAIN = 2.0


def _moved_by_steps(candidate: Candidate, steps: Sequence[NumberStep], by: NDArray[np.float64]) -> Candidate:
    """A candidate with its numbers moved by multiples of steps, clipped to their bounds."""
    numbers = dict(candidate.numbers)
    for step, times in zip(steps, by, strict=True):
        p = step.parameter
        coordinate = np.clip(p.to_coordinate(numbers[p.name]) + times * step.size, *p.coordinate_bounds)
        numbers[p.name] = p.from_coordinate(float(coordinate))
    return replace(candidate, numbers=numbers)


def _standard_deviations(
    candidate: Candidate, steps: Sequence[NumberStep], variance: NDArray[np.float64]
) -> dict[str, float]:
    """Standard deviations of a candidate's numbers, by the variances of their steps' multiples."""
    return {
        s.parameter.name: s.parameter.deviation(
            candidate.numbers[s.parameter.name], abs(s.size) * float(np.sqrt(max(v, 0.0)))
        )
        for s, v in zip(steps, variance, strict=True)
    }


def parameter_variance(model: FitModel, design: NDArray, inverse: NDArray, residual: NDArray) -> NDArray[np.float64]:
    """Variances of fitted amplitudes by noise, correlated residuals and shared errors.

    Correlated residuals are counted with patches of the image, over all bands, as clusters: Liang and Zeger,
    "Longitudinal data analysis using generalized linear models", Biometrika 73(1), 1986. The larger one of this and the
    variance by noise counts. Errors that a band or a face shares may be fitted by the numbers and leave no residual, so
    their effect on the numbers is added at its known size.

    Parameters
    ----------
    model
        Linear model of one capture or several.
    design
        (n + 11, parameter) projected change by a unit of each amplitude, over sigma.
    inverse
        (parameter, parameter) inverse of half the second derivatives of chi2.
    residual
        (n + 11,) projected residual of the fit, over sigma.

    Returns
    -------
    NDArray
        (parameter,) variances, in squared units of the amplitudes.
    """
    scores = design[: model.count] * residual[: model.count, None]
    sums = np.array([np.bincount(model.patch, weights=column) for column in scores.T])
    neighbours = np.diag(inverse @ (sums @ sums.T) @ inverse)
    followed = inverse @ (design.T @ model.shared_errors)
    return np.maximum(np.diag(inverse), neighbours) + np.square(followed).sum(axis=1)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Candidates with numbers, and the residual with them in place."""

    #: The candidates, their numbers set.
    candidates: tuple[Candidate, ...]
    #: (n + 11,) projected residual over sigma, with the candidates in place.
    residual: NDArray[np.float64]
    #: Chi2 that they gain by averaging the rendering's noise, see `Problem.noise_averaging_gain`.
    averaged: float

    @property
    def chi2(self) -> float:
        """Sum of squares of the residual; the gain by averaging noise does not count."""
        return float(self.residual @ self.residual) + self.averaged


def gauss_newton(
    evaluate: Callable[[Sequence[Candidate]], Fitted], model: FitModel, start: Fitted, rival_chi2: float = np.inf
) -> tuple[Fitted, NDArray[np.float64]]:
    """Refine the numbers of all candidates together on exact predictions, within their bounds.

    Each round takes one-sided differences, solves the linear problem and tries the step at lengths 1, 0.4 and 0.15. It
    ends where no length lowers chi2, or where the gain is below 1 and below 1e-4 of chi2.

    Parameters
    ----------
    evaluate
        The candidates with their numbers in place; raises InputError where they cannot act.
    model
        Linear model in which the variances are computed.
    start
        Candidates at their starting numbers.
    rival_chi2
        Chi2 that another effect reaches; the fit ends early where it cannot come near it. Infinite: no rival.

    Returns
    -------
    fitted : Fitted
        The best candidates, with standard deviations.
    derivatives : NDArray
        (n + 11, number) reduction of the residual by a step of each number, in the last round.
    """
    best = start
    for _ in range(_ROUNDS):
        steps = [steps_of(c) if c.hypothesis.free else [] for c in best.candidates]
        ends = np.cumsum([len(steps_of_one) for steps_of_one in steps])[:-1]
        stepped = [
            evaluate([*best.candidates[:index], step.after, *best.candidates[index + 1 :]])
            for index, steps_of_one in enumerate(steps)
            for step in steps_of_one
        ]
        design = np.array([best.residual - altered.residual for altered in stepped]).T
        slope = np.array([altered.averaged - best.averaged for altered in stepped])
        shift, covariance = least_squares(design, best.residual, slope)
        variance = np.split(parameter_variance(model, design, covariance, best.residual), ends)
        with_deviations = [
            replace(c, sigma=_standard_deviations(c, steps_of_one, v))
            for c, steps_of_one, v in zip(best.candidates, steps, variance, strict=True)
        ]
        best = replace(best, candidates=tuple(with_deviations))
        for damping in (1.0, 0.4, 0.15):
            shifts = np.split(damping * shift, ends)
            trial = _evaluate_if_possible(
                evaluate, [_moved_by_steps(*each) for each in zip(with_deviations, steps, shifts, strict=True)]
            )
            if trial is not None and trial.chi2 < best.chi2:
                break
        else:
            break
        gain, best = best.chi2 - trial.chi2, trial
        if gain < max(1.0, 1e-4 * best.chi2) or best.chi2 - _MOST_FURTHER_GAIN * gain >= rival_chi2:
            break
    return best, design


def _evaluate_if_possible(
    evaluate: Callable[[Sequence[Candidate]], Fitted], candidates: Sequence[Candidate]
) -> Fitted | None:
    """The candidates with their numbers in place; None where they cannot act."""
    try:
        return evaluate(candidates)
    except InputError:
        return None


def fit(problem: FitProblem, start: Candidate, residual: NDArray[np.float64], rival_chi2: float = np.inf) -> Candidate:
    """Refine a screened candidate by Gauss-Newton, numbers without a null value included.

    Parameters
    ----------
    problem
        One capture, or several, with the effects already in the model.
    start
        Candidate with numbers to first order. Effects that grow with the square of their number are also started at
        the square root.
    residual
        (n + 11,) residual over sigma with the effects already in the model.
    rival_chi2
        See `gauss_newton`.

    Returns
    -------
    Candidate
        With fitted numbers, standard deviations, chi2 and predicted change; as it is where it has no free number, with
        infinite chi2 where it cannot act.
    """
    hypothesis, residual = start.hypothesis, problem.model.project(residual)
    if not hypothesis.free:
        return start

    def evaluate(candidates: Sequence[Candidate]) -> Fitted:
        (candidate,) = candidates
        remainder = residual - problem.change(candidate.applied)
        return Fitted((candidate,), remainder, problem.noise_averaging_gain(candidate.applied))

    first = with_all_numbers(start)
    starts = [
        first,
        *(replace(first, numbers={**first.numbers, **n}) for n in _other_starts(hypothesis, start)),
    ]
    possible = [fitted for candidate in starts if (fitted := _evaluate_if_possible(evaluate, [candidate])) is not None]
    if not possible:
        return replace(first, chi2=np.inf, predicted=np.zeros_like(residual))
    best, _ = gauss_newton(evaluate, problem.model, min(possible, key=lambda candidate: candidate.chi2), rival_chi2)
    (refined,) = best.candidates
    return replace(refined, chi2=best.chi2, predicted=(residual - best.residual).astype(np.float32))


def with_all_numbers(start: Candidate) -> Candidate:
    """A candidate that also frees the numbers without a null value, which only a full fit moves.

    Parameters
    ----------
    start
        Candidate with its free numbers.

    Returns
    -------
    Candidate
        With all numbers except those that the hypothesis holds.
    """
    hypothesis = start.hypothesis
    return replace(
        start,
        numbers={
            p.name: float(start.numbers.get(p.name, hypothesis.fixed.get(p.name, 0.0)))
            for p in hypothesis.effect.numbers
            if p.name in start.numbers or (p.null is None and p.name not in hypothesis.unfitted)
        },
    )


def _other_starts(hypothesis: Hypothesis, start: Candidate) -> list[dict[str, float]]:
    """A start at the square root of the amplitude, for effects of second order (blurs)."""
    if len(hypothesis.free) != 1:
        return []
    p = hypothesis.free[0]
    null, probe = p.null_coordinate, p.coordinate_step
    ratio = (p.to_coordinate(start.numbers[p.name]) - null) / probe
    return [{p.name: p.from_coordinate(null + probe * float(np.sqrt(ratio)))}] if ratio > 0 else []
