"""Screening of hypotheses to first order, and the problem that a full fit solves.

Vectors (n + 11,) hold the n used samples over sigma, then the rows of the priors; see `linear_model`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Protocol

import numpy as np
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.effects import AppliedEffect, Parameter
from cboxlab.rendering.model import displacement, with_further_distortion
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..compare import CalibratedCapture, Nuisances
from ..predict import Predictor
from .hypotheses import Hypothesis
from .linear_model import LinearModel

__all__ = [
    "Candidate",
    "FitModel",
    "FitProblem",
    "NumberStep",
    "Problem",
    "Signature",
    "build_problem",
    "by_signature",
    "column_batches",
    "judged_by_priors",
    "least_squares",
    "screen",
    "signature",
    "steps_of",
    "unknown_notes",
    "without_imitated",
]


#: Share of an effect's chi2 that free factors leave, below which it is no candidate: ten times its size would be needed
#: for the evidence that it otherwise gives.
_MIN_LEFT_SHARE = 0.01

#: Numerics: largest change of the picture that counts as rounding, relative to the largest signal used.
_ROUNDING = 1e-9


#: Numerics: signatures whose columns are whitened at once: one by one each column takes four times as long, since the
#: bases are read for each; more of them do not fit the cache.
_SIGNATURES_AT_ONCE = 4


@dataclass(frozen=True, eq=False)
class Candidate(FrozenMappings):
    """A hypothesis with numbers, and how well it fits."""

    #: The hypothesis.
    hypothesis: Hypothesis
    #: By parameter, the fitted numbers, in their units.
    numbers: Mapping[str, float]
    #: By parameter, their standard deviations.
    sigma: Mapping[str, float]
    #: Chi2 of the capture, minimised over the nuisances.
    chi2: float
    #: (n + 11,) projected change that the effect makes, over sigma; in single precision once it is judged, since there
    #: is one for every effect.
    predicted: NDArray[np.floating]
    #: Whether only priors speak against it, see `judged_by_priors`.
    by_priors: bool = False

    @property
    def applied(self) -> AppliedEffect:
        """The effect with its fitted numbers."""
        return self.hypothesis.at(self.numbers)

    def at_aperture(self, factor: float) -> Candidate:
        """The candidate at another aperture, to which a blur's width is proportional.

        Parameters
        ----------
        factor
            On the aperture's diameter.

        Returns
        -------
        Candidate
            With its numbers changed.
        """
        values = self.applied.at_aperture(factor).values
        return replace(self, numbers={name: float(values[name]) for name in self.numbers})


@dataclass(frozen=True, eq=False)
class NumberStep:
    """A small step of one number."""

    #: The number's parameter.
    parameter: Parameter
    #: Step in the coordinate of the parameter's scale; negative at its upper bound.
    size: float
    #: The candidate with its number changed; chi2, sigma and predicted change are those before the step.
    after: Candidate


def steps_of(candidate: Candidate) -> list[NumberStep]:
    """A step of each of a candidate's numbers, inside its bounds.

    Parameters
    ----------
    candidate
        Candidate with numbers.

    Returns
    -------
    list of NumberStep
        The parameter's own step, or a tenth of the distance from null where that is larger.
    """
    steps = []
    for p in candidate.hypothesis.effect.numbers:
        if p.name in candidate.numbers:
            coordinate, (_, high) = p.to_coordinate(candidate.numbers[p.name]), p.coordinate_bounds
            from_null = 0.0 if p.null is None else abs(coordinate - p.null_coordinate)
            size = max(abs(p.coordinate_step), 0.1 * from_null)
            size = size if coordinate + size <= high else -size
            numbers = {**candidate.numbers, p.name: p.from_coordinate(coordinate + size)}
            steps.append(NumberStep(p, size, replace(candidate, numbers=numbers)))
    return steps


def _in_picture(applied: AppliedEffect, camera: Camera) -> bool:
    """Whether an effect changes the picture otherwise than by the camera's ten parameters."""
    return applied.effect.stage != "camera" or with_further_distortion(camera, (applied,)) is not camera


def judged_by_priors(applied: AppliedEffect, camera: Camera) -> bool:
    """Whether the fit of camera and lamp can do all that an effect does to the picture.

    Then only the priors speak against it: the survey, and the lamp's stated power.

    Parameters
    ----------
    applied
        Effect with its numbers.
    camera
        Camera of the picture.

    Returns
    -------
    bool
        True for effects on the lamp's power, and for those that the ten camera parameters imitate.
    """
    return applied.effect.imitates_lamp_power or not _in_picture(applied, camera)


