"""Probability, learnt from simulations, of an effect that imitates another cause.

A logistic regression on what the tests of an effect show. Its weights are data, see `learnt_weights`: made by
`benchmarks/diagnosis/learn_imitations.py --laboratories 6 --captures 9 --write`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ..hypotheses import INDISTINGUISHABLE_CHI2

__all__ = ["FEATURES", "LEAST_PROBABILITY", "Signs", "imitation_probability", "learnt_weights"]

#: Names of the features, with which the table states the weights.
FEATURES = (
    "constant",
    "log of 1 + what is missing of its gain in samples held out, over what noise and shapes miss",
    "signed log of 1 + the lead of the best form of an unlisted cause, over odds of 100 to 1",
)

#: Share of the gain in samples held out that a true effect may miss by errors of its shape.
_MISSED_BY_SHAPES = 0.02

#: Chi2 of the gain in samples held out that noise misses on average: two halves of the samples give amplitudes of
#: twice the variance each, whose difference squared is lost.
_MISSED_BY_NOISE = 4.0

#: Smallest probability of an unlisted cause: of 116 blind captures on perfect bases whose effects left nothing, 1 hid
#: one (`benchmarks/measured/blind_diagnosis.jsonl`); two of 118 by the rule of succession.
LEAST_PROBABILITY = 0.02

_TABLE = Path(__file__).parent / "data" / "imitations.json"


@dataclass(frozen=True)
class Signs:
    """Results of an effect's tests by which an imitation differs."""

    #: Chi2 per sample that it explains.
    gain: float
    #: Number of samples.
    count: int
    #: Gain in pixels or bands held out over that where fitted, the smaller; NaN where untested.
    heldout: float
    #: 2 ln of the evidence of the best form of an unlisted cause over that of the effect.
    lead: float
    #: The same of an event in a single frame, see `repeats.lead_of_frames`.
    frames: float = -np.inf
    #: 2 ln of the evidence that parts of its pattern have their own amplitudes, see `PartAmplitudes`.
    parts: float = -np.inf

    @property
    def features(self) -> NDArray[np.float64]:
        """(feature,) in the sequence of ``FEATURES``."""
        missing = 1 - np.clip(1.0 if np.isnan(self.heldout) else self.heldout, 0.0, 1.0)
        allowed = _MISSED_BY_SHAPES + _MISSED_BY_NOISE / max(self.gain * self.count, _MISSED_BY_NOISE)
        lead = np.sign(self.lead) * np.log1p(np.abs(self.lead) / INDISTINGUISHABLE_CHI2)
        return np.array([1.0, np.log1p(missing / allowed), lead])

    @property
    def least(self) -> float:
        """Least probability of an imitation.

        Events in single frames count at even odds: frames are compared without a model. That parts have their own
        amplitudes is as unlikely beforehand as any unlisted cause.
        """
        by_parts = self.parts / 2 + np.log(LEAST_PROBABILITY / (1 - LEAST_PROBABILITY))
        return max(float(expit(self.frames / 2)), float(expit(by_parts)), LEAST_PROBABILITY)


@lru_cache(maxsize=1)
def learnt_weights() -> Mapping[str, Any]:
    """Table of the weights, with the date and the numbers of simulated captures.

    Returns
    -------
    Mapping
        ``weights`` by feature, ``date``, ``captures``.
    """
    table: Mapping[str, Any] = json.loads(_TABLE.read_text(encoding="utf-8"))
    return table


def imitation_probability(signs: Signs) -> float:
    """Probability that an effect imitates an unlisted cause.

    Parameters
    ----------
    signs
        Results of its tests.

    Returns
    -------
    float
        0.02 to 1.
    """
    weights = learnt_weights()["weights"]
    utility = float(signs.features @ [weights[name] for name in FEATURES])
    return max(float(expit(utility)), signs.least)
