"""How well a hypothesis explains the residual: screening to first order, then a fit of its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.effects import AppliedEffect, Parameter
from cboxlab.rendering.model import displacement, with_further_distortion
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

from ..predict import Predictor
from .hypotheses import Hypothesis
from .linear_model import LinearModel

__all__ = [
    "Candidate",
    "FitProblem",
    "NumberStep",
    "Problem",
    "Signature",
    "build_problem",
    "judged_by_priors",
    "least_squares",
    "screen",
    "signature",
    "steps_of",
]


#: Changes below this part of the largest signal used are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Candidate(OwnMappings):
    """A hypothesis with numbers. numbers : fitted. sigma : their standard deviations. chi2 : minimised over the
    nuisances. predicted : (n + 11,) projected change it makes, over sigma, in single precision once it is judged: there
    is one for every effect. by_priors : see ``judged_by_priors``."""

    hypothesis: Hypothesis
    numbers: Mapping[str, float]
    sigma: Mapping[str, float]
    chi2: float
    predicted: NDArray[np.floating]
    by_priors: bool = False

    @property
    def applied(self) -> AppliedEffect:
        """The effect with its fitted numbers."""
        return self.hypothesis.at(self.numbers)

    def at_aperture(self, factor: float) -> Candidate:
        """The candidate with the aperture's diameter times a factor."""
        there = self.applied.at_aperture(factor).values
        return replace(self, numbers={name: float(there[name]) for name in self.numbers})


@dataclass(frozen=True, eq=False)
class NumberStep:
    """A small step of one number. size : in the coordinate of its scale. after : the candidate with its numbers changed
    so; its chi2, sigma and predicted change are those before."""

    parameter: Parameter
    size: float
    after: Candidate


def steps_of(candidate: Candidate) -> list[NumberStep]:
    """A step of each of a candidate's numbers, inside its bounds."""
    found = []
    for p in candidate.hypothesis.effect.numbers:
        if p.name in candidate.numbers:
            here, (_, high) = p.to_coordinate(candidate.numbers[p.name]), p.coordinate_bounds
            from_null = 0.0 if p.null is None else abs(here - p.null_coordinate)
            size = max(abs(p.coordinate_step), 0.1 * from_null)
            size = size if here + size <= high else -size
            numbers = {**candidate.numbers, p.name: p.from_coordinate(here + size)}
            found.append(NumberStep(p, size, replace(candidate, numbers=numbers)))
    return found


def _in_picture(applied: AppliedEffect, camera: Camera) -> bool:
    """Whether an effect changes the picture otherwise than by the camera's ten parameters."""
    return applied.effect.stage != "camera" or with_further_distortion(camera, (applied,)) is not camera


def judged_by_priors(applied: AppliedEffect, camera: Camera) -> bool:
    """Whether the fit of camera and lamp can do all that an effect does to the picture.

    Then only what is known of them speaks against it: the survey, the lamp's stated power.
    """
    return applied.effect.imitates_lamp_power or not _in_picture(applied, camera)


class FitModel(Protocol):
    """What a fit asks of the linear model of one capture, or of several."""

    @property
    def count(self) -> int: ...
    @property
    def patch(self) -> NDArray[np.int64]: ...
    @property
    def shared_errors(self) -> NDArray[np.float32]: ...
    def project(self, vector: NDArray[np.float64], /) -> NDArray[np.float64]: ...
    def whiten_used(self, change: NDArray, /) -> NDArray[np.float64]: ...


class FitProblem(Protocol):
    """What an effect is fitted to, in one capture (``Problem``) or in several."""

    @property
    def model(self) -> FitModel: ...
    @property
    def scale(self) -> float: ...
    def change(self, applied: AppliedEffect, /) -> NDArray[np.float64]: ...
    def camera_change(self, applied: AppliedEffect, /) -> NDArray[np.float64]: ...
    def noise_averaging_gain(self, applied: AppliedEffect, /) -> float: ...


@dataclass(frozen=True, eq=False)
class Problem:
    """What a further effect is fitted to. others : effects in the model already. scale : factor on the lamp's power.

    base : (band, y, x) DN predicted with the others. noise : (band, y, x) DN before optics, a draw of the base
    picture's Monte Carlo error.
    """

    predictor: Predictor
    model: LinearModel
    others: tuple[AppliedEffect, ...]
    scale: float
    base: NDArray[np.float64]
    noise: NDArray[np.float64]

    def change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """(n + 11,) projected whitened change that an effect makes on top of the others."""
        if not _in_picture(applied, self.predictor.camera):
            return self.camera_change(applied)
        picture = self.scale * (self.predictor.signal((*self.others, applied)) - self.base)
        if applied.effect.imitates_lamp_power:
            return self.model.lamp_change(picture)
        return self.model.whiten(picture) + self.camera_change(applied)

    def camera_change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """The part of ``change`` that the effect makes by changing the camera's ten parameters; 0 if it cannot."""
        if applied.stage != "camera":
            return np.zeros_like(self.model.residual)
        return self.model.camera_change(displacement(self.predictor.camera, self.others, (applied,)))

    def noise_averaging_gain(self, *applied: AppliedEffect) -> float:
        """Chi2 that effects gain by averaging the base picture's noise, as a blur does of any picture.

        Where they make all signals brighter the lamp's fit makes them, and their noise, as much darker.
        """
        if not any(effect.stage in stages_between("optics", "counts") for effect in applied):
            return 0.0
        (signal, noise), (there, noise_there) = self._without, self._with(*applied)
        brighter = (signal @ there) / (signal @ signal)
        return float(noise @ noise - noise_there @ noise_there / brighter**2)

    @cached_property
    def _without(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._with()

    def _with(self, *applied: AppliedEffect) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) over sigma each: signals and their noise with further effects."""
        both = self.predictor.signal_and_noise((*self.others, *applied), self.noise)
        signal, noise = (self.scale * one[self.model.used] / self.model.sigma for one in both)
        return signal, noise


def build_problem(
    predictor: Predictor, model: LinearModel, others: Sequence[AppliedEffect], scale: float, variance: NDArray
) -> Problem:
    """What a further effect is fitted to. variance : (band, y, x) DN^2 of the base picture's Monte Carlo error."""
    draw = np.random.default_rng(predictor.settings.seed).standard_normal(variance.shape)
    return Problem(predictor, model, tuple(others), scale, predictor.signal(others), np.sqrt(variance) * draw)


