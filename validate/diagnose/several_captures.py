"""Several captures of the same box: effects fitted to all of them, and told apart by all of them.

What the captures share has the same numbers in all: the scene and its light, and filters, lens and sensor where the
camera is the same. A blur's width is in proportion to the aperture. What belongs to one capture (the lamp's power and
its drift, the place of the camera) has numbers of its own in each.
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

from ..compare import Prepared
from .alternatives import SelectedEffect
from .evidence import INDISTINGUISHABLE, penalised, square
from .fitting import fit
from .linear_model import LinearModel
from .linearised_fit import LinearisedFit, residual_with
from .search import Candidate, FitProblem, Problem

__all__ = ["FurtherFit", "JointFit", "JointProblem", "same_camera", "settled"]

#: Effects of these stages are of the box and its light, whatever photographs it.
_OF_THE_BOX = stages_between("scene", "transport")


@dataclass(frozen=True, eq=False)
class _JointModel:
    """The linear models of several captures. Vectors hold all pixels first, then all priors' rows."""

    parts: tuple[LinearModel, ...]

    @property
    def count(self) -> int:
        """Number of used samples."""
        return sum(part.count for part in self.parts)

    @cached_property
    def patch(self) -> NDArray[np.int64]:
        """(n,) number of the patch of its image that a sample lies in; no two captures share one."""
        starts = np.cumsum([0, *(part.patch.max(initial=0) + 1 for part in self.parts)])
        return np.concatenate([part.patch + start for part, start in zip(self.parts, starts, strict=False)])

    @cached_property
    def shared_errors(self) -> NDArray[np.float32]:
        """(rows, m) of all captures; each has its own."""
        blocks = [part.shared_errors for part in self.parts]
        pixels = block_diag(*(b[: p.count] for b, p in zip(blocks, self.parts, strict=True)))
        priors = block_diag(*(b[p.count :] for b, p in zip(blocks, self.parts, strict=True)))
        return np.concatenate([pixels, priors]).astype(np.float32)

    def joined(self, vectors: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """One vector of those of the captures."""
        pairs = list(zip(vectors, self.parts, strict=True))
        return np.concatenate([*(v[: p.count] for v, p in pairs), *(v[p.count :] for v, p in pairs)])

    def split(self, vector: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The captures' own vectors of one."""
        pixels = np.split(vector[: self.count], np.cumsum([part.count for part in self.parts])[:-1])
        priors = np.split(vector[self.count :], len(self.parts))
        return [np.concatenate(pair) for pair in zip(pixels, priors, strict=True)]

    def project(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """What no nuisance of any capture can imitate."""
        return self.joined([p.project(v) for p, v in zip(self.parts, self.split(vector), strict=True)])

    def whiten_used(self, change: NDArray) -> NDArray[np.float64]:
        """A change (n,) at the used pixels of all captures over sigma, projected."""
        each = np.split(change, np.cumsum([part.count for part in self.parts])[:-1])
        return self.joined([p.whiten_used(c) for p, c in zip(self.parts, each, strict=True)])


@dataclass(frozen=True, eq=False)
class JointProblem:
    """What an effect is fitted to in several captures: the sums and joined vectors of their problems.

    apertures : the aperture's diameter in each over that of the first.
    """

    parts: tuple[Problem, ...]
    apertures: tuple[float, ...]

    @cached_property
    def model(self) -> _JointModel:
        """The captures' linear models."""
        return _JointModel(tuple(part.model for part in self.parts))

    @property
    def scale(self) -> float:
        """Changes of whole captures have their own lamps' scale already."""
        return 1.0

    def change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """See ``Problem.change``."""
        return self.model.joined([part.change(there) for part, there in self._in_each(applied)])

    def camera_change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """See ``Problem.camera_change``."""
        return self.model.joined([part.camera_change(there) for part, there in self._in_each(applied)])

    def noise_averaging_gain(self, applied: AppliedEffect) -> float:
        """See ``Problem.noise_averaging_gain``."""
        return sum(part.noise_averaging_gain(there) for part, there in self._in_each(applied))

    def _in_each(self, applied: AppliedEffect) -> list[tuple[Problem, AppliedEffect]]:
        each = (applied.at_aperture(aperture) for aperture in self.apertures)
        return list(zip(self.parts, each, strict=True))


@dataclass(frozen=True, eq=False)
class JointFit:
    """Several captures, each with its picture linearised about its camera and lamp.

    apertures : the aperture's diameter in each over that of the first.
    """

    parts: tuple[LinearisedFit, ...]
    apertures: tuple[float, ...]

    @classmethod
    def of(cls, parts: Sequence[LinearisedFit], prepared: Sequence[Prepared]) -> JointFit:
        """prepared : the captures of the parts. Raises InputError for no capture at all."""
        if not parts:
            raise InputError("fit", "no capture", "one capture or several")
        diameters = [_f_number(p.calibration.capture) for p in prepared]
        return cls(tuple(parts), tuple(diameters[0] / f_number for f_number in diameters))

    def problem(self, chosen: Sequence[Candidate]) -> FitProblem:
        """See ``LinearisedFit.problem``."""
        if len(self.parts) == 1:
            return self.parts[0].problem(chosen)
        parts = tuple(part.problem(there) for part, there in self._in_each(chosen))
        return JointProblem(parts, self.apertures)

    def residual_with(self, chosen: Sequence[Candidate]) -> NDArray[np.float64]:
        """The projected residuals of all captures with these effects in place."""
        joint = _JointModel(tuple(part.model for part in self.parts))
        return joint.joined([residual_with(part, there) for part, there in self._in_each(chosen)])

    def _in_each(self, chosen: Sequence[Candidate]) -> list[tuple[LinearisedFit, list[Candidate]]]:
        each = ([c.at_aperture(aperture) for c in chosen] for aperture in self.apertures)
        return list(zip(self.parts, each, strict=True))


def _f_number(capture: Capture) -> float:
    """The f-number of the first band; 1 where none is stated."""
    return capture.manifest.band[0].f_number or 1.0


def same_camera(one: Capture, other: Capture) -> bool:
    """Whether two captures state the same sensor, lens and filters. Gain and noise, often measured, may differ."""

    def stated(capture: Capture) -> tuple[object, ...]:
        m = capture.manifest
        sensor = m.camera.model, *capture.shape, m.camera.bit_depth, m.camera.pixel_pitch_um
        filters = sorted((band.id, band.transmittance or "") for band in m.band)
        return *sensor, m.lens.focal_length_mm, *filters

    return stated(one) == stated(other)


@dataclass(frozen=True, eq=False)
class FurtherFit:
    """A further capture, its picture linearised with the effects found. camera_shared : see ``same_camera``."""

    prepared: Prepared
    linearised: LinearisedFit
    camera_shared: bool

    def shares(self, effect: Effect) -> bool:
        """Whether an effect has the same numbers here as in the first capture."""
        return not effect.own_to_capture and (self.camera_shared or effect.stage in _OF_THE_BOX)


def settled(
    prepared: Prepared,
    linearised: LinearisedFit,
    known: Sequence[SelectedEffect],
    further: Sequence[FurtherFit],
) -> list[SelectedEffect]:
    """Every selected effect and its alternatives fitted to all captures, the best one in its place.

    Effects in the model before, and the other selected ones, stay. Chi2 and its samples are those of all captures.
    """
    current = list(known)
    for index, one in enumerate(known):
        others = [c.candidate for i, c in enumerate(current) if i != index]
        tried = [_in_all(prepared, linearised, further, others, c) for c in (one.candidate, *one.alternatives)]
        best, *rest = sorted(tried, key=penalised)
        without = _chi2_without(linearised, others) + sum(_chi2_without(f.linearised, others) for f in further)
        count = linearised.model.count + sum(f.linearised.model.count for f in further)
        current[index] = replace(one, candidate=best, alternatives=tuple(rest), chi2_without=without, count=count)
    return current


def _chi2_without(linearised: LinearisedFit, others: Sequence[Candidate]) -> float:
    return square(linearised.problem(others).model.project(residual_with(linearised, others)))


def _in_all(
    prepared: Prepared,
    linearised: LinearisedFit,
    further: Sequence[FurtherFit],
    others: Sequence[Candidate],
    candidate: Candidate,
) -> Candidate:
    """An effect fitted to the captures that share its numbers, and to each of the others by itself."""
    sharing = [f for f in further if f.shares(candidate.hypothesis.effect)]
    joint = JointFit.of([linearised, *(f.linearised for f in sharing)], [prepared, *(f.prepared for f in sharing)])
    found = fit(joint.problem(others), candidate, joint.residual_with(others))
    apart = [_by_itself(f.linearised, others, candidate) for f in further if f not in sharing]
    return replace(found, chi2=found.chi2 + sum(apart), predicted=candidate.predicted)


def _by_itself(linearised: LinearisedFit, others: Sequence[Candidate], candidate: Candidate) -> float:
    """Chi2 of one capture with numbers of its own, where they gain more than chance gives them; else without."""
    without = _chi2_without(linearised, others)
    own = fit(linearised.problem(others), candidate, residual_with(linearised, others))
    return min(without, own.chi2 + INDISTINGUISHABLE * len(candidate.hypothesis.free))
