"""What is left of a residual with effects in place, and what a further effect is fitted to then."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.diagnose import linearised_fit
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.linearised_fit import _by_lamp_scale, refitted_together, residual_with
from cboxlab.validation.diagnose.search import Candidate, NumberStep
from helpers.captures.patterns import COUNT, laboratory, waves

PATTERNS = {"one": waves(1, 0), "two": waves(0, 2) + 0.5 * waves(1, 0)}


def candidate(by_name, name, amount):
    return Candidate(by_name[name].hypothesis, {"amount": amount}, {}, 0.0, np.zeros(COUNT + 11))


@pytest.mark.parametrize("scale", [1.0, 0.8])
def test_what_effects_add_is_taken_off_at_the_lamps_power(scale):
    linearised, by_name = laboratory(PATTERNS, {"one": 0.8}, scale=scale)
    before = residual_with(linearised, [])
    np.testing.assert_array_equal(before, linearised.model.residual)
    selection = [candidate(by_name, "one", 0.5), candidate(by_name, "two", -0.2)]
    change = scale * (0.5 * PATTERNS["one"] - 0.2 * PATTERNS["two"]).ravel()
    np.testing.assert_allclose(
        residual_with(linearised, selection), before - np.append(change, np.zeros(11)), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("scale", [1.0, 0.8])
def test_effects_fitted_together_end_at_the_least_squares(scale):
    """The amounts of least squares over both patterns; what either can do is free when the other is judged."""
    linearised, by_name = laboratory(PATTERNS, {"one": 0.8, "two": 0.3}, scale=scale)
    selection = [candidate(by_name, name, 0.1) for name in PATTERNS]
    result = refitted_together(linearised, selection)
    design = scale * np.array([PATTERNS[name].ravel() for name in PATTERNS]).T
    expected = np.linalg.lstsq(design, linearised.model.residual[:COUNT])[0]
    assert [c.numbers["amount"] for c in result] == pytest.approx(list(expected), abs=1e-4)
    # of the second, only what the first cannot do counts as its own
    effect_change = result[1].numbers["amount"] * scale * waves(0, 2).ravel()
    np.testing.assert_allclose(result[1].predicted[:COUNT], effect_change, atol=1e-5)
    rest = linearised.problem([candidate(by_name, "one", 0.5)])
    alone = np.append(PATTERNS["one"].ravel(), np.zeros(11))
    assert np.abs(rest.model.project(alone)).max() < 1e-9
    effect_change = rest.change(by_name["two"].hypothesis.at({"amount": 1.0}))
    size = float(np.sum(waves(0, 2) ** 2))
    assert float(effect_change @ effect_change) == pytest.approx(
        scale**2 * size, rel=1e-6
    )  # less what is like the first


def test_errors_shared_and_further_ones_are_counted_each_over_sigma(monkeypatch):
    """What is handed on as one standard deviation: two errors that the model shares, and one more in DN."""
    random = np.random.default_rng(3)
    linearised, _ = laboratory(PATTERNS, {}, scale=0.8)
    sigma, shared = random.uniform(1, 2, COUNT), random.standard_normal((COUNT + 11, 2))
    signal, more = random.uniform(1, 2, linearised.base.shape), random.standard_normal(COUNT)
    rendered = SimpleNamespace(fit=SimpleNamespace(lamp_scale=0.8), signal=signal, image=SimpleNamespace(coverage="c"))
    linearised = replace(
        linearised, rendered=rendered, model=replace(linearised.model, sigma=sigma, shared_errors=shared)
    )
    keywords = {}

    def errors(*arguments):
        keywords.update(zip(("signal", "coverage", "used", "sigma", "others"), arguments, strict=True))
        return "errors"

    monkeypatch.setattr(linearised_fit, "picture_errors", errors)
    monkeypatch.setattr(LinearModel, "counting", lambda model, change: change)
    assert linearised.counting_errors([more]).model == "errors"
    np.testing.assert_allclose(keywords["signal"], 0.8 * signal)
    np.testing.assert_array_equal(keywords["others"], [shared[:COUNT, 0], shared[:COUNT, 1], more / sigma])


@pytest.mark.parametrize("scale", [1.0, 0.8])
def test_what_numbers_of_chosen_effects_do_is_left_out_of_further_ones(monkeypatch, scale):
    """A number that turns one pattern into the other: free is the difference that its step makes, not the pattern."""
    linearised, by_name = laboratory(PATTERNS, {"one": 0.8}, scale=scale)
    selected, turned = candidate(by_name, "one", 0.5), candidate(by_name, "two", 0.3)
    monkeypatch.setattr(linearised_fit, "steps_of", lambda candidate_of: [NumberStep("amount", 1.0, turned)])
    problem = linearised.problem([selected])
    first, second = (np.append(PATTERNS[name].ravel(), np.zeros(11)) for name in PATTERNS)
    assert np.abs(problem.model.project(0.3 * second - 0.5 * first)).max() < 1e-9
    assert np.abs(problem.model.project(first)).max() > 0.1


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_noise_is_that_of_the_light_at_the_lamps_fitted_power(monkeypatch, scale):
    """The picture's own variance counts at the power's square, the camera's noise at the light that it makes."""
    shape, arguments = (2, 3, 4), {}
    picture, variance = np.full(shape, 100.0), np.full(shape, 9.0)
    values = {"camera_jacobian": np.zeros((10, *shape)), "tabulation_errors": None, "filter_steps_nm": None}
    values["free_columns"] = []
    for name, value in values.items():
        monkeypatch.setattr(linearised_fit, name, lambda *_, value=value: value)
    monkeypatch.setattr(linearised_fit, "model_variance", lambda signal_given: 0.01 * signal_given)
    monkeypatch.setattr(linearised_fit, "Predicted", SimpleNamespace)

    def built(**keywords):
        arguments.update(keywords)
        model = SimpleNamespace(marginalised_over=lambda columns: None, sigma=2.0)
        model.with_priors_of = lambda columns, missed: arguments.update(columns=columns, missed=missed) or model
        return model

    monkeypatch.setattr(linearised_fit, "build_linear_model", built)
    calibration = SimpleNamespace(
        predicted_variance=lambda signal_given: 2 * signal_given + 5,
        noise=SimpleNamespace(rounding_error_dn=0.0),
        bands=SimpleNamespace(
            shared_variance=lambda signal_given: 0.0,
            dark_sigma_dn=np.array([2.0, 4.0]),
            further_dark_dn=np.array([1.0, -2.0]),
            dark_changes=np.ones((2, *shape)),
        ),
        capture=SimpleNamespace(cell=None),
    )
    prepared = SimpleNamespace(
        calibration=calibration,
        scene=SimpleNamespace(lamp_radiance=np.ones_like),
        measured=None,
        lamp_sigma=0.02,
        free_scale=None,
        expected_camera=lambda arguments: None,
        responses=None,
        noise_reference_signal=lambda signal: 3 * signal,
    )
    predictor = SimpleNamespace(signal=lambda effects: picture, warp=None, lamp_scale=scale)
    predictor.with_camera = predictor.at_lamp = lambda _: predictor
    rendered = SimpleNamespace(
        fit=SimpleNamespace(lamp_scale=scale, camera=None),
        predictor=predictor,
        signal=picture,
        variance=variance,
        used=None,
        image=SimpleNamespace(coverage=None),
    )
    linearised_fit.linearised_fit(prepared, rendered, ())
    signal_given = 3 * 100 * scale
    np.testing.assert_allclose(arguments["variance"], 2 * signal_given + 5 + 0.01 * signal_given + 9 * scale**2)
    np.testing.assert_array_equal(arguments["derivative"][-1], picture)
    # the levels that were subtracted are that far above those of their prior
    np.testing.assert_array_equal(arguments["missed"], [-0.5, 0.5])
    np.testing.assert_array_equal(arguments["columns"], np.full((2, 1, *shape), 0.5))


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.7])
def test_the_lamps_light_is_what_grows_with_its_power(scale):
    """Light of 5 DN at the lamp's power and an offset of 2 DN of the counts, which is less of a brighter picture."""

    def at(power):
        return SimpleNamespace(lamp_scale=power, at_lamp=at, signal=lambda effects: np.full(3, 5.0 + 2.0 / power))

    np.testing.assert_allclose(_by_lamp_scale(at(scale), []), 5.0, rtol=1e-6)
