"""Probabilities of families whose weights few simulations determine."""

import numpy as np
import pytest
from cboxlab.validation.diagnose.explain import NONE, SOUND
from cboxlab.validation.diagnose.explain.odds import FEATURES, design, expected_shares, learnt_odds

UTILITY = np.array([4.0, 1.0, 0.0])


def test_certain_weights_give_the_shares_of_a_conditional_logit():
    shares = np.exp(UTILITY) / np.exp(UTILITY).sum()
    np.testing.assert_allclose(expected_shares(UTILITY, np.zeros((3, 3))), shares, atol=1e-12)


def test_uncertain_weights_make_probabilities_less_extreme():
    """As a probit of the same mean has it: the slope falls by the root of 1 + pi / 8 times the variance."""
    most = [expected_shares(UTILITY[:2], np.diag([variance, 0.0]))[0] for variance in (0.0, 4.0, 16.0)]
    assert np.all(np.diff(most) < -0.03)
    assert most[2] == pytest.approx(1 / (1 + np.exp(-3 / np.sqrt(1 + np.pi / 8 * 16))), abs=0.02)


def test_what_all_outcomes_have_in_common_changes_nothing():
    np.testing.assert_allclose(
        expected_shares(UTILITY, 9 * np.ones((3, 3))), expected_shares(UTILITY, np.zeros((3, 3))), atol=1e-9
    )


def test_large_utilities_have_the_probabilities_of_their_differences():
    shares = np.exp(UTILITY) / np.exp(UTILITY).sum()
    np.testing.assert_allclose(expected_shares(UTILITY + 1000, np.zeros((3, 3))), shares, atol=1e-12)


def test_offsets_belong_to_their_families():
    outcomes, names = ("blur", "object", NONE, SOUND), ("object", "blur")
    columns = design(outcomes, np.zeros((4, len(FEATURES))), names)
    np.testing.assert_array_equal(columns[:, -2:], [[0, 1], [1, 0], [0, 0], [0, 0]])


def test_the_tables_covariance_is_one():
    """Of all weights, and positive: each row of the lower half is one number longer than the row before."""
    learnt = learnt_odds()
    rows = learnt["covariance"]
    assert [len(row) for row in rows] == list(range(1, len(FEATURES) + len(learnt["offsets"]) + 1))
    lower = np.zeros((len(rows), len(rows)))
    lower[np.tril_indices(len(rows))] = np.concatenate(rows)
    assert np.linalg.eigvalsh(lower + np.tril(lower, -1).T).min() > 0
