"""Tests of selected effects: alternatives, held-out samples, edges; the likeliest causes.

The amplitude of a true cause is the same in all pixels and bands; that of an effect which resembles it is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from .evidence import beyond_tolerance, dispersion, penalised, square
from .fitting import parameter_variance
from .hypotheses import INDISTINGUISHABLE_CHI2, SHAPE_ERROR, SIGNIFICANT_SIGMA
from .linear_model import LinearModel
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, Signature
from .selection import NUM_FITTED, best_singles

__all__ = [
    "LikelyCause",
    "SelectedEffect",
    "confirmed_where_held_out",
    "groups",
    "heldout_bands",
    "heldout_pixels",
    "holds_with_remainder",
    "is_edge_artefact",
    "likeliest_causes",
    "tested_without_errors",
    "with_alternatives",
    "with_better_alternatives",
]

#: Number of causes shown.
_MAX_CAUSES_SHOWN = 3

#: Minimum gain of an effect in samples held out, over its gain in the fitted ones; 1 is perfect. Set by judgement.
_MIN_HELDOUT_GAIN_RATIO = 0.5

#: The same where something remains that neither effects nor flaws of the base explain. Set by judgement.
_MIN_HELDOUT_WITH_REMAINDER = 0.8

#: Minimum share of the excess, flaws of the base taken off, that effects explain where something remains: less may be
#: an imitation of what remains. Set by judgement.
_MIN_EXPLAINED_PART = 0.5

#: Side of the blocks of pixels that are held out in turn, px: wide against the blur of the optics. Set by judgement.
_HELDOUT_BLOCK_PX = 16

#: Amplitude inside faces over that near edges, below which an effect is an edge artefact. True effects have 0.9 to 1.0;
#: gradients of a ceiling whose last row of pixels a simulator had wrong had 0.2 to 0.5.
_MAX_EDGE_ARTEFACT_RATIO = 0.6

#: Minimum share of the square of the effect's change in a part of the samples, for this part to be tested: inside
#: faces, or in the other bands, where an effect of one band has nothing to be fitted to.
_MIN_TESTED_PART = 0.2


@dataclass(frozen=True, eq=False)
class SelectedEffect:
    """A selected effect, and the alternatives to it with all other selected effects in place."""

    #: The effect, fitted.
    candidate: Candidate
    #: Other effects of the catalogue fitted in the same role, best first.
    alternatives: tuple[Candidate, ...]
    #: Chi2 with neither the effect nor an alternative.
    chi2_without: float
    #: Gain in pixels held out over that where fitted, see `heldout_pixels`; NaN where the priors decide.
    heldout_pixels: float
    #: Gain in bands held out over that where fitted, see `heldout_bands`; NaN also for an effect in one band.
    heldout_bands: float
    #: Standard deviation of a multiple of its change, 1 as fitted, see `parameter_variance`; NaN where the priors
    #: decide.
    amplitude_sigma: float
    #: Number of samples that chi2 sums.
    count: int
    #: Factor by which differences of chi2 scatter more than by noise, see `evidence.dispersion`.
    dispersion: float
    #: Whether its amplitude is much larger at edges than inside faces, see `is_edge_artefact`.
    edge_artefact: bool = False

    @property
    def certainty(self) -> float:
        """The effect's amplitude over its standard deviation."""
        return float(np.sqrt(max(self.chi2_without - self.candidate.chi2, 0.0) / self.dispersion))

    @property
    def indistinguishable(self) -> list[Candidate]:
        """Alternatives that this capture does not distinguish from the effect.

        Chi2 counts as it is, or with each number's price, since some of the numbers fit noise. Errors of the effects'
        shapes widen the allowed difference.
        """
        allowed = max(INDISTINGUISHABLE_CHI2 * self.dispersion, SHAPE_ERROR * (self.chi2_without - self.candidate.chi2))
        effect = self.candidate
        return [c for c in self.alternatives if min(c.chi2 - effect.chi2, penalised(c) - penalised(effect)) < allowed]


