"""How well a hypothesis explains the residual: screening by signatures, then a fit of its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray

from .effects import AppliedEffect, Parameter
from .forward import displacement
from .hypotheses import Hypothesis
from .linear_model import LinearModel
from .predictor import Predictor

__all__ = [
    "Candidate",
    "NumberStep",
    "Problem",
    "Signature",
    "fit",
    "parameter_variance",
    "problem",
    "screen",
    "signature",
    "steps_of",
]

_ROUNDS = 4

#: What further rounds may gain, over the gain of the last one.
_PROMISE = 2.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis with numbers. numbers : fitted. sigma : their standard deviations. chi2 : with nuisances at
    their best. predicted : (n + 11,) projected change it makes, over sigma."""

    hypothesis: Hypothesis
    numbers: Mapping[str, float]
    sigma: Mapping[str, float]
    chi2: float
    predicted: NDArray[np.float64]

    @property
    def applied(self) -> AppliedEffect:
        """The effect with its fitted numbers."""
        return self.hypothesis.at(self.numbers)


@dataclass(frozen=True, eq=False)
class NumberStep:
    """A small step of one number. size : in the coordinate that the number is searched in. after : the candidate with
    it, of which only the numbers hold."""

    parameter: Parameter
    size: float
    after: Candidate


def steps_of(candidate: Candidate) -> list[NumberStep]:
    """A step of each of a candidate's numbers, inside its bounds."""
    found = []
    for p in candidate.hypothesis.effect.numbers:
        if p.name in candidate.numbers:
            here, (_, high) = _to_coordinate(p, candidate.numbers[p.name]), _bounds(p)
            from_null = 0.0 if p.null is None else abs(here - _null_coordinate(p))
            size = max(abs(_probe(p)), 0.1 * from_null)
            size = size if here + size <= high else -size
            numbers = {**candidate.numbers, p.name: _from_coordinate(p, here + size)}
            found.append(NumberStep(p, size, replace(candidate, numbers=numbers)))
    return found


def _moved(candidate: Candidate, steps: Sequence[NumberStep], by: NDArray[np.float64]) -> Candidate:
    """With its numbers moved by multiples of steps, inside their bounds."""
    numbers = dict(candidate.numbers)
    for step, times in zip(steps, by, strict=True):
        p = step.parameter
        there = np.clip(_to_coordinate(p, numbers[p.name]) + times * step.size, *_bounds(p))
        numbers[p.name] = _from_coordinate(p, float(there))
    return replace(candidate, numbers=numbers)


def _deviations(
    candidate: Candidate, steps: Sequence[NumberStep], variance: NDArray[np.float64]
) -> dict[str, float]:
    """Standard deviations of its numbers from the variances of the multiples of steps."""
    return {
        s.parameter.name: _deviation(
            s.parameter, candidate.numbers[s.parameter.name], abs(s.size) * float(np.sqrt(max(v, 0.0)))
        )
        for s, v in zip(steps, variance, strict=True)
    }


@dataclass(frozen=True, eq=False)
class Problem:
    """Residual and base that a further effect is fitted to, other effects already being in.

    noise : (band, y, x) DN before optics, a draw of the base picture's own Monte Carlo error.
    """

    predictor: Predictor
    model: LinearModel
    others: tuple[AppliedEffect, ...]
    scale: float
    base: NDArray[np.float64]
    noise: NDArray[np.float64]

    def change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """(n + 11,) projected whitened change that an effect makes on top of the others."""
        if applied.effect.stage == "camera":
            return self.model.displaced(displacement(self.predictor.camera, self.others, (applied,)))
        return self.model.whiten(self.scale * (self.predictor.signal((*self.others, applied)) - self.base))

    def smoothed_away(self, applied: AppliedEffect) -> float:
        """Chi2 that an effect would gain by averaging the base picture's noise: a blur does, whatever the truth."""
        if applied.effect.stage not in ("optics", "counts"):
            return 0.0
        return self._own_noise - self._noise_with(self.others, applied)

    @cached_property
    def _own_noise(self) -> float:
        return self._noise_with(self.others)

    def _noise_with(self, others: Sequence[AppliedEffect], *more: AppliedEffect) -> float:
        noise = self.predictor.noise((*others, *more), self.noise)[self.model.used]
        return float(np.sum((self.scale * noise / self.model.sigma) ** 2))