class FitModel(Protocol):
    """Interface of the linear model of one capture, or of several, as a fit needs it."""

    @property
    def count(self) -> int: ...
    @property
    def patch(self) -> NDArray[np.int64]: ...
    @property
    def shared_errors(self) -> NDArray[np.float32]: ...
    def project(self, vector: NDArray[np.float64], /) -> NDArray[np.float64]: ...
    def whiten_used(self, change: NDArray, /) -> NDArray[np.float64]: ...


class FitProblem(Protocol):
    """Interface of a problem in one capture (`Problem`) or in several (`JointProblem`)."""

    @property
    def model(self) -> FitModel: ...
    @property
    def scale(self) -> float: ...
    def change(self, applied: AppliedEffect, /) -> NDArray[np.float64]: ...
    def camera_change(self, applied: AppliedEffect, /) -> NDArray[np.float64]: ...
    def noise_averaging_gain(self, applied: AppliedEffect, /) -> float: ...


@dataclass(frozen=True, eq=False)
class Problem:
    """One capture with the effects already in its model, to which a further effect is fitted."""

    #: Predictor of the picture as the fitted camera sees it.
    predictor: Predictor
    #: Linear model in which changes are whitened and projected.
    model: LinearModel
    #: Effects already in the model, its given ones included.
    others: tuple[AppliedEffect, ...]
    #: Fitted factor on the lamp's power.
    scale: float
    #: (band, y, x) signal predicted with the others, DN.
    base: NDArray[np.float64]
    #: (band, y, x) DN before optics, a draw of the rendering's Monte Carlo error.
    noise: NDArray[np.float64]

    def change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """Projected change that an effect makes on top of the others.

        Parameters
        ----------
        applied
            Effect with its numbers; an InputError is raised where it cannot act.

        Returns
        -------
        NDArray
            (n + 11,) over sigma.
        """
        if not _in_picture(applied, self.predictor.camera):
            return self.camera_change(applied)
        picture = self.scale * (self.predictor.signal((*self.others, applied)) - self.base)
        if applied.effect.imitates_lamp_power:
            return self.model.lamp_change(picture)
        return self.model.whiten(picture) + self.camera_change(applied)

    def camera_change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """The part of `change` that an effect makes by changing the camera's ten parameters.

        Parameters
        ----------
        applied
            Effect with its numbers.

        Returns
        -------
        NDArray
            (n + 11,) over sigma; 0 for an effect that does not act on the camera.
        """
        if applied.stage != "camera":
            return np.zeros_like(self.model.residual)
        return self.model.camera_change(displacement(self.predictor.camera, self.others, (applied,)))

    def noise_averaging_gain(self, *applied: AppliedEffect) -> float:
        """Chi2 that effects gain by averaging the rendering's noise, as a blur does in any picture.

        Where they make all signals brighter, the lamp's fit makes signals and noise as much darker again.

        Parameters
        ----------
        *applied
            Effects that act together.

        Returns
        -------
        float
            Chi2; 0 where none acts from the optics to the counts.
        """
        if not any(effect.stage in stages_between("optics", "counts") for effect in applied):
            return 0.0
        (signal, noise), (altered, altered_noise) = self._without, self._with(*applied)
        brighter = (signal @ altered) / (signal @ signal)
        return float(noise @ noise - altered_noise @ altered_noise / brighter**2)

    @cached_property
    def _without(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._with()

    def _with(self, *applied: AppliedEffect) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) over sigma each: signals and their noise with further effects."""
        both = self.predictor.signal_and_noise((*self.others, *applied), self.noise)
        signal, noise = (self.scale * part[self.model.used] / self.model.sigma for part in both)
        return signal, noise


def build_problem(
    predictor: Predictor, model: LinearModel, others: Sequence[AppliedEffect], scale: float, variance: NDArray
) -> Problem:
    """The problem of a further effect, with a draw of the rendering's noise.

    Parameters
    ----------
    predictor
        Predictor of the picture; its seed repeats the draw.
    model
        Linear model of the capture.
    others
        Effects already in the model.
    scale
        Fitted factor on the lamp's power.
    variance
        (band, y, x) variance by the rendering's Monte Carlo error, DN^2.

    Returns
    -------
    Problem
        With the signal predicted under the others.
    """
    draw = np.random.default_rng(predictor.settings.seed).standard_normal(variance.shape)
    return Problem(predictor, model, tuple(others), scale, predictor.signal(others), np.sqrt(variance) * draw)


@dataclass(frozen=True, eq=False)
class Signature:
    """Changes of the picture by small steps of a hypothesis' free numbers."""

    #: The hypothesis.
    hypothesis: Hypothesis
    #: (parameter,) steps from null, in the coordinates of the parameters' scales.
    steps: tuple[float, ...]
    #: (parameter, n) DN at the used samples. None where the priors judge the hypothesis: what camera and lamp leave of
    #: it is so little that it is computed again with the effects in the model (`Problem.change`).
    changes: NDArray[np.float32] | None
    #: Whether only priors speak against it, see `judged_by_priors`.
    by_priors: bool = False

    @property
    def stepped(self) -> list[AppliedEffect]:
        """The effect a step from null in one number after the other; as it is where none is free."""
        return [
            self.hypothesis.at({p.name: p.from_coordinate(p.null_coordinate + step)})
            for p, step in zip(self.hypothesis.free, self.steps, strict=False)
        ] or [self.hypothesis.at({})]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(parameter, 2) multiples of the steps between which the free numbers keep their bounds."""
        return np.array(
            [
                sorted((end - p.null_coordinate) / step for end in p.coordinate_bounds)
                for p, step in zip(self.hypothesis.free, self.steps, strict=False)
            ]
        )

    def numbers(self, amplitude: NDArray[np.float64]) -> dict[str, float]:
        """The free numbers at multiples of their steps from null, clipped to their bounds.

        Parameters
        ----------
        amplitude
            (parameter,) multiples of the steps.

        Returns
        -------
        dict
            Numbers by parameter, in their units.
        """
        return {
            p.name: p.from_coordinate(p.null_coordinate + a * step)
            for p, a, step in zip(self.hypothesis.free, amplitude, self.steps, strict=False)
        }


def signature(
    predictor: Predictor, model_effects: Sequence[AppliedEffect], used: NDArray[np.bool_], hypothesis: Hypothesis
) -> Signature | None:
    """Differences of pictures at small steps from null, on top of the model's effects.

    Parameters
    ----------
    predictor
        Predictor of the picture, usually one of few rays.
    model_effects
        Effects of the model.
    used
        (band, y, x) whether a sample is used.
    hypothesis
        Hypothesis whose free numbers are stepped.

    Returns
    -------
    Signature or None
        None where the effect cannot act here, or changes no more than rounding does.
    """
    without_changes = Signature(hypothesis, tuple(p.coordinate_step for p in hypothesis.free) or (1.0,), None)
    by_priors = all(judged_by_priors(effect, predictor.camera) for effect in without_changes.stepped)
    if by_priors:
        return replace(without_changes, by_priors=True)
    base = predictor.signal(model_effects)
    try:
        changes = [(predictor.signal((*model_effects, effect)) - base)[used] for effect in without_changes.stepped]
    except InputError:
        return None
    if np.max(np.abs(changes)) <= _ROUNDING * np.max(np.abs(base[used])):
        return None
    return replace(without_changes, changes=np.array(changes, np.float32))


def column_batches(
    problem: FitProblem, signatures: Sequence[Signature]
) -> Iterator[tuple[list[Signature], NDArray[np.float64]]]:
    """A few signatures at a time, and the projected changes by their steps.

    Parameters
    ----------
    problem
        One capture, or several.
    signatures
        Signatures, their changes at the lamp's stated power.

    Yields
    ------
    list of Signature
        Some of the signatures, in order.
    NDArray
        (column, n + 11) over sigma, one row for each of their steps; one for a signature without a free number.
    """
    for by_priors, alike in groupby(signatures, lambda each: each.changes is None):
        members = list(alike)
        for start in range(0, len(members), _SIGNATURES_AT_ONCE):
            some = members[start : start + _SIGNATURES_AT_ONCE]
            effects = [effect for each in some for effect in each.stepped]
            if by_priors:
                yield some, np.array([problem.change(effect) for effect in effects])
                continue
            unscaled = np.concatenate([each.changes for each in some])
            columns = problem.model.whiten_used(problem.scale * unscaled)
            for column, effect in zip(columns, effects, strict=True):
                column += problem.camera_change(effect)
            yield some, columns


def by_signature(signatures: Sequence[Signature], columns: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The columns of each of several signatures.

    Parameters
    ----------
    signatures
        The signatures.
    columns
        (column, n + 11) as of `column_batches`.

    Returns
    -------
    list of NDArray
        (n + 11, parameter) for each signature.
    """
    ends = np.cumsum([len(each.steps) for each in signatures])[:-1]
    return [rows.T for rows in np.split(columns, ends)]