def with_alternatives(
    linearised: LinearisedFit, selected: Sequence[Candidate], signatures: Sequence[Signature]
) -> list[SelectedEffect]:
    """Selected effects, each with the other effects of the catalogue fitted in its role.

    An effect that the priors judge explains a pull on the priors. Alternatives that explain errors of the picture say
    nothing about that, so only effects judged by the priors compete with it.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Effects fitted together.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    list of SelectedEffect
        In the order of the effects.
    """
    assessed = []
    together = residual_with(linearised, selected)
    for index, candidate in enumerate(selected):
        others = [c for i, c in enumerate(selected) if i != index]
        selected_ids = {c.hypothesis.effect.id for c in selected}
        rest = [s for s in signatures if s.hypothesis.effect.id not in selected_ids]
        by_priors = candidate.by_priors
        if by_priors:
            rest = [s for s in rest if s.by_priors]
        residual, problem = residual_with(linearised, others), linearised.problem(others)
        chi2 = square(problem.model.project(together)) + problem.noise_averaging_gain(candidate.applied)
        best = best_singles(problem, rest, residual, NUM_FITTED, chi2)
        fitted = replace(candidate, chi2=chi2)
        shape = residual - together
        assessed.append(
            SelectedEffect(
                fitted,
                tuple(best),
                square(problem.model.project(residual)),
                np.nan if by_priors else heldout_pixels(linearised.model, residual, shape),
                np.nan if by_priors else _heldout_bands(candidate, linearised.model, residual, shape),
                np.nan
                if by_priors
                else _amplitude_sigma(problem.model, *map(problem.model.project, (shape, together))),
                linearised.model.count,
                dispersion(linearised.model, shape, residual),
                not by_priors and is_edge_artefact(linearised.model, residual, shape),
            )
        )
    return assessed


def tested_without_errors(linearised: LinearisedFit, assessed: Sequence[SelectedEffect]) -> list[SelectedEffect]:
    """Effects with the results of the tests where nothing but noise is in the covariance.

    Errors in the covariance take most weight from what is smooth. What is left of an imitation may hold everywhere.

    Parameters
    ----------
    linearised
        The capture's linearised fit, without errors in its covariance.
    assessed
        Effects fitted together, with their alternatives.

    Returns
    -------
    list of SelectedEffect
        Alternatives, chi2 and dispersion stay.
    """
    effects = [effect.candidate for effect in assessed]
    model, together, tested = linearised.model, residual_with(linearised, effects), list[SelectedEffect]()
    for index, effect in enumerate(assessed):
        if effect.candidate.by_priors:
            tested.append(effect)
            continue
        others = [candidate for i, candidate in enumerate(effects) if i != index]
        residual, projected = residual_with(linearised, others), linearised.problem(others).model
        shape = residual - together
        tested.append(
            replace(
                effect,
                heldout_pixels=heldout_pixels(model, residual, shape),
                heldout_bands=_heldout_bands(effect.candidate, model, residual, shape),
                amplitude_sigma=_amplitude_sigma(projected, *map(projected.project, (shape, together))),
                edge_artefact=is_edge_artefact(model, residual, shape),
            )
        )
    return tested


def with_better_alternatives(
    linearised: LinearisedFit, selected: Sequence[Candidate], signatures: Sequence[Signature]
) -> tuple[list[Candidate], list[SelectedEffect]]:
    """Replace a selected effect by an alternative as long as one fits better.

    The first of several effects is selected while the others are still missing, so it may resemble their sum. Of two
    that are indistinguishable, the likelier one is selected.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Effects fitted together.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    current : list of Candidate
        The effects after at most as many exchanges as there are effects, fitted together.
    assessed : list of SelectedEffect
        The same with their alternatives.
    """
    current, assessed = list(selected), with_alternatives(linearised, selected, signatures)
    for _ in range(len(current)):
        better = [
            (gain, index)
            for index, effect in enumerate(assessed)
            if effect.alternatives and (gain := penalised(effect.candidate) - penalised(effect.alternatives[0])) > 0
        ]
        if not better:
            break
        index = max(better)[1]
        current = refitted_together(
            linearised, [*current[:index], assessed[index].alternatives[0], *current[index + 1 :]]
        )
        assessed = with_alternatives(linearised, current, signatures)
    return current, assessed


def confirmed_where_held_out(
    linearised: LinearisedFit,
    selected: Sequence[Candidate],
    assessed: Sequence[SelectedEffect],
    signatures: Sequence[Signature],
) -> tuple[list[Candidate], list[SelectedEffect]]:
    """Drop effects that other samples do not confirm: they resemble another cause.

    An effect is dropped for any of four reasons. It gains too little in pixels or bands held out from its fit. It is an
    edge artefact. Errors shared by bands and faces may have made its amplitude. Or its numbers, fitted with the other
    effects, are within their tolerances.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Effects fitted together.
    assessed
        The same effects, with the results of the tests.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    confirmed : list of Candidate
        The effects that pass, fitted together again where one was dropped.
    assessed : list of SelectedEffect
        The same with their alternatives.
    """
    confirmed = [
        candidate
        for candidate, effect in zip(selected, assessed, strict=True)
        if not (effect.heldout_pixels < _MIN_HELDOUT_GAIN_RATIO or effect.heldout_bands < _MIN_HELDOUT_GAIN_RATIO)
        and not effect.edge_artefact
        and not effect.amplitude_sigma > 1 / SIGNIFICANT_SIGMA
        and beyond_tolerance(candidate)
    ]
    if len(confirmed) == len(selected):
        return list(selected), list(assessed)
    confirmed = refitted_together(linearised, confirmed) if confirmed else []
    return confirmed, with_alternatives(linearised, confirmed, signatures)


