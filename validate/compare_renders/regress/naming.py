"""Which change explains a difference: all explanations, weighed against each other and against none of them.

Each explanation costs half the logarithm of the number of data for each parameter (Schwarz 1978). Where even the
best leaves more than noise, log-likelihoods are divided by what it leaves per number: a shape that is not quite
right makes all less certain. `unknown` stands for an explanation of most of the difference that was not thought of.
"""

from __future__ import annotations

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress

from .evidence import Evidence, build_evidence
from .explanations import Explanation, from_pictures
from .outcome import NamedChange
from .transport_explanations import coats, from_scene
from .variants import Variants
from .verdict import Comparison
from .view_explanations import from_view

__all__ = ["named_changes"]

#: `unknown` explains this part of the excess.
_UNKNOWN_PART = 0.7
#: Numbers of explanations that make looking for a coat needless.
_FEW = 2
#: Explanations less probable are not listed.
_LEAST = 1e-4


def named_changes(
    found: Comparison, variants: Variants | None, progress: Progress = NO_PROGRESS
) -> tuple[NamedChange, ...]:
    """Best first; at least one, `unknown` where nothing fits. variants : of the scene, None where it is not known."""
    evidence = build_evidence(found)
    tried = [*from_pictures(evidence, found.common.baseline), *from_view(evidence)]
    if variants is not None:
        tried += from_scene(evidence, variants)
        progress.part(0.6)
        # explanations with many numbers imitate a coat
        if min(t.chi2 for t in tried if t.free <= _FEW) > _target(evidence):
            tried += coats(evidence, variants)
    return _weighed(evidence, tried)


def _excess(evidence: Evidence) -> tuple[float, float]:
    """Chi-square without any change, and what of it noise does not explain."""
    none = evidence.fit([]).chi2
    return none, max(none - evidence.numbers - 2.5 * np.sqrt(2 * evidence.numbers), 0.0)


def _target(evidence: Evidence) -> float:
    """Chi-square below which no further explanation is looked for."""
    none, excess = _excess(evidence)
    return max(none - 0.97 * excess, 0.0) if excess else 0.0


def _weighed(evidence: Evidence, tried: list[Explanation]) -> tuple[NamedChange, ...]:
    none, excess = _excess(evidence)
    cost = np.log(evidence.numbers)
    unknown = Explanation("unknown", {}, none - _UNKNOWN_PART * excess, 2)
    everything = [*tried, unknown]
    chi2 = np.array([e.chi2 for e in everything])
    softness = max(1.0, float(chi2.min()) / evidence.numbers)
    score = -0.5 * chi2 / softness - 0.5 * cost * np.array([e.free for e in everything])
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    named = []
    for change in dict.fromkeys(e.change for e in everything):
        own = [i for i, e in enumerate(everything) if e.change == change]
        best = max(own, key=lambda i: weight[i])
        share = float(weight[own].sum())
        if share >= _LEAST:
            found = everything[best]
            named.append(NamedChange(change, found.parameters, share, found.chi2 / evidence.numbers))
    return tuple(sorted(named, key=lambda n: -n.probability))
