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

#: Largest factor of a coat's map: each of the two faces of a film reflects at most as much as a coat.
_MAX_COATS = 2.0

#: Largest negative value of a coat's map, over its maximum: fitted maps ring below 0.
_MAX_COAT_RINGING = 0.5

#: Largest part of a place that another paint covers: 1, and the ringing of a fitted map.
_MAX_COVERED = 1.3

#: Largest negative part that another paint covers, over its maximum: the ringing of a fitted map.
_MAX_COVER_RINGING = 0.3


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
        return 0.0 if _is_possible_coat(data, candidate) else -candidate.fit.gain
    if candidate.paint_change is not None:
        return -PENALTY_ODD if _is_possible_paint(data, candidate, candidate.paint_change) else -candidate.fit.gain
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


def _is_possible_coat(data: ResidualData, candidate: FittedExplanation) -> bool:
    """Whether a film of plastic could reflect as fitted: nowhere less than nothing."""
    mirrors = candidate.fit.coefficients[0] @ cast("ImageMaps", candidate.maps).matrix(data.shape)
    return bool(-_MAX_COAT_RINGING * mirrors.max() < mirrors.min() and mirrors.max() < _MAX_COATS)


def _is_possible_paint(data: ResidualData, candidate: FittedExplanation, paint_change: NDArray[np.float64]) -> bool:
    """Whether the part of a place that another paint covers lies between nothing and all."""
    band = int(np.argmax(np.abs(paint_change)))
    bells = cast("ImageMaps", candidate.maps).matrix(data.shape)
    part = candidate.fit.coefficients[band] / paint_change[band] @ bells
    return bool(-_MAX_COVER_RINGING * part.max() < part.min() and part.max() < _MAX_COVERED)
