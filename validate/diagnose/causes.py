"""What the likeliest causes would do to the picture, beside what it shows: signatures after camera and lamp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.frozen import OwnMappings
from numpy.typing import NDArray

from .linear_model import LinearModel
from .search import Candidate

__all__ = ["Cause", "likeliest_causes"]

#: So many causes are shown.
_SHOWN = 3


@dataclass(frozen=True, eq=False)
class Cause(OwnMappings):
    """One effect, tried alone. values, sigma : its parameters and the standard deviations of those fitted.

    signature : (band, y, x) the change that it makes, over sigma, without what camera and lamp can imitate; NaN where
    a pixel is not used. cosine : between signature and residual, -1 to 1; noise keeps it below 1.
    cosine_with_first : between its signature and the first cause's. behind_sigma : square root of the chi2 that it
    leaves more than the first cause; 0 where it leaves less.
    """

    effect: str
    values: Mapping[str, str | float]
    sigma: Mapping[str, float]
    signature: NDArray[np.float32]
    cosine: float
    cosine_with_first: float
    behind_sigma: float


def likeliest_causes(
    model: LinearModel, tried: Sequence[Candidate], first: Sequence[str]
) -> tuple[Cause, ...]:
    """The first three causes of those tried alone, best first. first : identifiers that stand before all others."""
    named = [next((c for c in tried if c.hypothesis.effect.id == name), None) for name in first]
    before = [c for c in named if c is not None]
    shown = [*before, *(c for c in tried if c.hypothesis.effect.id not in first)][:_SHOWN]
    return tuple(
        Cause(
            c.hypothesis.effect.id, dict(c.applied.values), dict(c.sigma),
            model.image(c.predicted).astype(np.float32), _cosine(c.predicted, model.residual),
            _cosine(c.predicted, shown[0].predicted), float(np.sqrt(max(c.chi2 - shown[0].chi2, 0.0))),
        )
        for c in shown
    )  # fmt: skip


def _cosine(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    a, b = a.astype(float), b.astype(float)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else float("nan")
