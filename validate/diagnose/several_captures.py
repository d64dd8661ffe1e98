"""Several captures of the same box: joint fits of effects, and distinction by all captures.

Some effects have the same numbers in all captures: those on the scene and its light, and those on filters, lens and
sensor where the camera is the same. A blur's width is proportional to the aperture. What belongs to one capture has
separate numbers in each: the lamp's power and its drift, the camera's pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.effects import AppliedEffect, Effect
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ..compare import CalibratedCapture, Validation
from .alternatives import SelectedEffect
from .evidence import penalised, something_remains, square
from .fitting import fit
from .hypotheses import INDISTINGUISHABLE_CHI2
from .linear_model import LinearModel
from .linearised_fit import LinearisedFit, linearised_fit, residual_with, residual_with_rendered
from .search import Candidate, FitProblem, Problem
from .stepwise import refitted

__all__ = [
    "FurtherCaptureResult",
    "FurtherFit",
    "JointFit",
    "JointProblem",
    "further_fit",
    "further_result",
    "refitted_to_all",
    "same_camera",
]

#: Stages whose effects belong to the box and its light, whatever photographs it.
_OF_THE_BOX = stages_between("scene", "transport")


@dataclass(frozen=True, eq=False)
class _JointModel:
    """Linear models of several captures; vectors hold all samples first, then all priors' rows."""

    #: Linear model of each capture.
    parts: tuple[LinearModel, ...]

    @property
    def count(self) -> int:
        """Number of used samples of all captures."""
        return sum(part.count for part in self.parts)

    @cached_property
    def patch(self) -> NDArray[np.int64]:
        """(n,) number of the image patch that a sample lies in; no two captures share one."""
        starts = np.cumsum([0, *(part.patch.max(initial=0) + 1 for part in self.parts)])
        return np.concatenate([part.patch + start for part, start in zip(self.parts, starts, strict=False)])

    @cached_property
    def shared_errors(self) -> NDArray[np.float32]:
        """(rows, m) shared errors of all captures; none is shared between captures."""
        blocks = [part.shared_errors for part in self.parts]
        pixels = block_diag(*(b[: p.count] for b, p in zip(blocks, self.parts, strict=True)))
        priors = block_diag(*(b[p.count :] for b, p in zip(blocks, self.parts, strict=True)))
        return np.concatenate([pixels, priors]).astype(np.float32)

    def joined(self, vectors: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """One vector from those of the captures."""
        pairs = list(zip(vectors, self.parts, strict=True))
        return np.concatenate([*(v[..., : p.count] for v, p in pairs), *(v[..., p.count :] for v, p in pairs)], axis=-1)

    def split(self, vector: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The captures' vectors from a joined one."""
        pixels = np.split(vector[: self.count], np.cumsum([part.count for part in self.parts])[:-1])
        rows = [len(part.residual) - part.count for part in self.parts]
        priors = np.split(vector[self.count :], np.cumsum(rows)[:-1])
        return [np.concatenate(pair) for pair in zip(pixels, priors, strict=True)]

    def project(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """The part of a joined vector that no nuisance of any capture can imitate."""
        return self.joined([p.project(v) for p, v in zip(self.parts, self.split(vector), strict=True)])

    def whiten_used(self, change: NDArray) -> NDArray[np.float64]:
        """Changes (..., n) at the used samples of all captures over sigma, projected."""
        each = np.split(change, np.cumsum([part.count for part in self.parts])[:-1], axis=-1)
        return self.joined([p.whiten_used(c) for p, c in zip(self.parts, each, strict=True)])


@dataclass(frozen=True, eq=False)
class JointProblem:
    """The problem of a further effect in several captures at once."""

    #: Problem of each capture.
    parts: tuple[Problem, ...]
    #: The aperture's diameter in each capture over that of the first.
    apertures: tuple[float, ...]

    @cached_property
    def model(self) -> _JointModel:
        """The captures' linear models, joined."""
        return _JointModel(tuple(part.model for part in self.parts))

    @property
    def scale(self) -> float:
        """Changes of whole captures already hold their lamps' scales."""
        return 1.0

    def change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """Projected change of all captures by an effect, see `Problem.change`.

        Parameters
        ----------
        applied
            Effect with its numbers in the first capture.

        Returns
        -------
        NDArray
            (rows,) joined, over sigma.
        """
        return self.model.joined([part.change(scaled) for part, scaled in self._in_each(applied)])

    def camera_change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """Projected change of all captures by an effect on the camera, see `Problem.camera_change`.

        Parameters
        ----------
        applied
            Effect with its numbers in the first capture.

        Returns
        -------
        NDArray
            (rows,) joined, over sigma.
        """
        return self.model.joined([part.camera_change(scaled) for part, scaled in self._in_each(applied)])

    def noise_averaging_gain(self, applied: AppliedEffect) -> float:
        """Chi2 gained by averaging the renderings' noise, see `Problem.noise_averaging_gain`.

        Parameters
        ----------
        applied
            Effect with its numbers in the first capture.

        Returns
        -------
        float
            Sum over the captures.
        """
        return sum(part.noise_averaging_gain(scaled) for part, scaled in self._in_each(applied))

    def _in_each(self, applied: AppliedEffect) -> list[tuple[Problem, AppliedEffect]]:
        """Each capture's problem with the effect at its aperture."""
        each = (applied.at_aperture(aperture) for aperture in self.apertures)
        return list(zip(self.parts, each, strict=True))


@dataclass(frozen=True, eq=False)
class JointFit:
    """Several captures, each with its picture linearised about its camera and lamp."""

    #: Linearised fit of each capture.
    parts: tuple[LinearisedFit, ...]
    #: The aperture's diameter in each capture over that of the first.
    apertures: tuple[float, ...]

    @classmethod
    def of(cls, parts: Sequence[LinearisedFit], prepared: Sequence[CalibratedCapture]) -> JointFit:
        """Joint fit of captures.

        Parameters
        ----------
        parts
            Linearised fit of each capture.
        prepared
            The captures, in the same order; their f-numbers count.

        Returns
        -------
        JointFit
            With apertures relative to the first capture's.

        Raises
        ------
        InputError
            Without a capture.
        """
        if not parts:
            raise InputError("fit", "no capture", "one capture or several")
        diameters = [_f_number(p.calibration.capture) for p in prepared]
        return cls(tuple(parts), tuple(diameters[0] / f_number for f_number in diameters))

    def problem(self, selected: Sequence[Candidate]) -> FitProblem:
        """The problem of a further effect with selected ones in place, see `LinearisedFit.problem`.

        Parameters
        ----------
        selected
            Candidates with their numbers in the first capture.

        Returns
        -------
        FitProblem
            `Problem` of a single capture, `JointProblem` of several.
        """
        if len(self.parts) == 1:
            return self.parts[0].problem(selected)
        parts = tuple(part.problem(scaled) for part, scaled in self._in_each(selected))
        return JointProblem(parts, self.apertures)

    def residual_with(self, selected: Sequence[Candidate]) -> NDArray[np.float64]:
        """Projected residuals of all captures with selected effects in place.

        Parameters
        ----------
        selected
            Candidates with their numbers in the first capture.

        Returns
        -------
        NDArray
            (rows,) joined, over sigma.
        """
        joint = _JointModel(tuple(part.model for part in self.parts))
        return joint.joined([residual_with(part, scaled) for part, scaled in self._in_each(selected)])

    def _in_each(self, selected: Sequence[Candidate]) -> list[tuple[LinearisedFit, list[Candidate]]]:
        """Each capture's fit with the candidates at its aperture."""
        each = ([c.at_aperture(aperture) for c in selected] for aperture in self.apertures)
        return list(zip(self.parts, each, strict=True))


def _f_number(capture: Capture) -> float:
    """The f-number of the first band; 1 where none is stated."""
    return capture.manifest.band[0].f_number or 1.0


def same_camera(capture: Capture, other: Capture) -> bool:
    """Whether two captures state the same sensor, lens and filters.

    Gain and noise may differ, since they are often measured.

    Parameters
    ----------
    capture
        One capture.
    other
        The other capture.

    Returns
    -------
    bool
        By the statements of their manifests.
    """

    def camera_of(item: Capture) -> tuple[object, ...]:
        m = item.manifest
        sensor = m.camera.model, *item.shape, m.camera.bit_depth, m.camera.pixel_pitch_um
        filters = sorted((band.id, band.transmittance or "") for band in m.band)
        return *sensor, m.lens.focal_length_mm, *filters

    return camera_of(capture) == camera_of(other)


@dataclass(frozen=True)
class FurtherCaptureResult:
    """Result for a further capture of the box."""

    #: Name of its folder.
    capture: str
    #: Whether it states the same sensor, lens and filters.
    same_camera: bool
    #: Chi2 per sample of the model as given.
    chi2_per_dof: float
    #: Chi2 per sample with the selected effects.
    final_chi2_per_dof: float
    #: Whether nothing remains that the effects do not explain.
    adequate: bool


@dataclass(frozen=True, eq=False)
class FurtherFit:
    """A further capture, its picture linearised with the effects selected in the first one."""

    #: The calibrated capture.
    prepared: CalibratedCapture
    #: Its linearised fit.
    linearised: LinearisedFit
    #: Whether camera, lens and filters are those of the first capture, see `same_camera`.
    camera_shared: bool

    def shares(self, effect: Effect) -> bool:
        """Whether an effect has the same numbers here as in the first capture.

        Parameters
        ----------
        effect
            Effect of the catalogue.

        Returns
        -------
        bool
            False for effects that belong to one capture, and for the camera's where it is another one.
        """
        return not effect.own_to_capture and (self.camera_shared or effect.stage in _OF_THE_BOX)


def refitted_to_all(
    prepared: CalibratedCapture,
    linearised: LinearisedFit,
    assessed: Sequence[SelectedEffect],
    further: Sequence[FurtherFit],
) -> list[SelectedEffect]:
    """Selected effects and their alternatives fitted to all captures, the best one in front.

    Effects in the model before, and the other selected ones, stay.

    Parameters
    ----------
    prepared
        The first capture.
    linearised
        Its linearised fit.
    assessed
        Selected effects with their alternatives.
    further
        The further captures.

    Returns
    -------
    list of SelectedEffect
        With chi2 and number of samples of all captures.
    """
    current = list(assessed)
    for index, effect in enumerate(assessed):
        others = [c.candidate for i, c in enumerate(current) if i != index]
        refitted = [
            _fitted_to_all(prepared, linearised, further, others, c) for c in (effect.candidate, *effect.alternatives)
        ]
        best, *rest = sorted(refitted, key=penalised)
        without = _chi2_without(linearised, others) + sum(_chi2_without(f.linearised, others) for f in further)
        count = linearised.model.count + sum(f.linearised.model.count for f in further)
        current[index] = replace(effect, candidate=best, alternatives=tuple(rest), chi2_without=without, count=count)
    return current


def _chi2_without(linearised: LinearisedFit, others: Sequence[Candidate]) -> float:
    """Chi2 of one capture with the other effects alone."""
    return square(linearised.problem(others).model.project(residual_with(linearised, others)))


def _fitted_to_all(
    prepared: CalibratedCapture,
    linearised: LinearisedFit,
    further: Sequence[FurtherFit],
    others: Sequence[Candidate],
    candidate: Candidate,
) -> Candidate:
    """An effect fitted to all captures that share its numbers, and to the others separately."""
    sharing = [f for f in further if f.shares(candidate.hypothesis.effect)]
    joint = JointFit.of([linearised, *(f.linearised for f in sharing)], [prepared, *(f.prepared for f in sharing)])
    fitted = fit(joint.problem(others), candidate, joint.residual_with(others))
    separate_chi2 = [_separate_chi2(f.linearised, others, candidate) for f in further if f not in sharing]
    return replace(fitted, chi2=fitted.chi2 + sum(separate_chi2), predicted=candidate.predicted)


def _separate_chi2(linearised: LinearisedFit, others: Sequence[Candidate], candidate: Candidate) -> float:
    """Chi2 of a capture with separate numbers where they gain more than chance, else without."""
    without = _chi2_without(linearised, others)
    fitted = fit(linearised.problem(others), candidate, residual_with(linearised, others))
    return min(without, fitted.chi2 + INDISTINGUISHABLE_CHI2 * len(candidate.hypothesis.free))


def further_fit(validation: Validation, other: Validation, effects: Sequence[Candidate]) -> FurtherFit:
    """Another capture's picture, rendered and linearised with the first one's effects.

    Parameters
    ----------
    validation
        Validation of the first capture.
    other
        Validation of the further one.
    effects
        Effects selected in the first.

    Returns
    -------
    FurtherFit
        The further capture's linearised fit.
    """
    plain = linearised_fit(other.prepared, other.rendered, other.model.effects)
    linearised = refitted(other, plain, effects) if effects else plain
    captures = (v.prepared.calibration.capture for v in (validation, other))
    return FurtherFit(other.prepared, linearised, same_camera(*captures))


def further_result(other: Validation, fit: FurtherFit, effects: Sequence[Candidate]) -> FurtherCaptureResult:
    """Comparison of a further capture with the model as given and with the selected effects.

    Parameters
    ----------
    other
        Validation of the further capture.
    fit
        Its linearised fit.
    effects
        The selected effects.

    Returns
    -------
    FurtherCaptureResult
        Its chi2 before and after.
    """
    linearised = fit.linearised
    before, residual = linearised.model.residual, residual_with(linearised, effects)
    rendered = residual_with_rendered(linearised, effects)
    return FurtherCaptureResult(
        capture=other.prepared.calibration.capture.folder.name,
        same_camera=fit.camera_shared,
        chi2_per_dof=square(before) / linearised.model.count,
        final_chi2_per_dof=square(residual) / linearised.model.count,
        adequate=not something_remains(linearised.model, residual, rendered),
    )