# Filter shift acts through 1 / n^2, and its null is an infinite index: it is searched in that coordinate.
def _to_coordinate(parameter: Parameter, value: float) -> float:
    return 1 / value**2 if parameter.null == np.inf else value


def _from_coordinate(parameter: Parameter, coordinate: float) -> float:
    if parameter.null == np.inf:
        return float(min(max(coordinate, 1e-12) ** -0.5, parameter.high)) if coordinate > 1e-12 else np.inf
    return float(np.clip(coordinate, parameter.low, parameter.high))


def _deviation(parameter: Parameter, value: float, coordinate_deviation: float) -> float:
    """A standard deviation of the coordinate as one of the number: c = n^-2 gives dn = n^3 / 2 dc."""
    return coordinate_deviation * (0.5 * value**3 if parameter.null == np.inf else 1.0)


def _bounds(parameter: Parameter) -> tuple[float, float]:
    return (0.0, 1 / parameter.low**2) if parameter.null == np.inf else (parameter.low, parameter.high)


def _probe(parameter: Parameter) -> float:
    """A small step, away from null within bounds where there is a null."""
    if parameter.null == np.inf:
        return 0.05
    null = 0.0 if parameter.null is None else parameter.null
    return parameter.step if null + parameter.step <= parameter.high else -parameter.step


def problem(
    predictor: Predictor, model: LinearModel, others: Sequence[AppliedEffect], scale: float, variance: NDArray
) -> Problem:
    """What a further effect is fitted to. variance : (band, y, x) DN^2 of the base picture's Monte Carlo error."""
    draw = np.random.default_rng(predictor.settings.seed).standard_normal(variance.shape)
    return Problem(predictor, model, tuple(others), scale, predictor.signal(others), np.sqrt(variance) * draw)


@dataclass(frozen=True, eq=False)
class Signature:
    """What small steps of a hypothesis' free numbers change, (parameter, n) DN of the used pixels; None where no
    picture is needed, the camera having moved (see ``Problem.change``)."""

    hypothesis: Hypothesis
    steps: tuple[float, ...]
    changes: NDArray[np.float32] | None

    @property
    def stepped(self) -> list[AppliedEffect]:
        """The effect a step from null in one number after the other; the effect itself where none is free."""
        return [
            self.hypothesis.at({p.name: _from_coordinate(p, _null_coordinate(p) + step)})
            for p, step in zip(self.hypothesis.free, self.steps, strict=False)
        ] or [self.hypothesis.at({})]


def signature(
    predictor: Predictor, given: Sequence[AppliedEffect], used: NDArray[np.bool_], hypothesis: Hypothesis
) -> Signature | None:
    """Difference pictures at small steps from null, on top of ``given``; None where the effect cannot act here."""
    known = Signature(hypothesis, tuple(_probe(p) for p in hypothesis.free) or (1.0,), None)
    if hypothesis.effect.stage == "camera":
        return known
    base = predictor.signal(given)
    try:
        changes = [(predictor.signal((*given, effect)) - base)[used] for effect in known.stepped]
    except InputError:
        return None
    return replace(known, changes=np.array(changes, np.float32))


def screen(task: Problem, known: Signature, residual: NDArray[np.float64]) -> Candidate:
    """A hypothesis to first order. A single number is kept within its bounds."""
    model, hypothesis = task.model, known.hypothesis
    residual = model.project(residual)
    if known.changes is None:
        columns = np.array([task.change(effect) for effect in known.stepped]).T
    else:
        columns = np.array([model.whiten_used(task.scale * change) for change in known.changes]).T
    smoothed = np.array([task.smoothed_away(effect) for effect in known.stepped])
    amplitude, covariance = _solve(columns, residual, smoothed)
    if not hypothesis.free:
        amplitude = np.ones(1)
    elif len(amplitude) == 1:
        p = hypothesis.free[0]
        ends = sorted((end - _null_coordinate(p)) / known.steps[0] for end in _bounds(p))
        amplitude = np.clip(amplitude, ends[0], ends[1])
    numbers = {
        p.name: _from_coordinate(p, _null_coordinate(p) + a * step)
        for p, a, step in zip(hypothesis.free, amplitude, known.steps, strict=False)
    }
    sigma = {
        p.name: _deviation(p, numbers[p.name], abs(step) * float(c**0.5))
        for p, step, c in zip(hypothesis.free, known.steps, np.diag(covariance), strict=False)
    }
    predicted = columns @ amplitude
    left = residual - predicted
    return Candidate(hypothesis, numbers, sigma, float(left @ left + smoothed @ amplitude), predicted)


