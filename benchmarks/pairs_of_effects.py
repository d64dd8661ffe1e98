"""Pairs of effects that a capture cannot tell from other pairs, to first order.

Each two effects of the catalogue act together, each so large that it alone would gain a stated chi2; the share of their
change that other pairs explain follows from the products of all effects' changes. A pair is told where one of its two
can be exchanged, so what counts are the pairs that only two others together can imitate.
"""

from __future__ import annotations

import argparse
import os
from itertools import combinations
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.model import Model
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose.evidence import INDISTINGUISHABLE_CHI2
from cboxlab.validation.diagnose.linearised_fit import linearised_fit
from cboxlab.validation.diagnose.selection import NormalEquations
from cboxlab.validation.diagnose.stepwise import signatures_of


def main() -> None:
    """Print how many pairs cannot be told from others, and which."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path, help="a capture in which no effect is hidden, of the published box")
    parser.add_argument("--chi2", type=float, default=200.0, help="what each of the two effects alone would gain")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    model = Model()
    validation = validate_capture(load_capture(arguments.capture), model)
    fit = linearised_fit(validation.prepared, validation.rendered, ())
    known = signatures_of(fit, (), model.render, NO_PROGRESS)
    able = [one for one in known if one.changes is not None and one.hypothesis.free]
    equations = NormalEquations.of(fit.problem(()), able, fit.model.residual)
    products, effects = equations.products.astype(float), [one.hypothesis.effect.id for one in able]
    columns = [np.flatnonzero(equations.owner == index) for index in range(len(able))]
    rivals = []
    for i, j in combinations(range(len(able)), 2):
        if effects[i] != effects[j]:
            own = np.append(columns[i], columns[j])
            rivals.append((frozenset((effects[i], effects[j])), own, np.linalg.inv(products[np.ix_(own, own)])))
    draw = np.random.default_rng(arguments.seed)

    def change(effect: str) -> np.ndarray:
        """One of the effect's ways to act, at the stated chi2, in random proportions of its numbers."""
        own = columns[draw.choice([i for i, one in enumerate(effects) if one == effect])]
        amplitude = np.zeros(len(products))
        amplitude[own] = draw.standard_normal(len(own))
        return amplitude * np.sqrt(arguments.chi2 / (amplitude @ products @ amplitude))

    pairs = list(combinations(sorted(set(effects)), 2))
    one_exchanged, both = 0, []
    for pair in pairs:
        cause = change(pair[0]) + change(pair[1])
        aim = products @ cause
        left: dict[int, tuple[float, tuple[str, ...]]] = {1: (np.inf, pair), 2: (np.inf, pair)}
        for names, own, inverse in rivals:
            if exchanged := len(names - set(pair)):
                lacks = float(cause @ aim - aim[own] @ inverse @ aim[own])
                left[exchanged] = min(left[exchanged], (lacks, tuple(sorted(names))))
        one_exchanged += left[1][0] < INDISTINGUISHABLE_CHI2
        if left[2][0] < INDISTINGUISHABLE_CHI2 <= left[1][0]:
            both.append((pair, *left[2]))
    print(f"{len(pairs)} pairs of {len(set(effects))} effects, each of chi2 {arguments.chi2:g} alone")
    print(f"one of the two can be exchanged (chi2 within {INDISTINGUISHABLE_CHI2}): {one_exchanged}")
    print(f"only both together can: {len(both)}")
    for pair, lacks, others in both:
        print(f"  {' and '.join(pair)}: as {' and '.join(others)}, chi2 {lacks:.1f} more")


if __name__ == "__main__":
    main()
