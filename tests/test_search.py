"""The stated errors of an effect's parameters, for residuals that are more than independent noise; what counts."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.scenes import cornell_box
from cboxlab.validate.hypotheses import hypotheses
from cboxlab.validate.linear_model import LinearModel
from cboxlab.validate.search import (
    Candidate,
    _deviation,
    _from_coordinate,
    _to_coordinate,
    clustered_variance,
)
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
    model = SimpleNamespace(count=1000, project=lambda vector: vector)

    def candidate(name, predicted):
        left = residual - predicted
        return Candidate(known[name], {}, {}, float(left @ left), predicted)

    moved, offset = np.zeros(1011), np.zeros(1011)
    moved[-11], offset[:5] = 9.0, 1.0
    lucky, pose = candidate("dark-offset", offset), candidate("camera-pose", moved)
    assert first_worthy([lucky, pose], residual, model, residual) is pose
    assert first_worthy([lucky, candidate("camera-pose", offset)], residual, model, residual) is None


def test_a_gain_must_exceed_the_flaws_of_shapes_that_are_not_rendered_anew():
    """Of 10^5 explained a hundredth may be an effect's own error; nothing of it where the picture is new."""
    known = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), False)}
    model = SimpleNamespace(count=1000, project=lambda vector: vector)
    residual, rendered = np.zeros(1011), np.zeros(1011)
    residual[0], rendered[1] = 10.0, np.sqrt(1e5 + 100)
    offset = Candidate(known["dark-offset"], {}, {}, 0.0, residual)
    assert first_worthy([offset], residual, model, rendered) is None
    assert first_worthy([offset], residual, model, residual) is offset


def test_the_error_of_an_index_is_not_that_of_its_coordinate():
    """Filter shift is searched in 1 / n^2; a small error of that, as an index' own."""
    (p,) = next(h for h in hypotheses(("f400",), cornell_box(), False) if h.effect.id == "filter-shift").free
    coordinate, error = _to_coordinate(p, 2.0), 1e-6
    ends = [_from_coordinate(p, coordinate + sign * error) for sign in (-1, 1)]
    assert _deviation(p, 2.0, error) == pytest.approx((ends[0] - ends[1]) / 2, rel=1e-4)
