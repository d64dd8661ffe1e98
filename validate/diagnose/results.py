"""Results of a diagnosis: all effects by probability, and the path of the falling error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.utils.frozen import FrozenMappings

from ..compare import Comparison, Validation, compared
from .alternatives import SelectedEffect
from .evidence import penalised, prior_pull
from .hypotheses import SHAPE_ERROR
from .linear_model import LinearModel, smooth_excess
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, unknown_notes
from .stepwise import Selection

__all__ = ["UNKNOWN", "Ranked", "Step", "path_of", "ranking"]

#: Identifier selected where something remains that no effect of the catalogue explains.
UNKNOWN = "unknown"

#: Probability that nothing is missing, where no effect was accepted: 147 of 149 blind captures, nothing or a weak
#: cause hidden; fewer with faint ones (`benchmarks/measured/blind_diagnosis.jsonl`).
_NOTHING_MISSING = 0.95


@dataclass(frozen=True)
class Ranked(FrozenMappings):
    """One effect tried alone."""

    #: Identifier of the effect.
    effect: str
    #: By parameter, its values.
    values: Mapping[str, str | float]
    #: By parameter, standard deviations of the fitted ones.
    sigma: Mapping[str, float]
    #: Chi2 per sample with the effect.
    chi2_per_dof: float
    #: Probability that it is a cause.
    probability: float


@dataclass(frozen=True, eq=False)
class Step(FrozenMappings):
    """The model with the first of the selected effects."""

    #: The first effects, in the order of selection.
    effects: tuple[AppliedEffect, ...]
    #: For each, standard deviations of its numbers by parameter.
    sigma: tuple[Mapping[str, float], ...]
    #: Excess of interior block means over noise, chi2 per sample, see `linear_model.smooth_excess`.
    smooth_excess: float
    #: Standard deviations by which fitted camera and lamp miss survey and stated power.
    prior_pull: float
    #: Photograph against this model, camera and lamp fitted.
    comparison: Comparison
    #: Notes on what references, flats and darks would have shown.
    unknown: tuple[str, ...] = ()


def ranking(
    by_size: Sequence[Candidate],
    search: Selection,
    assessed: Sequence[SelectedEffect],
    start: LinearModel,
    unknown: float,
    imitations: Mapping[str, float],
    selected: tuple[str, ...],
    *,
    sound: float,
) -> tuple[Ranked, ...]:
    """Effects by probability: the selected ones, then their alternatives, then all others.

    A selected effect and its alternatives share what an unlisted cause leaves. Where none was selected, most of it is
    that nothing is missing, next to an unlisted cause as well. Chi2 without errors counted is that of the model as
    given minus the gain of the effect, in whatever covariance the gain was computed.

    Parameters
    ----------
    by_size
        Every effect tried alone, judged by its size.
    search
        The selection that counts.
    assessed
        Its effects and their alternatives.
    start
        Linear model of the model as given.
    unknown
        Probability of an unknown cause, 0 to 1.
    imitations
        By selected effect, the probability that it only imitates such a cause.
    selected
        Identifiers of the answer.
    sound
        Probability that nothing is missing where "unknown" is the whole answer, by the odds of explanations; else not
        used.

    Returns
    -------
    tuple of Ranked
        Every effect and "unknown".
    """
    singles = search.singles
    offset = start.chi2 - search.first.chi2
    entries = {c.hypothesis.effect.id: _ranked(c, 0.0, start.count, 0.0) for c in by_size}
    entries |= {c.hypothesis.effect.id: _ranked(c, offset, start.count, 0.0) for c in singles}
    if set(selected) - {UNKNOWN}:
        for effect in sorted(assessed, key=lambda e: e.chi2_without):
            rivals = [effect.candidate, *effect.alternatives]
            shares = _shares(rivals, effect.chi2_without, effect.dispersion)
            imitated = imitations[effect.candidate.hypothesis.effect.id]
            for candidate, share in zip(rivals, shares, strict=True):
                entry = _ranked(candidate, offset, effect.count, (1 - imitated) * share)
                listed = entries.get(entry.effect)
                if candidate is effect.candidate or listed is None or entry.probability > listed.probability:
                    entries[entry.effect] = entry
    else:
        others_share = max(1 - unknown - (sound if selected else _NOTHING_MISSING), 0.0)
        for candidate, share in zip(singles, _shares(singles, search.first.chi2, 1.0), strict=True):
            entries[candidate.hypothesis.effect.id] = _ranked(candidate, offset, start.count, others_share * share)
    lowest = min((offset + c.chi2 for c in singles), default=start.chi2)
    entries[UNKNOWN] = Ranked(UNKNOWN, {}, {}, lowest / start.count, unknown)
    return tuple(sorted(entries.values(), key=lambda r: (-r.probability, r.chi2_per_dof)))


def _ranked(candidate: Candidate, offset: float, count: int, probability: float) -> Ranked:
    """An entry of the ranking; its chi2 plus an offset counts."""
    values, sigma = dict(candidate.applied.values), dict(candidate.sigma)
    return Ranked(candidate.hypothesis.effect.id, values, sigma, (offset + candidate.chi2) / count, probability)


def _shares(candidates: Sequence[Candidate], chi2_without: float, dispersion: float) -> list[float]:
    """Probabilities from differences of chi2, each number at its price; none without candidates.

    The errors of the effects' shapes may make a part of the differences, which widens them.
    """
    if not candidates:
        return []
    chi2 = np.array([penalised(c) for c in candidates])
    weights = np.exp(-0.5 * (chi2 - chi2.min()) / (dispersion + SHAPE_ERROR * max(chi2_without - chi2.min(), 0.0)))
    return [float(w) for w in weights / weights.sum()]


def path_of(
    validation: Validation,
    start: LinearModel,
    linearised: LinearisedFit,
    effects: Sequence[Candidate],
    imitated: Sequence[str],
) -> tuple[Step, ...]:
    """The model as given, then with one effect more each, fitted without the later ones.

    Parameters
    ----------
    validation
        The model as given, compared.
    start
        Its linear model.
    linearised
        Fit in which the effects were selected.
    effects
        The selected effects.
    imitated
        Identifiers of effects that the unknown parts of the capture imitate.

    Returns
    -------
    tuple of Step
        One more than there are effects.
    """
    excess, pull = smooth_excess(start, start.residual), prior_pull(start.residual)
    steps = [Step((), (), excess, pull, validation.comparison, unknown_notes(validation.prepared, imitated))]
    for count in range(1, len(effects) + 1):
        first_effects = refitted_together(linearised, effects[:count]) if count < len(effects) else effects
        steps.append(_step(validation, linearised, first_effects, imitated))
    return tuple(steps)


def _step(
    validation: Validation, linearised: LinearisedFit, effects: Sequence[Candidate], imitated: Sequence[str]
) -> Step:
    """The model with these effects, compared; lamp and free scale are fitted with them in place."""
    prepared, rendered, residual = validation.prepared, linearised.rendered, residual_with(linearised, effects)
    applied = tuple(c.applied for c in effects)
    signal = linearised.predictor.signal((*linearised.model_effects, *applied))
    prepared = prepared.fitted_about(signal, rendered.variance, rendered.used)
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, _ = prepared.lamp_scale(signal, variance, rendered.used)
    if prepared.free_scale is not None and not prepared.free_scale.absolute:
        scale, rendered = 1.0, replace(rendered, fit=replace(rendered.fit, lamp_scale=1.0))
    return Step(
        effects=applied,
        sigma=tuple(dict(c.sigma) for c in effects),
        smooth_excess=smooth_excess(linearised.model, residual),
        prior_pull=prior_pull(residual),
        comparison=compared(prepared, rendered, scale * signal),
        unknown=unknown_notes(prepared, imitated),
    )
