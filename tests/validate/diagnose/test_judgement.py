"""Judgement of effects next to the flaws of a base."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.diagnose import judgement
from cboxlab.validation.diagnose.base_flaws import Flaw, FlawModel, PartAmplitudes
from cboxlab.validation.diagnose.judgement import BaseFlaws

COUNT = 400
CANDIDATE = SimpleNamespace(hypothesis=SimpleNamespace(effect=SimpleNamespace(id="lamp")), by_priors=False, numbers=[1])


@pytest.mark.parametrize(
    ("kinds", "imitated"), [((), False), (("pixels",), False), (("pixels", "creases"), True), (("field",), True)]
)
def test_effects_imitate_every_flaw_but_single_pixels(kinds, imitated):
    flaws = BaseFlaws(tuple(Flaw(kind, 0.1, 1.0, 0.8) for kind in kinds), True, np.zeros(3), np.zeros(3))
    assert flaws.imitated is imitated


def sound_base(residual):
    """Flaws without columns: residuals have unit variance."""
    model = SimpleNamespace(
        model=SimpleNamespace(count=COUNT),
        whitened=lambda vector: vector,
        fit=lambda vector: SimpleNamespace(score=float(vector @ vector)),
        weighted=lambda _, columns: columns,
        amplitudes_by_part=lambda *_: PartAmplitudes(),
        amounts=FlawModel.amounts,
    )
    model.fit_with = partial(FlawModel.fit_with, model)
    return SimpleNamespace(model=model, residual=residual)


@pytest.mark.parametrize(("sigmas", "holds"), [(0.0, False), (3.0, False), (20.0, True)])
def test_an_effect_holds_by_its_amplitude_and_one_that_changes_nothing_does_not(sigmas, holds):
    rest = np.random.default_rng(3).standard_normal(COUNT)
    shape = np.ones(COUNT) / np.sqrt(COUNT)
    rest -= shape * (shape @ rest)
    verdict = judgement.verdict_of(CANDIDATE, rest + sigmas * shape, rest, sound_base(rest))
    assert verdict.holds is holds
    assert verdict.certainty == pytest.approx(sigmas, abs=1e-9)
    assert verdict.gain == pytest.approx(sigmas**2 / COUNT)
    assert verdict.holds_next_to_flaws is holds


@pytest.mark.parametrize(
    ("free", "relief", "holds"), [(1, 12.0, False), (1, 14.0, True), (6, 24.0, False), (6, 27.0, True)]
)
def test_an_effect_that_priors_judge_holds_if_it_relieves_them_by_more_than_chance(free, relief, holds):
    """Odds of 3e-4: 3.6 standard deviations squared for one number, 25.3 for six."""
    hypothesis = SimpleNamespace(effect=SimpleNamespace(id="lamp-power"), free=range(free))
    candidate = SimpleNamespace(hypothesis=hypothesis, by_priors=True)
    rest = np.ones(COUNT)
    in_priors, in_picture, strained = rest.copy(), rest.copy(), rest.copy()
    in_priors[-11:] *= np.sqrt(1 + relief / 11)
    in_picture[:-11] *= np.sqrt(1 + relief / (COUNT - 11))
    strained[:-11] *= 2
    assert judgement.verdict_of(candidate, in_priors, rest, sound_base(rest)).holds is holds
    assert not judgement.verdict_of(candidate, in_picture, rest, sound_base(rest)).holds
    assert not judgement.verdict_of(candidate, in_priors, strained, sound_base(strained)).holds


def test_flaws_next_to_an_explanation_are_those_of_what_it_leaves(monkeypatch):
    noise, cause = np.random.default_rng(4).standard_normal((2, 5, 6, 7))
    linearised = SimpleNamespace(model=SimpleNamespace(whiten=np.ravel))
    monkeypatch.setattr(judgement, "flaws_of", lambda fit, rest: (fit, rest))
    fit, rest = judgement.flaws_without(linearised, (noise + cause).ravel(), cause)
    assert fit is linearised
    assert rest == pytest.approx(noise.ravel())


def test_indirect_light_is_that_of_a_white_surface():
    """A quarter of 6 DN at a reflectance of 0.5 are 3 DN; a mirror's direct light may exceed its total by noise."""
    reflectance, direct_share = np.array([0.5, 0.5, 0.0]), np.array([0.75, 1.05, 0.0])
    arriving = judgement._arriving_indirectly(np.full(3, 6.0), reflectance, direct_share)
    assert arriving.tolist() == pytest.approx([3.0, 0.0, 0.0])


@pytest.mark.parametrize("certainty", [6.0, 100.0])
def test_an_amplitude_may_change_next_to_flaws_by_its_own_error_or_a_fixed_part(certainty):
    """The larger of both; a verdict just below and just above."""
    for part, holds in ((0.99, True), (1.01, False)):
        # s - 1 = n s / c, where s / c is its error
        by_error = 1 / (1 - part * judgement.SIGNIFICANT_SIGMA / certainty) - 1
        stability = 1 + max(by_error, part * judgement._MAX_INSTABILITY)
        verdict = judgement.Verdict("x", 1.0, 1e6, certainty, stability, True)
        assert verdict.holds_next_to_flaws is holds, stability


def test_rivals_of_effects_that_hold_meet_the_flaws_too(monkeypatch):
    """One that fits better only because the base is off wins without the flaws; next to them it is compared again."""
    models, rival = [], SimpleNamespace(hypothesis=SimpleNamespace(effect=SimpleNamespace(id="glare")))

    def better(linearised, selected, _):
        models.append(linearised.model)
        return [rival], ["assessed"]

    flaws = SimpleNamespace(model=SimpleNamespace(counted_in=lambda plain, _: f"{plain} with flaws"), fitted=None)
    verdicts = (judgement.Verdict("glare", 0.1, 90.0, 9.0, 1.0, True),)
    monkeypatch.setattr(judgement, "replace", lambda value, **new: SimpleNamespace(**{**vars(value), **new}))
    monkeypatch.setattr(judgement, "with_better_alternatives", better)
    monkeypatch.setattr(judgement, "refitted_together", lambda linearised, selected: list(selected))
    monkeypatch.setattr(judgement, "confirmed_with_flaws", lambda linearised, selected: (selected, flaws, verdicts))
    monkeypatch.setattr(judgement, "with_alternatives", lambda linearised, *_: models.append(linearised.model) or [])
    monkeypatch.setattr(judgement, "tested_without_errors", lambda linearised, assessed: assessed)
    monkeypatch.setattr(judgement, "confirmed_where_held_out", lambda linearised, selected, *_: (selected, []))
    settled = judgement.settled_with_flaws(SimpleNamespace(model="plain"), [CANDIDATE], flaws, (), ())
    assert [c.hypothesis.effect.id for c in settled.selected] == ["glare"]
    assert models == ["plain with flaws", "plain with flaws"]
    assert [verdict.holds for verdict in settled.verdicts] == [True]
