"""Ranking of all effects and of an unknown cause by probability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.frozen import FrozenMappings

from .alternatives import SelectedEffect
from .evidence import penalised
from .hypotheses import SHAPE_ERROR
from .linear_model import LinearModel
from .search import Candidate
from .stepwise import Selection

__all__ = ["UNKNOWN", "Ranked", "ranking"]

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


def ranking(
    by_size: Sequence[Candidate],
    search: Selection,
    assessed: Sequence[SelectedEffect],
    start: LinearModel,
    unknown: float,
    imitations: Mapping[str, float],
    selected: tuple[str, ...],
) -> tuple[Ranked, ...]:
    """Effects by probability: the selected ones, then their alternatives, then all others.

    A selected effect and its alternatives share what an unlisted cause leaves. Where none was selected, most of it is
    that nothing is missing. Chi2 without errors counted is that of the model as given minus the gain of the effect, in
    whatever covariance the gain was computed.

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
        others_share = 1 - unknown if selected else max(1 - unknown - _NOTHING_MISSING, 0.0)
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
