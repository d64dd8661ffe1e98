"""Every selected effect against the others of the catalogue in its stead, and in pixels and bands held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .evidence import INDISTINGUISHABLE, SHAPE_ERROR, square
from .heldout import PREDICTS, heldout_bands, heldout_pixels
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate, Signature
from .selection import best_singles

__all__ = [
    "SelectedEffect",
    "confirmed_where_held_out",
    "groups",
    "with_alternatives",
    "with_better_alternatives",
]

#: So many of the effects that could stand in a selected one's stead are fitted in full.
_MOST_FITTED = 3


@dataclass(frozen=True, eq=False)
class SelectedEffect:
    """A selected effect, and the other effects of the catalogue in its stead, all other selected ones staying.

    alternatives : best first. chi2_without : chi2 with none of them. heldout_pixels, heldout_bands : its gain where
    it was not fitted, see ``heldout``; NaN where that cannot be tried. count : number of samples that chi2 sums.
    """

    candidate: Candidate
    alternatives: tuple[Candidate, ...]
    chi2_without: float
    heldout_pixels: float
    heldout_bands: float
    count: int

    @property
    def indistinguishable(self) -> list[Candidate]:
        """Alternatives that this capture, or the accuracy of the effects' shapes, cannot tell from it."""
        allowed = max(INDISTINGUISHABLE, SHAPE_ERROR * (self.chi2_without - self.candidate.chi2))
        return [c for c in self.alternatives if c.chi2 - self.candidate.chi2 < allowed]


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
                fitted, tuple(best), square(problem.model.project(residual)),
                np.nan if prior else heldout_pixels(linearised.model, residual, shape),
                np.nan if prior else heldout_bands(linearised.model, residual, shape),
                linearised.model.count,
            )
        )  # fmt: skip
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
            (one.candidate.chi2 - one.alternatives[0].chi2, index)
            for index, one in enumerate(known)
            if one.alternatives and one.alternatives[0].chi2 < one.candidate.chi2 - INDISTINGUISHABLE
        ]
        if not better:
            break
        index = max(better)[1]
        current = refitted_together(
            linearised, [*current[:index], known[index].alternatives[0], *current[index + 1 :]]
        )
        known = with_alternatives(linearised, current, signatures)
    return current, known


def confirmed_where_held_out(
    linearised: LinearisedFit,
    chosen: Sequence[Candidate],
    known: Sequence[SelectedEffect],
    signatures: Sequence[Signature],
) -> tuple[list[Candidate], list[SelectedEffect]]:
    """Drop effects that gain too little in pixels or bands held out from their fit: they resemble another cause."""
    kept = [
        candidate
        for candidate, one in zip(chosen, known, strict=True)
        if not (one.heldout_pixels < PREDICTS or one.heldout_bands < PREDICTS)
    ]
    if len(kept) == len(chosen):
        return list(chosen), list(known)
    kept = refitted_together(linearised, kept) if kept else []
    return kept, with_alternatives(linearised, kept, signatures)


def groups(known: Sequence[SelectedEffect]) -> tuple[tuple[str, ...], ...]:
    """The identifiers of each chosen effect and its indistinguishable alternatives, where there are any."""
    found = []
    for one in known:
        if one.indistinguishable:
            found.append(tuple(c.hypothesis.effect.id for c in (one.candidate, *one.indistinguishable)))
    return tuple(found)
