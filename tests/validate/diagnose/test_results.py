"""Probabilities of effects and of an unknown cause."""

import importlib
from dataclasses import make_dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.diagnose.evidence import SHAPE_ERROR
from cboxlab.validation.diagnose.results import _NOTHING_MISSING, UNKNOWN, _shares, ranking

diagnosis_module = importlib.import_module("cboxlab.validation.diagnose.diagnosis")


def _candidate(name, chi2):
    hypothesis = SimpleNamespace(free=(None,), effect=SimpleNamespace(id=name))
    return SimpleNamespace(chi2=chi2, hypothesis=hypothesis, applied=SimpleNamespace(values={}), sigma={})


def _selected(candidate, *alternatives):
    return SimpleNamespace(
        candidate=candidate, alternatives=alternatives, chi2_without=2000.0, dispersion=1.0, count=1000
    )


def _probabilities(assessed, unknown, selected, imitations=None, sound=0.0):
    singles = [_candidate(name, chi2) for name, chi2 in (("haze", 1000.0), ("fog", 1010.0), ("ghost", 1200.0))]
    model = SimpleNamespace(chi2=2000.0, count=1000)
    search = SimpleNamespace(singles=singles, first=model)
    imitations = imitations or dict.fromkeys((name for name in selected if name != UNKNOWN), unknown)
    entries = ranking(singles, search, assessed, model, unknown, imitations, selected, sound=sound)
    return {r.effect: r.probability for r in entries}


@pytest.mark.parametrize("unknown", [0.0, 0.02, 0.3, 0.9])
def test_a_selected_effect_and_its_alternatives_share_what_an_unknown_cause_leaves(unknown):
    """Each of the two selected effects has 1 - P(unknown), the first together with what replaces it."""
    assessed = [
        _selected(_candidate("haze", 1000.0), _candidate("fog", 1010.0)),
        _selected(_candidate("ghost", 900.0)),
    ]
    names = ("haze", "ghost", UNKNOWN) if unknown > 0.02 else ("haze", "ghost")
    probability = _probabilities(assessed, unknown, names)
    assert probability[UNKNOWN] == unknown
    assert probability["haze"] + probability["fog"] == pytest.approx(1 - unknown)
    assert probability["ghost"] == pytest.approx(1 - unknown)
    assert probability["haze"] >= probability["fog"]


def test_each_effect_has_the_probability_that_it_imitates():
    """A lamp that misses its stated power does so next to any unknown cause in the picture."""
    assessed = [_selected(_candidate("haze", 1000.0)), _selected(_candidate("lamp-power", 1000.0))]
    imitations = {"haze": 0.7, "lamp-power": 0.02}
    probability = _probabilities(assessed, 0.7, ("haze", "lamp-power", UNKNOWN), imitations)
    assert probability["haze"] == pytest.approx(0.3)
    assert probability["lamp-power"] == pytest.approx(0.98)


@pytest.mark.parametrize("unknown", [0.3, 0.9])
def test_without_any_effect_all_of_them_share_what_an_unknown_cause_leaves(unknown):
    probability = _probabilities([], unknown, (UNKNOWN,))
    assert probability[UNKNOWN] == unknown
    assert sum(probability.values()) == pytest.approx(1.0)


def test_where_errors_hide_every_effect_the_others_have_no_probability():
    """A small picture behind a mosaic: no effect is large enough to be tried where the render's errors are counted."""
    start, by_size = SimpleNamespace(chi2=2000.0, count=1000), [_candidate("haze", 1990.0)]
    search = SimpleNamespace(singles=[], first=start)
    entries = {entry.effect: entry for entry in ranking(by_size, search, [], start, 0.1, {}, (), sound=0.0)}
    assert entries["haze"].probability == 0.0
    assert (entries[UNKNOWN].probability, entries[UNKNOWN].chi2_per_dof) == (0.1, 2.0)


def test_where_nothing_is_missing_effects_share_little():
    probability = _probabilities([], 0.02, ())
    assert sum(probability.values()) == pytest.approx(1 - _NOTHING_MISSING)


@pytest.mark.parametrize(("unknown", "sound", "others"), [(0.49, 0.51, 0.0), (0.6, 0.1, 0.3), (0.7, 0.4, 0.0)])
def test_next_to_a_bare_unknown_effects_share_what_a_sound_capture_leaves(unknown, sound, others):
    probability = _probabilities([], unknown, (UNKNOWN,), sound=sound)
    assert probability.pop(UNKNOWN) == unknown
    assert sum(probability.values()) == pytest.approx(others)


