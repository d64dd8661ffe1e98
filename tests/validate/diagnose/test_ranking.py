"""Numbers of the ranking, without any fit."""

from types import SimpleNamespace

import pytest
from cboxlab.validation.diagnose.ranking import UNKNOWN, ranking


def candidate(effect, chi2):
    of_effect = SimpleNamespace(effect=SimpleNamespace(id=effect))
    return SimpleNamespace(hypothesis=of_effect, chi2=chi2, applied=SimpleNamespace(values={}), sigma={}, count=1)


def test_chi2_of_an_unknown_cause_is_that_of_the_best_single_effect_per_sample(monkeypatch):
    """Fitted in another covariance, chi2 is shifted by the difference of the two without any effect."""
    monkeypatch.setattr("cboxlab.validation.diagnose.ranking.penalised", lambda one: one.chi2)
    singles = [candidate("haze", 640.0), candidate("ghost", 600.0)]
    search = SimpleNamespace(singles=singles, first=SimpleNamespace(chi2=700.0))
    start = SimpleNamespace(chi2=800.0, count=200)
    found = {entry.effect: entry for entry in ranking(singles, search, [], start, 0.3, (UNKNOWN,))}
    assert found["haze"].chi2_per_dof == pytest.approx(740 / 200)
    assert found["ghost"].chi2_per_dof == found[UNKNOWN].chi2_per_dof == pytest.approx(700 / 200)
    assert found[UNKNOWN].probability == 0.3
    assert sum(entry.probability for entry in found.values()) == pytest.approx(1)
    assert found["ghost"].probability > found["haze"].probability