@dataclass(frozen=True, eq=False)
class Signature:
    """What small steps of a hypothesis' free numbers change, (parameter, n) DN of the used pixels; by_priors : see
    ``judged_by_priors``. Then changes is None: what is left of them beside camera and lamp is so little that it is
    computed anew with the effects in the model (see ``Problem.change``)."""

    hypothesis: Hypothesis
    steps: tuple[float, ...]
    changes: NDArray[np.float32] | None
    by_priors: bool = False

    @property
    def stepped(self) -> list[AppliedEffect]:
        """The effect a step from null in one number after the other; the effect itself where none is free."""
        return [
            self.hypothesis.at({p.name: p.from_coordinate(p.null_coordinate + step)})
            for p, step in zip(self.hypothesis.free, self.steps, strict=False)
        ] or [self.hypothesis.at({})]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(parameter, 2) lowest and highest multiples of the steps from null that keep the free numbers inside their
        bounds."""
        return np.array(
            [
                sorted((end - p.null_coordinate) / step for end in p.coordinate_bounds)
                for p, step in zip(self.hypothesis.free, self.steps, strict=False)
            ]
        )

    def numbers(self, amplitude: NDArray[np.float64]) -> dict[str, float]:
        """The free numbers at multiples of their steps from null, inside their bounds."""
        return {
            p.name: p.from_coordinate(p.null_coordinate + a * step)
            for p, a, step in zip(self.hypothesis.free, amplitude, self.steps, strict=False)
        }


def signature(
    predictor: Predictor, given: Sequence[AppliedEffect], used: NDArray[np.bool_], hypothesis: Hypothesis
) -> Signature | None:
    """Difference pictures at small steps from null, on top of ``given``; None where the effect cannot act here, as a
    gradient across a flat face cannot."""
    known = Signature(hypothesis, tuple(p.coordinate_step for p in hypothesis.free) or (1.0,), None)
    by_priors = all(judged_by_priors(effect, predictor.camera) for effect in known.stepped)
    if by_priors:
        return replace(known, by_priors=True)
    base = predictor.signal(given)
    try:
        changes = [(predictor.signal((*given, effect)) - base)[used] for effect in known.stepped]
    except InputError:
        return None
    if np.max(np.abs(changes)) <= _ROUNDING * np.max(np.abs(base[used])):
        return None
    return replace(known, changes=np.array(changes, np.float32))


def columns_of(problem: FitProblem, known: Signature) -> NDArray[np.float64]:
    """(n + 11, parameter) projected whitened changes by the steps of a signature; one column where none is free."""
    if known.changes is None:
        return np.array([problem.change(effect) for effect in known.stepped]).T
    pairs = zip(known.changes, known.stepped, strict=True)
    return np.array(
        [problem.model.whiten_used(problem.scale * c) + problem.camera_change(effect) for c, effect in pairs]
    ).T


def screen(problem: FitProblem, known: Signature, residual: NDArray[np.float64]) -> Candidate:
    """Fit a hypothesis to a projected residual (n + 11,), to first order. A single number is kept within its bounds."""
    hypothesis = known.hypothesis
    columns = columns_of(problem, known)
    smoothed = np.array([problem.noise_averaging_gain(effect) for effect in known.stepped])
    amplitude, covariance = least_squares(columns, residual, smoothed)
    if not hypothesis.free:
        amplitude = np.ones(1)
    elif len(amplitude) == 1:
        amplitude = np.clip(amplitude, *known.bounds[0])
    numbers = known.numbers(amplitude)
    sigma = {
        p.name: p.deviation(numbers[p.name], abs(step) * float(c**0.5))
        for p, step, c in zip(hypothesis.free, known.steps, np.diag(covariance), strict=False)
    }
    predicted = columns @ amplitude
    left = residual - predicted
    chi2 = float(left @ left + smoothed @ amplitude)
    return Candidate(hypothesis, numbers, sigma, chi2, predicted.astype(np.float32), known.by_priors)


def least_squares(columns: NDArray, residual: NDArray, slope: NDArray) -> tuple[NDArray, NDArray]:
    """The a that minimises |residual - columns a|^2 + slope a, and the inverse of half the second derivatives."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    unit = columns / size
    covariance = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    return covariance @ ((columns.T @ residual - slope / 2) / size) / size, covariance / np.outer(size, size)
