"""Probabilities of effects and of an unknown cause."""

from types import SimpleNamespace

import pytest
from cboxlab.validation.diagnose.ranking import _NOTHING_MISSING, UNKNOWN, ranking


def _candidate(name, chi2):
    hypothesis = SimpleNamespace(free=(None,), effect=SimpleNamespace(id=name))
    return SimpleNamespace(chi2=chi2, hypothesis=hypothesis, applied=SimpleNamespace(values={}), sigma={})


def _selected(candidate, *alternatives):
    return SimpleNamespace(
        candidate=candidate, alternatives=alternatives, chi2_without=2000.0, dispersion=1.0, count=1000
    )


def _probabilities(assessed, unknown, selected):
    singles = [_candidate(name, chi2) for name, chi2 in (("one", 1000.0), ("like-one", 1010.0), ("two", 1200.0))]
    model = SimpleNamespace(chi2=2000.0, count=1000)
    search = SimpleNamespace(singles=singles, first=model)
    return {r.effect: r.probability for r in ranking(singles, search, assessed, model, unknown, selected)}


@pytest.mark.parametrize("unknown", [0.0, 0.02, 0.3, 0.9])
def test_a_selected_effect_and_its_alternatives_share_what_an_unknown_cause_leaves(unknown):
    """Each of two selected effects has 1 - P(unknown), the first together with what replaces it."""
    assessed = [
        _selected(_candidate("one", 1000.0), _candidate("like-one", 1010.0)),
        _selected(_candidate("two", 900.0)),
    ]
    names = ("one", "two", UNKNOWN) if unknown > 0.02 else ("one", "two")
    found = _probabilities(assessed, unknown, names)
    assert found[UNKNOWN] == unknown
    assert found["one"] + found["like-one"] == pytest.approx(1 - unknown)
    assert found["two"] == pytest.approx(1 - unknown)
    assert found["one"] >= found["like-one"]


@pytest.mark.parametrize("unknown", [0.3, 0.9])
def test_without_any_effect_all_of_them_share_what_an_unknown_cause_leaves(unknown):
    found = _probabilities([], unknown, (UNKNOWN,))
    assert found[UNKNOWN] == unknown
    assert sum(found.values()) == pytest.approx(1.0)


def test_where_nothing_is_missing_effects_share_little():
    found = _probabilities([], 0.02, ())
    assert sum(found.values()) == pytest.approx(1 - _NOTHING_MISSING)
