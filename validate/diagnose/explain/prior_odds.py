"""Prior odds of the explanation families for a localised residual."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray

from ..field_fit import (
    PENALTY_IMPOSSIBLE,
    PENALTY_ODD,
    FittedExplanation,
    ResidualData,
    SpotAppearance,
    change_dn,
)

__all__ = ["soft_outline", "spot_log_odds"]

#: Width of an object's outline, over the pitch of its bells, above which it is soft. Discs, plates and rods by formula
#: have 0.7 to 2.3 (one of 14: 3.5), the light of a small lamp on a wall 2 to 8.
_MAX_OUTLINE_WIDTH = 2.6

#: Largest value of the map of a coat or of another paint: each of the two faces of a film reflects at most as much as a
#: coat, and a paint covers all of a place at most.
_MAX_COVERED = 2.0

#: Largest negative value of such a map, over its maximum: fitted maps ring below 0.
_MAX_RINGING = 0.5


def soft_outline(data: ResidualData, candidates: Sequence[FittedExplanation]) -> bool:
    """Whether an object in front would fade away like light, and has no outline.

    Across a straight ramp of width w the integral of a (1 - a) is w / 6, where a is the covered part. The integral of
    the slope of a is the mean length of its level lines.

    Parameters
    ----------
    data
        Residual that was fitted.
    candidates
        Fitted explanations; those that act in front are judged.

    Returns
    -------
    bool
        Whether the outline of any of them is soft.
    """
    return any(candidate.acts == "front" and _is_soft(data, candidate) for candidate in candidates)


def _is_soft(data: ResidualData, candidate: FittedExplanation) -> bool:
    bells = cast("ImageMaps", candidate.maps)
    covered = np.clip(candidate.fit.coefficients[0] @ bells.matrix(data.shape), 0.0, 1.0).reshape(data.shape)
    length = np.hypot(np.diff(covered, axis=0)[:, :-1], np.diff(covered, axis=1)[:-1]).sum()
    return bool(6 * np.sum(covered * (1 - covered)) > _MAX_OUTLINE_WIDTH * bells.pitch * length)


def spot_log_odds(data: ResidualData, candidate: FittedExplanation, soft: bool) -> float:
    """2 ln of the prior odds of a localised explanation, by its sign, depth, colour and outline.

    A coat or a paint with an impossible map gets odds that cancel its gain.

    Parameters
    ----------
    data
        Residual that was fitted.
    candidate
        The fitted explanation.
    soft
        Whether an object in the place would have a soft outline.

    Returns
    -------
    float
        2 ln of the odds, at most 0; 0 for an explanation that is not localised.
    """
    if not candidate.local:
        return 0.0
    if candidate.mirrored_dn is not None:
        return 0.0 if _is_possible(data, candidate, candidate.fit.coefficients[0]) else -candidate.fit.gain
    if candidate.paint_change is not None:
        band = int(np.argmax(np.abs(candidate.paint_change)))
        part = candidate.fit.coefficients[band] / candidate.paint_change[band]
        return -PENALTY_ODD if _is_possible(data, candidate, part) else -candidate.fit.gain
    change = change_dn(data, candidate)
    weight = np.sum((change * data.weight) ** 2, axis=0)
    if not weight.any():
        return 0.0
    spot, family = SpotAppearance(data, candidate, change, weight, soft), candidate.family
    odds = family.spot_log_odds(spot)
    if spot.deep and not family.opaque and not (family.additive and spot.light):
        odds -= PENALTY_IMPOSSIBLE
    if family.additive and spot.darkens:
        odds -= PENALTY_IMPOSSIBLE
    return odds


def _is_possible(data: ResidualData, candidate: FittedExplanation, coefficients: NDArray[np.float64]) -> bool:
    """Whether a film or a paint could cover a place as fitted: from nothing to two coats."""
    covered = coefficients @ cast("ImageMaps", candidate.maps).matrix(data.shape)
    return bool(-_MAX_RINGING * covered.max() < covered.min() and covered.max() < _MAX_COVERED)