def holds_with_remainder(assessed: Sequence[SelectedEffect], explained: float) -> bool:
    """Whether effects stay the answer although something else remains.

    Flaws of the base do not explain that remainder. A cause that no effect describes is imitated by effects in part.
    Those explain less, and hold less where they were not fitted. Effects that priors judge explain a pull on these,
    whatever remains in the picture.

    Parameters
    ----------
    assessed
        Selected effects with the results of their tests.
    explained
        Share of the excess that they explain together, flaws of the base taken off.

    Returns
    -------
    bool
        False for no effect.
    """
    if assessed and all(effect.candidate.by_priors for effect in assessed):
        return True
    ratios = [ratio for effect in assessed for ratio in (effect.heldout_pixels, effect.heldout_bands)]
    return (
        bool(assessed)
        and explained > _MIN_EXPLAINED_PART
        and not any(ratio < _MIN_HELDOUT_WITH_REMAINDER for ratio in ratios)
    )


def _amplitude_sigma(model: LinearModel, shape: NDArray, remainder: NDArray) -> float:
    """Standard deviation of a change's multiple, 1 as fitted; (n + 11,) change and remainder."""
    size = max(float(shape @ shape), 1e-30)
    return float(np.sqrt(parameter_variance(model, shape[:, None], np.array([[1 / size]]), remainder)[0]))