def test_chi2_of_an_unknown_cause_is_that_of_the_best_single_effect_per_sample():
    """Fitted in another covariance, chi2 is shifted by the difference of the two without any effect."""
    singles = [_candidate("haze", 640.0), _candidate("ghost", 600.0)]
    search = SimpleNamespace(singles=singles, first=SimpleNamespace(chi2=700.0))
    start = SimpleNamespace(chi2=800.0, count=200)
    entries = {entry.effect: entry for entry in ranking(singles, search, [], start, 0.3, {}, (UNKNOWN,), sound=0.0)}
    assert entries["haze"].chi2_per_dof == pytest.approx(740 / 200)
    assert entries["ghost"].chi2_per_dof == entries[UNKNOWN].chi2_per_dof == pytest.approx(700 / 200)
    assert entries["ghost"].probability > entries["haze"].probability


def test_shares_are_odds_widened_by_the_errors_of_shapes(monkeypatch):
    """A difference of 6 in chi2, over a dispersion and a part of what the best effect explains."""
    monkeypatch.setattr("cboxlab.validation.diagnose.results.penalised", lambda candidate: candidate)
    for without, explained in ((500.0, 400.0), (90.0, 0.0)):
        first, second = _shares([100.0, 106.0], without, 1.5)
        assert first + second == pytest.approx(1.0)
        assert np.log(first / second) == pytest.approx(3.0 / (1.5 + SHAPE_ERROR * explained))


def test_probabilities_follow_the_difference_of_chi2():
    """exp(-d / 2) over what differences scatter by: the dispersion, and a hundredth of what the best one explains.

    Each number costs 4.6: the second has one more than the others, and so much less of chi2.
    """
    trials = [
        SimpleNamespace(chi2=chi2 - 4.6 * numbers, hypothesis=SimpleNamespace(free=(None,) * numbers))
        for chi2, numbers in ((510.0, 1), (514.0, 2), (540.0, 1))
    ]
    scatter = 2.0 + 0.01 * (1510.0 - 510.0)
    weights = np.exp(-np.array([0.0, 4.0, 30.0]) / 2 / scatter)
    assert _shares(trials, 1510.0, 2.0) == pytest.approx(weights / weights.sum())
    assert _shares(trials[:1], 100.0, 1.0) == [1.0]


@pytest.mark.parametrize(
    ("sound", "next_to_flaws", "selected"), [(0.53, True, ()), (0.47, True, ("unknown",)), (0.53, False, ("unknown",))]
)
def test_a_pattern_without_effects_is_unknown_where_a_cause_is_likelier_than_a_sound_capture(
    monkeypatch, sound, next_to_flaws, selected
):
    """The odds do not count flaws that explain what remains: with these it is always unknown."""
    best = SimpleNamespace(
        single_pixels=False, separate=False, cause_probability=1 - sound, named_if_likely=lambda: best
    )
    remains = iter((True, next_to_flaws))
    monkeypatch.setattr(diagnosis_module, "residual_with_rendered", lambda linearised, effects: np.ones(2))
    monkeypatch.setattr(diagnosis_module, "something_remains", lambda model, residual, rendered: next(remains))
    monkeypatch.setattr(diagnosis_module.unexplained, "residual_data_of", lambda linearised, rest, capture: rest)
    monkeypatch.setattr(diagnosis_module.unexplained, "explanation_to_report", lambda several, *rest: several[0])
    monkeypatch.setattr(diagnosis_module, "explain_masked_families", lambda excess: ())
    monkeypatch.setattr(diagnosis_module, "explain", lambda excess, progress: best)
    fields = {"chi2": 9.0, "count": 2, "residual": np.ones(2), "whiten_used": lambda change: change}
    model = make_dataclass("Model", fields)(*fields.values())
    answer = diagnosis_module._Answer(SimpleNamespace(model=model), [], [], np.ones(2))
    judged = SimpleNamespace(flaws=SimpleNamespace(small=True, change_dn=np.full(2, 0.5)), unlisted=0.0)
    result = diagnosis_module._explained(SimpleNamespace(model=model), answer, judged, None, NO_PROGRESS)
    assert result.selected == selected
    assert result.explanation is (best if selected else None)
    assert result.unknown == pytest.approx(1 - sound)
