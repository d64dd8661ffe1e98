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

#: A medium effect far ahead of all forms of unlisted causes.
_CLEAR = Signs(gain=1.0, count=10_000, heldout=1.0, lead=-1000.0)


def test_an_effect_far_ahead_of_all_forms_that_holds_everywhere_is_real():
    assert imitation_probability(_CLEAR) < 0.1
    assert imitation_probability(replace(_CLEAR, lead=-1e6)) == LEAST_PROBABILITY


@pytest.mark.parametrize(
    ("worse", "values"),
    [
        ("heldout", (1.0, 0.8, 0.5)),
        ("lead", (-20.0, -5.0, 5.0, 20.0)),
        ("frames", (-9.0, 5.0, 9.0)),
        ("parts", (-9.0, 9.0, 20.0)),
    ],
)
def test_each_sign_of_an_imitation_makes_it_likelier(worse, values):
    """Gains that fall short where it was not fitted, forms that come near, events in frames, parts that differ."""
    weak = replace(_CLEAR, gain=0.1, lead=-100.0)
    probabilities = [imitation_probability(replace(weak, **{worse: value})) for value in values]
    assert np.all(np.diff(probabilities) > 0)


def test_noise_in_samples_held_out_counts_little_for_a_weak_effect():
    """A tenth of the gain is what noise takes from a small effect, and no noise takes from a large one."""
    weak = replace(_CLEAR, gain=0.02, heldout=0.9, lead=-100.0)
    few, many = (replace(weak, count=count) for count in (5_000, 500_000))
    assert imitation_probability(few) < imitation_probability(many)


def test_a_form_that_explains_far_more_than_the_effect_takes_its_place():
    """One that comes as near leaves about even odds: two causes that predict the same picture are not distinguished."""
    assert imitation_probability(replace(_CLEAR, lead=1000.0)) > 0.9
    assert 0.3 < imitation_probability(replace(_CLEAR, lead=0.0)) < 0.5


def test_what_was_not_tested_counts_neither_way():
    untested = replace(_CLEAR, heldout=float("nan"))
    assert imitation_probability(untested) == imitation_probability(_CLEAR)


def test_the_table_has_a_weight_for_every_feature():
    table = learnt_weights()
    assert set(table["weights"]) == set(FEATURES)
    assert 0 < table["imitations"] < table["captures"]