def groups(assessed: Sequence[SelectedEffect]) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that the capture does not distinguish.

    Parameters
    ----------
    assessed
        Selected effects with their alternatives.

    Returns
    -------
    tuple of tuple
        Identifiers of each effect and its indistinguishable alternatives, where there are any.
    """
    identifiers = []
    for effect in assessed:
        if effect.indistinguishable:
            identifiers.append(tuple(c.hypothesis.effect.id for c in (effect.candidate, *effect.indistinguishable)))
    return tuple(identifiers)


def heldout_pixels(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain in blocks of pixels held out from the amplitude's fit, over that in the others.

    Blocks of 16 x 16 pixels form a chessboard; either colour is held out in turn. The rows of the priors count with
    both.

    Parameters
    ----------
    model
        Linear model of the capture.
    residual
        (n + 11,) projected residual without the effect.
    predicted
        (n + 11,) projected change by the effect.

    Returns
    -------
    float
        1 for an amplitude that is the same everywhere, near 0 for one that other blocks do not show.
    """
    rows, columns = np.indices(model.used.shape[1:])
    board = ((rows // _HELDOUT_BLOCK_PX + columns // _HELDOUT_BLOCK_PX) % 2).astype(bool)
    white = np.broadcast_to(board, model.used.shape)[model.used]
    priors = np.ones(len(residual) - model.count, bool)
    fitted_gain = heldout_gain = 0.0
    for part in (white, ~white):
        inside, outside = np.append(part, priors), np.append(~part, ~priors)
        amplitude = _amplitude(residual[inside], predicted[inside])
        fitted_gain += _gain(residual[inside], predicted[inside], amplitude)
        heldout_gain += _gain(residual[outside], predicted[outside], amplitude)
    return heldout_gain / max(fitted_gain, 1e-30)


def heldout_bands(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain in each band with the other bands' amplitude, over that with the amplitude of all.

    Parameters
    ----------
    model
        Linear model of the capture.
    residual
        (n + 11,) projected residual without the effect.
    predicted
        (n + 11,) projected change by the effect.

    Returns
    -------
    float
        1 for an amplitude that is the same in all bands; NaN for an effect that acts in one band alone.
    """
    band = np.broadcast_to(np.arange(len(model.used))[:, None, None], model.used.shape)[model.used]
    pixels, shape = residual[: model.count], predicted[: model.count]
    everywhere = _amplitude(pixels, shape)
    fitted_gain = heldout_gain = 0.0
    for index in range(len(model.used)):
        inside = band != index
        if np.sum(shape[inside] ** 2) < _MIN_TESTED_PART * np.sum(shape**2):
            continue
        amplitude = _amplitude(pixels[inside], shape[inside])
        fitted_gain += _gain(pixels[~inside], shape[~inside], everywhere)
        heldout_gain += _gain(pixels[~inside], shape[~inside], amplitude)
    return heldout_gain / fitted_gain if fitted_gain > 0 else float("nan")


def _heldout_bands(candidate: Candidate, model: LinearModel, residual: NDArray, shape: NDArray) -> float:
    """The same of a fitted effect; NaN for one of a single band.

    In other bands such an effect has only what lamp and other effects do to make up for it.
    """
    return float("nan") if "band" in candidate.applied.values else heldout_bands(model, residual, shape)


def is_edge_artefact(model: LinearModel, residual: NDArray, predicted: NDArray) -> bool:
    """Whether samples near edges ask for a much larger amplitude than those well inside faces.

    Rendering errors leave steps between faces, which a gradient may imitate. The amplitude inside faces must be below
    0.6 of that near edges, by 3 standard deviations. Not tested where the interior holds less than 20 % of the square
    of the effect's change.

    Parameters
    ----------
    model
        Linear model of the capture.
    residual
        (n + 11,) projected residual without the effect.
    predicted
        (n + 11,) projected change by the effect.

    Returns
    -------
    bool
        False where it is not tested.
    """
    pixels, shape = residual[: model.count], predicted[: model.count]
    parts = (model.interior, ~model.interior)
    inside, edges = (float(shape[part] @ shape[part]) for part in parts)
    if edges <= 0 or inside < _MIN_TESTED_PART * (inside + edges):
        return False
    within, near = (_amplitude(pixels[part], shape[part]) for part in parts)
    sigma = float(np.sqrt(1 / inside + 1 / edges))
    return within < _MAX_EDGE_ARTEFACT_RATIO * near and near - within > SIGNIFICANT_SIGMA * sigma


def _amplitude(residual: NDArray, predicted: NDArray) -> float:
    """Least-squares multiple of a prediction in a residual."""
    return float(predicted @ residual) / max(float(predicted @ predicted), 1e-30)


def _gain(residual: NDArray, predicted: NDArray, amplitude: float) -> float:
    """Chi2 that a multiple of a prediction takes off a residual."""
    return float(2 * amplitude * (predicted @ residual) - amplitude**2 * (predicted @ predicted))


@dataclass(frozen=True, eq=False)
class LikelyCause(FrozenMappings):
    """One effect tried alone, to be compared with the residual."""

    #: Identifier of the effect.
    effect: str
    #: By parameter, its values.
    values: Mapping[str, str | float]
    #: By parameter, standard deviations of the fitted ones.
    sigma: Mapping[str, float]
    #: (band, y, x) the change that it makes, over sigma, without what camera and lamp can imitate; NaN where a sample
    #: is not used.
    signature: NDArray[np.float32]
    #: Cosine between signature and residual, -1 to 1; noise keeps it below 1.
    cosine: float
    #: Cosine between its signature and the first cause's.
    cosine_with_first: float
    #: Square root of the chi2 that it leaves more than the first cause; 0 where it leaves less.
    behind_sigma: float


def likeliest_causes(model: LinearModel, singles: Sequence[Candidate], first: Sequence[str]) -> tuple[LikelyCause, ...]:
    """The first causes of those tried alone, best first.

    Parameters
    ----------
    model
        Linear model in which they were tried.
    singles
        Effects fitted alone, best first.
    first
        Identifiers that come before all others.

    Returns
    -------
    tuple of LikelyCause
        Three at most.
    """
    leading = [next((c for c in singles if c.hypothesis.effect.id == name), None) for name in first]
    available = [c for c in leading if c is not None]
    causes = [*available, *(c for c in singles if c.hypothesis.effect.id not in first)][:_MAX_CAUSES_SHOWN]
    return tuple(
        LikelyCause(
            c.hypothesis.effect.id,
            dict(c.applied.values),
            dict(c.sigma),
            model.image(c.predicted).astype(np.float32),
            _cosine(c.predicted, model.residual),
            _cosine(c.predicted, causes[0].predicted),
            float(np.sqrt(max(c.chi2 - causes[0].chi2, 0.0))),
        )
        for c in causes
    )


def _cosine(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Cosine between two vectors in double precision; NaN where one is 0."""
    a, b = a.astype(float), b.astype(float)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else float("nan")
