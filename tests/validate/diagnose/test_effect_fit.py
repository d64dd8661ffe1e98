"""Effects of one's own choice, fitted to patterns over noise: the amounts of least squares."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.rendering.model import Model
from cboxlab.scenes import cornell_box
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose import effect_fit
from helpers.captures.patterns import COUNT, laboratory, waves

PATTERNS = {"one": waves(1, 0), "two": waves(0, 2) + 0.3 * waves(1, 0), "third": waves(2, 1)}


@pytest.fixture
def fitted(monkeypatch):
    """A function of start amounts by name and of those that are fitted, to the amounts found; and the residual."""
    linearised, by_name = laboratory(PATTERNS, {"one": 0.8, "two": -0.4})
    # no neighbourhoods: standard deviations by noise alone
    linearised = replace(linearised, model=replace(linearised.model, patch=np.zeros(COUNT, int)))
    band = SimpleNamespace(f_number=8.0)
    capture = SimpleNamespace(manifest=SimpleNamespace(band=[band]))
    prepared = SimpleNamespace(scene=cornell_box(), calibration=SimpleNamespace(capture=capture))
    validation = SimpleNamespace(
        model=Model(), prepared=prepared, rendered=None, comparison=SimpleNamespace(bands=("a", "b", "c"))
    )
    monkeypatch.setattr(effect_fit, "linearised_fit", lambda prepared, rendered, base, added: linearised)

    def fit(start, names):
        effects = [AppliedEffect(by_name[name].hypothesis.effect, {"amount": a}) for name, a in start.items()]
        fits = effect_fit.fit_effects([validation], effects, [list(start).index(name) for name in names])
        return {effect.id: effect for effect in fits}

    return fit, linearised.model.residual[:COUNT]


def amounts(names, residual):
    design = np.array([PATTERNS[name].ravel() for name in names]).T
    return dict(zip(names, np.linalg.lstsq(design, residual)[0], strict=True))


@pytest.mark.parametrize("start", [0.1, 5.0])
def test_one_effect_has_the_amount_of_least_squares_and_its_error(fitted, start):
    fit, residual = fitted
    fit_of_effect = fit({"one": start}, ["one"])["one"]
    assert fit_of_effect.values["amount"] == pytest.approx(amounts(["one"], residual)["one"], rel=1e-5)
    assert fit_of_effect.sigma["amount"] == pytest.approx(COUNT**-0.5, rel=1e-5)


@pytest.mark.parametrize(("stage", "error"), [("transport", 0.03), ("optics", 0.0)])
def test_predicted_transport_has_an_error(stage, error):
    """Three in a hundred of what differs from the rendered picture: 4 - 1 = 3."""
    effect = replace(catalogue()["veiling-glare"], stage=stage)
    stand_in = SimpleNamespace(applied=AppliedEffect(effect, {"fraction": 4.0}), sigma={"fraction": 0.04})
    sigma = effect_fit._with_shape_error(stand_in, [AppliedEffect(effect, {"fraction": 1.0})])
    assert sigma["fraction"] == pytest.approx(np.hypot(0.04, error * 3))
    assert effect_fit._with_shape_error(stand_in, [])["fraction"] == pytest.approx(np.hypot(0.04, error * 4))


def test_two_effects_are_fitted_with_each_other_in_place(fitted):
    """Two rounds leave the part of a part that their likeness of 0.3 makes: a hundredth of the error."""
    fit, residual = fitted
    fits = fit({"one": 0.1, "two": 0.1}, ["one", "two"])
    for name, expected in amounts(["one", "two"], residual).items():
        assert fits[name].values["amount"] == pytest.approx(expected, abs=0.02)


def test_the_last_of_two_knows_the_first_and_what_is_not_chosen_stays(fitted):
    fit, residual = fitted
    fits = fit({"one": 0.5, "third": 0.25}, ["one"])
    assert fits["third"].values["amount"] == 0.25 and not fits["third"].sigma
    assert fits["one"].values["amount"] == pytest.approx(amounts(["one"], residual)["one"], rel=1e-5)
    with pytest.raises(InputError, match="no effect"):
        fit({"one": 0.5}, [])
