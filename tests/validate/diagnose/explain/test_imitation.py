"""Probability that an effect imitates another cause, by what its tests show."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.explain.imitation import (
    FEATURES,
    LEAST_PROBABILITY,
    Signs,
    imitation_probability,
    learnt_weights,
)

#: A medium effect on a base that is off by a tenth of it, far ahead of all forms of unlisted causes.
_CLEAR = Signs(gain=1.0, flaws=0.1, count=10_000, heldout=1.0, lead=-1000.0)


def test_an_effect_that_explains_far_more_than_flaws_and_holds_everywhere_is_real():
    assert imitation_probability(_CLEAR) < 0.1
    assert imitation_probability(replace(_CLEAR, gain=100.0, flaws=0.0)) == LEAST_PROBABILITY


@pytest.mark.parametrize(
    ("worse", "values"),
    [
        ("flaws", (0.1, 0.5, 2.0)),
        ("heldout", (1.0, 0.8, 0.5)),
        ("lead", (5.0, 9.2, 20.0)),
        ("frames", (-9.0, 5.0, 9.0)),
    ],
)
def test_each_sign_of_an_imitation_makes_it_likelier(worse, values):
    """Flaws that explain as much as the effect, gains that fall short where it was not fitted, forms that come near."""
    weak = replace(_CLEAR, gain=0.1)
    probabilities = [imitation_probability(replace(weak, **{worse: value})) for value in values]
    assert np.all(np.diff(probabilities) > 0)


def test_noise_in_samples_held_out_counts_little_for_a_weak_effect():
    """A tenth of the gain is what noise takes from a small effect, and no noise takes from a large one."""
    few, many = (replace(_CLEAR, gain=0.02, heldout=0.9, count=count) for count in (5_000, 500_000))
    assert imitation_probability(few) < imitation_probability(many)


def test_a_form_that_explains_far_more_than_the_effect_takes_its_place():
    """Even odds of a form alone do not: two forms may predict the same picture, and the effect is the usual cause."""
    assert imitation_probability(replace(_CLEAR, lead=1000.0)) > 0.5
    assert imitation_probability(replace(_CLEAR, lead=0.0)) < 0.5


def test_what_was_not_tested_counts_neither_way():
    untested = replace(_CLEAR, heldout=float("nan"))
    assert imitation_probability(untested) == imitation_probability(_CLEAR)


def test_the_table_has_a_weight_for_every_feature():
    table = learnt_weights()
    assert set(table["weights"]) == set(FEATURES)
    assert 0 < table["imitations"] < table["captures"]