def screen(problem: FitProblem, signatures: Sequence[Signature], residual: NDArray[np.float64]) -> Iterator[Candidate]:
    """Fit hypotheses to a projected residual, each alone, to first order.

    A single number is clipped to its bounds; several are not.

    Parameters
    ----------
    problem
        One capture, or several.
    signatures
        Signatures of the hypotheses.
    residual
        (n + 11,) projected, over sigma.

    Yields
    ------
    Candidate
        With numbers, standard deviations by noise alone, and chi2 to first order.
    """
    for some, columns in column_batches(problem, signatures):
        for steps, of_one in zip(some, by_signature(some, columns), strict=True):
            yield _screened(problem, steps, of_one, residual)


def _screened(problem: FitProblem, steps: Signature, columns: NDArray, residual: NDArray[np.float64]) -> Candidate:
    """Fit of one hypothesis, see `screen`.

    columns : (n + 11, parameter) those of its signature.
    """
    hypothesis = steps.hypothesis
    smoothed = np.array([problem.noise_averaging_gain(effect) for effect in steps.stepped])
    amplitude, covariance = least_squares(columns, residual, smoothed)
    if not hypothesis.free:
        amplitude = np.ones(1)
    elif len(amplitude) == 1:
        amplitude = np.clip(amplitude, *steps.bounds[0])
    numbers = steps.numbers(amplitude)
    sigma = {
        p.name: p.deviation(numbers[p.name], abs(step) * float(c**0.5))
        for p, step, c in zip(hypothesis.free, steps.steps, np.diag(covariance), strict=False)
    }
    predicted = columns @ amplitude
    remainder = residual - predicted
    chi2 = float(remainder @ remainder + smoothed @ amplitude)
    return Candidate(hypothesis, numbers, sigma, chi2, predicted.astype(np.float32), steps.by_priors)


