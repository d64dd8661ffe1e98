"""Which alternatives a capture cannot distinguish from a selected effect."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.diagnose import alternatives
from cboxlab.validation.diagnose.alternatives import (
    SelectedEffect,
    confirmed_where_held_out,
    holds_with_remainder,
    with_better_alternatives,
)
from cboxlab.validation.diagnose.evidence import INDISTINGUISHABLE_CHI2, SHAPE_ERROR


def _candidate(name, chi2, tolerance=0.0, by_priors=False):
    free = (SimpleNamespace(name="size", null=0.0, tolerance=tolerance),)
    hypothesis = SimpleNamespace(free=free, effect=SimpleNamespace(id=name))
    return SimpleNamespace(chi2=chi2, hypothesis=hypothesis, by_priors=by_priors, numbers={"size": 1.0})


def _selected(behind, dispersion, gain):
    leader, other = _candidate("own", 1000.0), _candidate("other", 1000.0 + behind)
    return SelectedEffect(leader, (other,), 1000.0 + gain, np.nan, np.nan, np.nan, 5000, dispersion)


@pytest.mark.parametrize("dispersion", [1.0, 4.0])
def test_chi2_differences_scatter_by_the_dispersion(dispersion):
    limit = INDISTINGUISHABLE_CHI2 * dispersion
    for behind, is_stated in ((0.99 * limit, False), (1.01 * limit, True)):
        selection = _selected(behind, dispersion, gain=100.0)
        assert (not selection.indistinguishable) == is_stated
        assert selection.certainty == pytest.approx(np.sqrt(100.0 / dispersion))


def test_of_a_large_effect_the_errors_of_shapes_count():
    limit = SHAPE_ERROR * 1e5
    assert _selected(0.99 * limit, 1.0, gain=1e5).indistinguishable
    assert not _selected(1.01 * limit, 1.0, gain=1e5).indistinguishable


@pytest.mark.parametrize("edge_artefact", [True, False])
def test_what_comes_of_edges_is_dropped(monkeypatch, edge_artefact):
    monkeypatch.setattr(alternatives, "with_alternatives", lambda linearised, selection, signatures: [])
    leader = _candidate("own", 1000.0)
    effect = SelectedEffect(leader, (), 2000.0, 1.0, 1.0, 0.01, 5000, 1.0, edge_artefact)
    confirmed, _ = confirmed_where_held_out(None, [leader], [effect], [])
    assert confirmed == ([] if edge_artefact else [leader])


@pytest.mark.parametrize(("tolerance", "holds"), [(0.2, True), (0.5, False)])
def test_a_number_that_is_within_its_tolerance_in_the_end_is_dropped(monkeypatch, tolerance, holds):
    """Five tolerances come by chance in 6e-7 of boxes, two in 5 of 100."""
    monkeypatch.setattr(alternatives, "with_alternatives", lambda linearised, selection, signatures: [])
    leader = _candidate("own", 1000.0, tolerance)
    effect = SelectedEffect(leader, (), 2000.0, 1.0, 1.0, 0.01, 5000, 1.0)
    confirmed, _ = confirmed_where_held_out(None, [leader], [effect], [])
    assert confirmed == ([leader] if holds else [])


@pytest.mark.parametrize(("behind", "first"), [(3.0, "own"), (-3.0, "other")])
def test_of_two_that_are_indistinguishable_the_likelier_is_selected(monkeypatch, behind, first):
    """Three of chi-square are less than distinguishes two effects; the ranking shows the same one first."""
    leader, other = _candidate("own", 1000.0), _candidate("other", 1000.0 + behind)

    def assessed(linearised, selection, signatures):
        rival = other if selection[0] is leader else leader
        return [SelectedEffect(selection[0], (rival,), 2000.0, np.nan, np.nan, np.nan, 5000, 1.0)]

    monkeypatch.setattr(alternatives, "with_alternatives", assessed)
    monkeypatch.setattr(alternatives, "refitted_together", lambda linearised, selection: list(selection))
    (candidate,), (effect,) = with_better_alternatives(None, [leader], [])
    assert candidate.hypothesis.effect.id == effect.candidate.hypothesis.effect.id == first
    assert effect.indistinguishable


@pytest.mark.parametrize("by_priors", [True, False])
def test_what_remains_in_the_picture_is_no_matter_to_an_effect_that_priors_judge(by_priors):
    leader = _candidate("own", 1000.0, by_priors=by_priors)
    effect = SelectedEffect(leader, (), 1040.0, np.nan, np.nan, np.nan, 5000, 1.0)
    assert holds_with_remainder([effect], 0.01) is by_priors


def test_the_amplitude_of_a_prediction_is_that_of_least_squares():
    """And its gain is what it takes off chi2."""
    predicted, residual = np.array([2.0, -1.0, 3.0]), np.array([4.0, 1.0, 5.0])
    amplitude = alternatives._amplitude(residual, predicted)
    assert amplitude == pytest.approx(np.linalg.lstsq(predicted[:, None], residual, rcond=None)[0][0])
    remainder = residual - amplitude * predicted
    assert alternatives._gain(residual, predicted, amplitude) == pytest.approx(
        residual @ residual - remainder @ remainder
    )
