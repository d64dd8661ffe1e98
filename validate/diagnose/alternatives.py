"""Every selected effect against the others of the catalogue in its stead, and in pixels and bands held out.

The amplitude of a true cause is the same in all pixels and bands; that of an effect which resembles it is not. And what
the likeliest causes, each tried alone, would do to the picture, beside what it shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

from ..compare import Nuisances
from .evidence import INDISTINGUISHABLE, SHAPE_ERROR, dispersion, penalised, square
from .fitting import parameter_variance
from .linear_model import LinearModel
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, Signature
from .selection import best_singles

__all__ = [
    "Cause",
    "SelectedEffect",
    "comes_of_edges",
    "confirmed_where_held_out",
    "groups",
    "heldout_bands",
    "heldout_pixels",
    "likeliest_causes",
    "with_alternatives",
    "with_better_alternatives",
]

#: So many causes are shown.
_SHOWN = 3

#: So many of the effects that could stand in a selected one's stead are fitted in full.
_MOST_FITTED = 3

#: Where held out, an effect must gain this part of what it gains where fitted.
_PREDICTS = 0.5

#: An effect is named if its amplitude is so many of its standard deviations, errors that bands and faces share counted.
_LEAST_SIGMAS = 3.0

_BLOCK_PX = 16

#: An effect's amplitude well inside faces is less than this part of that elsewhere, by so many standard deviations:
#: then it comes of edges, as of steps between faces that a picture's own errors leave. Asked where the inside holds
#: at least the last part of the square of the effect's change. True effects have 0.9 to 1.0 of it inside; gradients of
#: a ceiling whose last row of pixels a simulator had wrong had 0.2 to 0.5.
_LEAST_INSIDE, _APART_SIGMAS, _ENOUGH_INSIDE = 0.6, 3.0, 0.2

#: A band is held out only where the other bands hold at least this part of the square of the effect's change.
_ENOUGH_ELSEWHERE = 0.2


@dataclass(frozen=True, eq=False)
class SelectedEffect:
    """A selected effect, and the other effects of the catalogue in its stead, all other selected ones staying.

    alternatives : best first. chi2_without : chi2 with none of them. heldout_pixels, heldout_bands : its gain where
    it was not fitted, see ``heldout``; NaN where that cannot be tried. amplitude_sigma : standard deviation of a
    multiple of its change, 1 as fitted, see ``parameter_variance``; NaN where the priors decide. count : number of
    samples that chi2 sums. dispersion : by how much more than noise chi2 differences scatter, see ``evidence``.
    of_edges : whether it is much larger at edges than inside faces, see ``comes_of_edges``.
    """

    candidate: Candidate
    alternatives: tuple[Candidate, ...]
    chi2_without: float
    heldout_pixels: float
    heldout_bands: float
    amplitude_sigma: float
    count: int
    dispersion: float
    of_edges: bool = False

    @property
    def certainty(self) -> float:
        """The effect's amplitude over its standard deviation."""
        return float(np.sqrt(max(self.chi2_without - self.candidate.chi2, 0.0) / self.dispersion))

    @property
    def indistinguishable(self) -> list[Candidate]:
        """Alternatives that this capture, or the accuracy of the effects' shapes, cannot tell from it.

        By chi2 as it is or with each number's price: of more numbers some fit noise.
        """
        allowed = max(INDISTINGUISHABLE * self.dispersion, SHAPE_ERROR * (self.chi2_without - self.candidate.chi2))
        own = self.candidate
        return [c for c in self.alternatives if min(c.chi2 - own.chi2, penalised(c) - penalised(own)) < allowed]


def with_alternatives(
    linearised: LinearisedFit, chosen: Sequence[Candidate], signatures: Sequence[Signature]
) -> list[SelectedEffect]:
    """Every chosen effect with the other effects of the catalogue fitted in its stead."""
    found = []
    together = residual_with(linearised, chosen)
    for index, candidate in enumerate(chosen):
        others = [c for i, c in enumerate(chosen) if i != index]
        taken = {c.hypothesis.effect.id for c in chosen}
        rest = [s for s in signatures if s.hypothesis.effect.id not in taken]
        prior = candidate.by_priors
        if prior:
            # it explains a pull on the priors: that others fit errors of the picture better says nothing about that
            rest = [s for s in rest if s.by_priors]
        residual, problem = residual_with(linearised, others), linearised.problem(others)
        reached = square(problem.model.project(together)) + problem.noise_averaging_gain(candidate.applied)
        best = best_singles(problem, rest, residual, _MOST_FITTED, reached)
        fitted = replace(candidate, chi2=reached)
        shape = residual - together
        found.append(
            SelectedEffect(
                fitted,
                tuple(best),
                square(problem.model.project(residual)),
                np.nan if prior else heldout_pixels(linearised.model, residual, shape),
                np.nan if prior else heldout_bands(linearised.model, residual, shape),
                np.nan if prior else _amplitude_sigma(problem.model, *map(problem.model.project, (shape, together))),
                linearised.model.count,
                dispersion(linearised.model, shape, residual),
                not prior and comes_of_edges(linearised.model, residual, shape),
            )
        )
    return found


def with_better_alternatives(
    linearised: LinearisedFit, chosen: Sequence[Candidate], signatures: Sequence[Signature]
) -> tuple[list[Candidate], list[SelectedEffect]]:
    """Replace a chosen effect by an alternative as long as one fits better.

    The first of several effects is chosen while the others are still missing, so it may resemble their sum.
    """
    current, known = list(chosen), with_alternatives(linearised, chosen, signatures)
    for _ in range(len(current)):
        better = [
            (gain, index)
            for index, one in enumerate(known)
            if one.alternatives
            and (gain := penalised(one.candidate) - penalised(one.alternatives[0])) > INDISTINGUISHABLE
        ]
        if not better:
            break
        index = max(better)[1]
        current = refitted_together(linearised, [*current[:index], known[index].alternatives[0], *current[index + 1 :]])
        known = with_alternatives(linearised, current, signatures)
    return current, known


