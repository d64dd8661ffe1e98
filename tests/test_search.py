"""The stated errors of an effect's parameters, for residuals that are more than independent noise; what counts."""

from types import SimpleNamespace

import numpy as np
from cboxlab.scenes import cornell_box
from cboxlab.validate.hypotheses import hypotheses
from cboxlab.validate.linear_model import LinearModel
from cboxlab.validate.search import Candidate, clustered_variance
from cboxlab.validate.selection import first_worthy

PATCHES, EACH, TRIALS = 64, 30, 600


def test_parameter_errors_hold_for_flaws_common_to_a_neighbourhood():
    """Residuals with a common part in each patch: estimates over their stated error have unit variance.

    The variance of 600 standard normal numbers is 1 +- 0.058; a few per cent are lost to 64 patches. With
    independent noise assumed it would be 1 + 0.25 * 29 * (pattern's share), several times too much.
    """
    generator = np.random.default_rng(11)
    count = PATCHES * EACH
    patch = np.repeat(np.arange(PATCHES), EACH)
    everything = np.ones((1, PATCHES, EACH), bool)
    model = LinearModel(
        everything,
        np.ones(count, bool),
        patch,
        np.ones(count),
        np.zeros((11, 11)),
        np.zeros((count + 11, 11)),
        np.zeros(count + 11),
    )
    column = np.append(1 + 0.3 * generator.standard_normal(count), np.zeros(11))
    inverse = np.array([[1 / (column @ column)]])
    honest, naive = [], []
    for _ in range(TRIALS):
        flaw = 0.5 * generator.standard_normal(PATCHES)[patch]
        residual = np.append(flaw + generator.standard_normal(count), np.zeros(11))
        estimate = float(column @ residual) * inverse[0, 0]
        left = residual - estimate * column
        honest.append(estimate / np.sqrt(clustered_variance(model, column[:, None], inverse, left)[0]))
        naive.append(estimate / np.sqrt(inverse[0, 0]))
    assert 0.8 < np.var(honest) < 1.25  # 4 standard deviations, and the bias of 64 patches
    assert np.var(naive) > 4


def test_what_relieves_a_prior_is_found_behind_what_gains_more_by_chance():
    """Strain of 10 standard deviations: relieved by the camera's motion, beside an offset that gains chi2 elsewhere."""
    known = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), False)}
    residual = np.zeros(1011)
    residual[:5], residual[-11] = 1.0, 10.0
    model = SimpleNamespace(count=1000, chi2=105.0)

    def candidate(name, predicted):
        left = residual - predicted
        return Candidate(known[name], {}, {}, float(left @ left), predicted)

    moved, offset = np.zeros(1011), np.zeros(1011)
    moved[-11], offset[:5] = 9.0, 1.0
    lucky, pose = candidate("dark-offset", offset), candidate("camera-pose", moved)
    assert first_worthy([lucky, pose], residual, model) is pose
    assert first_worthy([lucky, candidate("camera-pose", offset)], residual, model) is None
