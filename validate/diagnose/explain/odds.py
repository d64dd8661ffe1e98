"""Probabilities of families, of none of them, and of no cause, learnt from simulated causes.

A conditional logit (McFadden 1974): each outcome has a utility. That of a family is linear in what its best form shows,
and that of "none" in what the best of all forms shows. That of "sound" is linear in the size of the excess. The weights
are data, see `learnt_odds`. Few simulations determine them only in part: probabilities are means over what the weights
may be (MacKay 1992), so that a residual unlike all simulated ones has less certain odds.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .explanation import NONE, SOUND, Rival
from .registration import Registration

__all__ = ["FEATURES", "design", "expected_shares", "features", "learnt_odds", "probabilities"]

#: Names of the features; those of "none" and "sound" are 0 for families, and those of families for both.
FEATURES = (
    "how far a family's score lies behind the best, log(1 + difference)",
    "share of the excess that a family explains",
    "gain in samples held out over that where fitted, of a family",
    "none: constant",
    "none: largest share",
    "none: largest gain in samples held out",
    "none: share of single pixels",
    "none: part at edges",
    "sound: constant",
    "sound: log of the excess per sample",
    "sound: largest share",
    "sound: largest gain in samples held out",
    "sound: part at edges",
)

#: Limits of the gain in samples held out: beyond them it says no more.
_PREDICTS = (-1.0, 1.2)

#: Smallest excess per sample that counts, chi2: below the allowances of the pictures.
_LEAST_EXCESS = 0.005

#: Numerics: number of draws of the weights, over which probabilities are means: their errors are below 0.02.
_DRAWS = 1000

#: Variance of the offset of a family that the simulations lack: that of its prior.
_UNKNOWN_OFFSET = 1.0

_TABLE = Path(__file__).parent / "data" / "odds.json"


def features(rivals: Sequence[Rival], registration: Registration) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Outcomes and their features.

    Parameters
    ----------
    rivals
        Best form of each family.
    registration
        Registration of the residual.

    Returns
    -------
    tuple
        Outcomes, families first, and (outcome, feature) their features in the sequence of ``FEATURES``.
    """
    members = [rival for rival in rivals if rival.family != NONE]
    top = max(rival.score for rival in members)
    holds = np.clip([rival.predicts for rival in members], *_PREDICTS)
    shares = np.array([rival.share for rival in members])
    table = np.zeros((len(members) + 2, len(FEATURES)))
    table[:-2, 0] = np.log1p([top - rival.score for rival in members])
    table[:-2, 1], table[:-2, 2] = shares, holds
    best = shares * (holds > 0)
    table[-2, 3:8] = 1, best.max(), holds[np.argmax(best)], registration.in_pixels, registration.at_edges
    excess = np.log(max(registration.per_sample, _LEAST_EXCESS))
    table[-1, 8:13] = 1, excess, best.max(), holds[np.argmax(best)], registration.at_edges
    return (*(rival.family for rival in members), NONE, SOUND), table


@lru_cache(maxsize=1)
def learnt_odds() -> Mapping[str, Any]:
    """Table of the weights, with the date and the numbers of simulated captures.

    Returns
    -------
    Mapping
        ``weights`` by feature, ``offsets`` by outcome, ``covariance`` of both, the lower half, ``date``, ``captures``.
    """
    table: Mapping[str, Any] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return table


def probabilities(rivals: Sequence[Rival], registration: Registration) -> dict[str, float]:
    """Probability of each outcome.

    Parameters
    ----------
    rivals
        Best form of each family.
    registration
        Registration of the residual.

    Returns
    -------
    dict
        By family, "none" and "sound"; the sum is 1. Families of other packages have the offset 0.
    """
    outcomes, table = features(rivals, registration)
    learnt = learnt_odds()
    offsets = learnt["offsets"]
    weights = np.array([*(learnt["weights"][name] for name in FEATURES), *offsets.values()])
    columns = design(outcomes, table, tuple(offsets))
    lower = np.zeros((len(weights), len(weights)))
    lower[np.tril_indices(len(weights))] = np.concatenate(learnt["covariance"])
    covariance = columns @ (lower + np.tril(lower, -1).T) @ columns.T
    covariance += np.diag([_UNKNOWN_OFFSET * (o not in (*offsets, NONE, SOUND)) for o in outcomes])
    # rule of succession: what none of the captures has shown
    least = 1 / (learnt["captures"] + 2)
    share = np.maximum(expected_shares(columns @ weights, covariance), least)
    return dict(zip(outcomes, (share / share.sum()).tolist(), strict=True))


def design(outcomes: Sequence[str], table: NDArray[np.float64], names: Sequence[str]) -> NDArray[np.float64]:
    """Features and offsets of each outcome.

    Parameters
    ----------
    outcomes
        Outcomes of `features`.
    table
        (outcome, feature) their features.
    names
        Families that have an offset.

    Returns
    -------
    NDArray
        (outcome, feature and name) columns whose products with the weights are the utilities.
    """
    return np.hstack([table, np.array(outcomes)[:, None] == np.array(names)])


def expected_shares(utility: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities of outcomes whose utilities are uncertain.

    Parameters
    ----------
    utility
        (outcome,) means of the utilities.
    covariance
        (outcome, outcome) their covariance.

    Returns
    -------
    NDArray
        (outcome,) means over draws of the utilities; the sum is 1.
    """
    values, vectors = np.linalg.eigh(covariance)
    draws = np.random.default_rng(0).standard_normal((_DRAWS, len(utility)))
    utilities = utility + draws * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    shares = np.exp(utilities - utilities.max(axis=1, keepdims=True))
    return np.asarray((shares / shares.sum(axis=1, keepdims=True)).mean(axis=0))