def least_squares(columns: NDArray, residual: NDArray, slope: NDArray) -> tuple[NDArray, NDArray]:
    """Amplitudes a that minimise |residual - columns a|^2 + slope a.

    Columns are scaled to unit size and inverted with a relative cutoff of 1e-10, so that equal columns share an
    amplitude.

    Parameters
    ----------
    columns
        (n, parameter) changes by a unit of each amplitude.
    residual
        (n,) over sigma.
    slope
        (parameter,) chi2 that a unit of each amplitude costs in addition.

    Returns
    -------
    amplitude : NDArray
        (parameter,) amplitudes.
    covariance : NDArray
        (parameter, parameter) inverse of half the second derivatives.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    unit = columns / size
    covariance = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    return covariance @ ((columns.T @ residual - slope / 2) / size) / size, covariance / np.outer(size, size)


def without_imitated(
    model: LinearModel, free_changes: Sequence[NDArray[np.float64]] | None, signatures: Sequence[Signature]
) -> tuple[list[Signature], tuple[str, ...]]:
    """Signatures that free factors of the capture do not imitate.

    Parameters
    ----------
    model
        Linear model of the capture.
    free_changes
        (n,) DN each, changes by free factors and fall-off; None with an absolute scale and flats.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    list of Signature
        The others; all of them for a capture with an absolute scale and flats.
    tuple of str
        Identifiers of the effects left out, in order.
    """
    if free_changes is None:
        return list(signatures), ()
    lamp_is_free = model.priors[Nuisances.of_lamp, Nuisances.of_lamp] == 0
    changes = (model.by_lamp, *free_changes) if lamp_is_free else free_changes
    factors = np.array([change / model.sigma for change in changes]).T
    basis = np.linalg.qr(factors / np.linalg.norm(factors, axis=0))[0]
    others: list[Signature] = []
    imitated: dict[str, None] = {}
    for signature in signatures:
        of_lamp = lamp_is_free and signature.hypothesis.effect.imitates_lamp_power
        if of_lamp or _is_imitated(basis, signature, model.sigma):
            imitated[signature.hypothesis.effect.id] = None
        else:
            others.append(signature)
    still = {signature.hypothesis.effect.id for signature in others}
    return others, tuple(effect for effect in imitated if effect not in still)


def _is_imitated(basis: NDArray[np.float64], signature: Signature, sigma: NDArray[np.float64]) -> bool:
    """Whether free factors make all changes of a signature, but for a small share."""
    if signature.changes is None or not len(signature.changes):
        return False
    changes = np.asarray(signature.changes, float) / sigma
    remainder = changes - (changes @ basis) @ basis.T
    sizes = np.sum(changes**2, axis=1)
    return bool(np.all(np.sum(remainder**2, axis=1) <= _MIN_LEFT_SHARE * np.maximum(sizes, 1e-300)))


def unknown_notes(prepared: CalibratedCapture, imitated: Sequence[str]) -> tuple[str, ...]:
    """Notes on what references, flats and darks would have shown; none with all of them.

    Parameters
    ----------
    prepared
        The calibrated capture.
    imitated
        Identifiers of the effects that its free scale or fall-off imitates.

    Returns
    -------
    tuple[str, ...]
        At most one for the scale, with the effects, and one for the darks.
    """
    notes = prepared.unknown_sentences
    if not imitated or not notes:
        return notes
    effects = f" Effects that do the same to the picture are no candidates: {', '.join(imitated)}."
    return (notes[0] + effects, *notes[1:])