def _null_coordinate(parameter: Parameter) -> float:
    return 0.0 if parameter.null is None else _to_coordinate(parameter, parameter.null)


def _solve(columns: NDArray, residual: NDArray, slope: NDArray) -> tuple[NDArray, NDArray]:
    """Where the residual's square plus the slope's product is least, and the inverse of half its second derivatives."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    unit = columns / size
    covariance = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    return covariance @ ((columns.T @ residual - slope / 2) / size) / size, covariance / np.outer(size, size)


def parameter_variance(
    model: LinearModel, design: NDArray, inverse: NDArray, residual: NDArray
) -> NDArray[np.float64]:
    """(parameter,) variances that hold beside noise for residuals which go together within patches of the image and
    over bands, and for flaws that the pixels of a band or of a face share, at the size they are known to have.

    What is left is not noise alone, and its flaws are those of neighbourhoods: Liang and Zeger, "Longitudinal data
    analysis using generalized linear models", Biometrika 73(1), 1986, with patches as clusters. Shared flaws are not
    left where the numbers can follow them, but those are off by as much.
    """
    scores = design[: model.count] * residual[: model.count, None]
    sums = np.array([np.bincount(model.patch, weights=column) for column in scores.T])
    neighbours = np.diag(inverse @ (sums @ sums.T) @ inverse)
    followed = inverse @ (design.T @ model.flaws)
    return np.maximum(np.diag(inverse), neighbours) + np.square(followed).sum(axis=1)


def fit(task: Problem, start: Candidate, residual: NDArray[np.float64], known: float = np.inf) -> Candidate:
    """Refine a screened candidate by Gauss-Newton on its exact predictions; peaks and lobes may move too.

    known : chi2 that another effect reaches; a candidate that would not come near it is not followed to its end.
    """
    hypothesis, residual = start.hypothesis, task.model.project(residual)
    if not hypothesis.free:
        return start
    current = {
        p.name: float(start.numbers.get(p.name, hypothesis.fixed.get(p.name, 0.0)))
        for p in hypothesis.effect.numbers
        if p.name in start.numbers or (p.null is None and p.name not in hypothesis.held)
    }
    best = _evaluate(task, replace(start, numbers=current), residual)
    for trial in _other_starts(hypothesis, start):
        other = _evaluate(task, replace(start, numbers={**current, **trial}), residual)
        if other.chi2 < best.chi2:
            best = other
    for _ in range(_ROUNDS):
        steps = steps_of(best)
        left = residual - best.predicted
        design = np.array([task.change(s.after.applied) - best.predicted for s in steps]).T
        smoothed = task.smoothed_away(best.applied)
        slope = np.array([task.smoothed_away(s.after.applied) - smoothed for s in steps])
        shift, covariance = _solve(design, left, slope)
        variance = parameter_variance(task.model, design, covariance, left)
        best = replace(best, sigma=_deviations(best, steps, variance))
        improved = False
        for damping in (1.0, 0.4, 0.15):
            trial_candidate = _evaluate(task, _moved(best, steps, damping * shift), residual)
            if trial_candidate.chi2 < best.chi2:
                gain = best.chi2 - trial_candidate.chi2
                best = trial_candidate
                improved = gain > max(1.0, 1e-4 * best.chi2) and best.chi2 - _PROMISE * gain < known
                break
        if not improved:
            break
    return best


def _other_starts(hypothesis: Hypothesis, start: Candidate) -> list[dict[str, float]]:
    """Effects that grow with the square of their number (a blur) are badly extrapolated: start lower too."""
    if len(hypothesis.free) != 1:
        return []
    p = hypothesis.free[0]
    null, probe = _null_coordinate(p), _probe(p)
    ratio = (_to_coordinate(p, start.numbers[p.name]) - null) / probe
    return [{p.name: _from_coordinate(p, null + probe * float(np.sqrt(ratio)))}] if ratio > 0 else []


def _evaluate(task: Problem, candidate: Candidate, residual: NDArray) -> Candidate:
    """With the numbers that it has."""
    try:
        change = task.change(candidate.applied)
    except InputError:
        return replace(candidate, chi2=np.inf, predicted=np.zeros_like(residual))
    left = residual - change
    chi2 = float(left @ left) + task.smoothed_away(candidate.applied)
    return replace(candidate, chi2=chi2, predicted=change)
