"""One fit of effects to several captures of the same box: their residuals and what effects change, joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ..effects import AppliedEffect
from .linear_model import LinearModel
from .linearised_fit import LinearisedFit, residual_with
from .search import Candidate, FitProblem, Problem

__all__ = ["JointFit", "JointProblem"]


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
    """What an effect is fitted to in several captures: the sums and joined vectors of their problems."""

    parts: tuple[Problem, ...]

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
        return self.model.joined([part.change(applied) for part in self.parts])

    def camera_change(self, applied: AppliedEffect) -> NDArray[np.float64]:
        """See ``Problem.camera_change``."""
        return self.model.joined([part.camera_change(applied) for part in self.parts])

    def noise_averaging_gain(self, applied: AppliedEffect) -> float:
        """See ``Problem.noise_averaging_gain``."""
        return sum(part.noise_averaging_gain(applied) for part in self.parts)


@dataclass(frozen=True, eq=False)
class JointFit:
    """Several captures, each with its picture linearised about its camera and lamp."""

    parts: tuple[LinearisedFit, ...]

    @classmethod
    def of(cls, parts: Sequence[LinearisedFit]) -> JointFit:
        """Raises InputError for no capture at all."""
        if not parts:
            raise InputError("fit", "no capture", "one capture or several")
        return cls(tuple(parts))

    def problem(self, chosen: Sequence[Candidate]) -> FitProblem:
        """See ``LinearisedFit.problem``."""
        if len(self.parts) == 1:
            return self.parts[0].problem(chosen)
        return JointProblem(tuple(part.problem(chosen) for part in self.parts))

    def residual_with(self, chosen: Sequence[Candidate]) -> NDArray[np.float64]:
        """The projected residuals of all captures with these effects in place."""
        joint = _JointModel(tuple(part.model for part in self.parts))
        return joint.joined([residual_with(part, chosen) for part in self.parts])