def confirmed_where_held_out(
    linearised: LinearisedFit,
    chosen: Sequence[Candidate],
    known: Sequence[SelectedEffect],
    signatures: Sequence[Signature],
) -> tuple[list[Candidate], list[SelectedEffect]]:
    """Drop effects that gain too little in pixels or bands held out from their fit, whose amplitude inside faces is
    another, or whose amplitude errors that bands and faces share may have made: they resemble another cause."""
    kept = [
        candidate
        for candidate, one in zip(chosen, known, strict=True)
        if not (one.heldout_pixels < _PREDICTS or one.heldout_bands < _PREDICTS)
        and not one.of_edges
        and not one.amplitude_sigma > 1 / _LEAST_SIGMAS
    ]
    if len(kept) == len(chosen):
        return list(chosen), list(known)
    kept = refitted_together(linearised, kept) if kept else []
    return kept, with_alternatives(linearised, kept, signatures)


def _amplitude_sigma(model: LinearModel, shape: NDArray, left: NDArray) -> float:
    """Standard deviation of a multiple, 1 as fitted, of a change that leaves ``left``; both (n + 11,) and projected."""
    size = max(float(shape @ shape), 1e-30)
    return float(np.sqrt(parameter_variance(model, shape[:, None], np.array([[1 / size]]), left)[0]))


def groups(known: Sequence[SelectedEffect]) -> tuple[tuple[str, ...], ...]:
    """The identifiers of each chosen effect and its indistinguishable alternatives, where there are any."""
    found = []
    for one in known:
        if one.indistinguishable:
            found.append(tuple(c.hypothesis.effect.id for c in (one.candidate, *one.indistinguishable)))
    return tuple(found)


def heldout_pixels(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain in blocks of pixels held out from the amplitude's fit, over that in the others; 1 is perfect.

    residual, predicted : (n + 11,) projected, over sigma.
    """
    rows, columns = np.indices(model.used.shape[1:])
    board = ((rows // _BLOCK_PX + columns // _BLOCK_PX) % 2).astype(bool)
    one = np.broadcast_to(board, model.used.shape)[model.used]
    priors = np.ones(Nuisances.count, bool)
    own = other = 0.0
    for part in (one, ~one):
        inside, outside = np.append(part, priors), np.append(~part, ~priors)
        amplitude = _amplitude(residual[inside], predicted[inside])
        own += _gain(residual[inside], predicted[inside], amplitude)
        other += _gain(residual[outside], predicted[outside], amplitude)
    return other / max(own, 1e-30)


def heldout_bands(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain in each band with the amplitude that the other bands ask for, over that with the one of all bands.

    NaN for an effect that acts in one band alone. Parameters as in ``heldout_pixels``.
    """
    band = np.broadcast_to(np.arange(len(model.used))[:, None, None], model.used.shape)[model.used]
    pixels, shape = residual[: model.count], predicted[: model.count]
    everywhere = _amplitude(pixels, shape)
    own = other = 0.0
    for held in range(len(model.used)):
        inside = band != held
        if np.sum(shape[inside] ** 2) < _ENOUGH_ELSEWHERE * np.sum(shape**2):
            continue
        amplitude = _amplitude(pixels[inside], shape[inside])
        own += _gain(pixels[~inside], shape[~inside], everywhere)
        other += _gain(pixels[~inside], shape[~inside], amplitude)
    return other / own if own > 0 else float("nan")


def comes_of_edges(model: LinearModel, residual: NDArray, predicted: NDArray) -> bool:
    """Whether pixels near edges ask for a much larger amplitude than those well inside faces. Parameters as in
    ``heldout_pixels``."""
    pixels, shape = residual[: model.count], predicted[: model.count]
    parts = (model.interior, ~model.interior)
    inside, edges = (float(shape[part] @ shape[part]) for part in parts)
    if edges <= 0 or inside < _ENOUGH_INSIDE * (inside + edges):
        return False
    within, near = (_amplitude(pixels[part], shape[part]) for part in parts)
    sigma = float(np.sqrt(1 / inside + 1 / edges))
    return within < _LEAST_INSIDE * near and near - within > _APART_SIGMAS * sigma


def _amplitude(residual: NDArray, predicted: NDArray) -> float:
    return float(predicted @ residual) / max(float(predicted @ predicted), 1e-30)


def _gain(residual: NDArray, predicted: NDArray, amplitude: float) -> float:
    return float(2 * amplitude * (predicted @ residual) - amplitude**2 * (predicted @ predicted))


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


def likeliest_causes(model: LinearModel, tried: Sequence[Candidate], first: Sequence[str]) -> tuple[Cause, ...]:
    """The first three causes of those tried alone, best first. first : identifiers that stand before all others."""
    named = [next((c for c in tried if c.hypothesis.effect.id == name), None) for name in first]
    before = [c for c in named if c is not None]
    shown = [*before, *(c for c in tried if c.hypothesis.effect.id not in first)][:_SHOWN]
    return tuple(
        Cause(
            c.hypothesis.effect.id,
            dict(c.applied.values),
            dict(c.sigma),
            model.image(c.predicted).astype(np.float32),
            _cosine(c.predicted, model.residual),
            _cosine(c.predicted, shown[0].predicted),
            float(np.sqrt(max(c.chi2 - shown[0].chi2, 0.0))),
        )
        for c in shown
    )


def _cosine(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    a, b = a.astype(float), b.astype(float)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else float("nan")
