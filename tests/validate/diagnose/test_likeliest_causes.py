"""Statements on the likeliest causes: how like the residual their signatures are, and how far behind they fit."""

import numpy as np
import pytest
from cboxlab.rendering.effects import Effect, Parameter
from cboxlab.validation.diagnose.alternatives import likeliest_causes
from cboxlab.validation.diagnose.hypotheses import Hypothesis
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.search import Candidate

AMOUNT = Parameter("amount", null=0.0, low=-10.0, high=10.0, step=0.1)


def candidate(name, chi2, *pixels):
    effect = Effect(name, "filter", name, (AMOUNT,), lambda value, amount: value, "")
    predicted = np.append(np.array(pixels), np.zeros(11))
    return Candidate(Hypothesis(effect, (AMOUNT,), {}), {"amount": 2.0}, {"amount": 0.1}, chi2, predicted)


def test_cosines_and_distances_of_known_vectors():
    """The residual is (3, 4): signatures along it, along x, and against it; chi2 of 10, 26 and 9."""
    model = LinearModel(
        used=np.ones((1, 1, 2), bool),
        interior=np.ones(2, bool),
        patch=np.zeros(2, int),
        sigma=np.ones(2),
        priors=np.zeros((11, 11)),
        by_lamp=np.ones(2),
        basis=np.zeros((13, 0)),
        shared_errors=np.zeros((13, 1), np.float32),
        residual=np.append([3.0, 4.0], np.zeros(11)),
    )
    vectors = [
        candidate("against", 9.0, -6.0, -8.0),
        candidate("along", 10.0, 0.3, 0.4),
        candidate("x", 26.0, 5.0, 0.0),
        candidate("fourth", 30.0, 0.0, 0.0),
    ]
    along, against, x = likeliest_causes(model, vectors, ["along"])
    assert [c.effect for c in (along, against, x)] == ["along", "against", "x"]
    assert [c.cosine for c in (along, against, x)] == pytest.approx([1.0, -1.0, 0.6])
    assert [c.cosine_with_first for c in (along, against, x)] == pytest.approx([1.0, -1.0, 0.6])
    assert [c.behind_sigma for c in (along, against, x)] == pytest.approx([0.0, 0.0, 4.0])
    np.testing.assert_allclose(x.signature, [[[5.0, 0.0]]])
    (nothing,) = likeliest_causes(model, vectors[3:], [])
    assert np.isnan(nothing.cosine)
