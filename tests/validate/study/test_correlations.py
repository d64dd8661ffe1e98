"""Correlations of fitted numbers against the inverse of the complete information, camera and lamp included."""

from dataclasses import replace
from types import SimpleNamespace

import cboxlab
import numpy as np
import pytest
from cboxlab.rendering.effects import apply_checked
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.diagnose import nuisance_priors
from cboxlab.validation.report import correlation_section
from cboxlab.validation.study import HARDLY_DISTINGUISHED, Correlations, fitted_correlations, predict
from helpers.captures.glare_capture import glare_capture

pytestmark = pytest.mark.usefixtures("large_patches")


def test_correlations_are_those_of_the_complete_information(tmp_path):
    study = cboxlab.Study.open(glare_capture(tmp_path / "capture", 16), noise=3.0, cache=tmp_path / "cache")
    study = study.add("veiling-glare", fraction=0.02).add("lamp-power", scale=1.01)
    sigma = {"fraction": 1e-3, "scale": 1e-3}
    effects = tuple(replace(e, sigma={k: sigma[k] for k in e.values if k in sigma}) for e in study.effects)
    assert fitted_correlations(study._bases(NO_PROGRESS), study.effects) is None
    base = study._bases(NO_PROGRESS)[0]
    matrix = fitted_correlations([base], effects)
    assert matrix.names == ("veiling-glare fraction", "lamp-power scale")

    prepared, used = base.validation.prepared, base.rendered.used
    still = predict(base, effects, refit=False)
    columns = []
    for index, (name, step) in enumerate(sigma.items()):
        moved = [*effects]
        moved[index] = replace(
            effects[index], values={**effects[index].values, name: effects[index].values[name] + step}
        )
        columns.append((predict(base, moved, refit=False).signal - still.signal) / step)
    lamp = still.rendered.fit.lamp_scale
    columns += [*(lamp * base.derivative), still.signal / lamp]
    design = np.array([(column / still.sigma)[used] for column in columns])
    rows = nuisance_priors(prepared.expected_camera(effects), prepared.lamp_sigma)
    information = design @ design.T
    information[2:, 2:] += rows.T @ rows
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale))
    expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert np.isclose(matrix.values[0, 1], expected, atol=0.05)
    assert np.allclose(np.diag(matrix.values), 1) and np.allclose(matrix.values, matrix.values.T)


def test_a_strong_correlation_has_one_plain_sentence():
    matrix = Correlations(("a x", "b y", "c z"), np.array([[1, 0.95, 0.2], [0.95, 1, np.nan], [0.2, np.nan, 1]]))
    assert matrix.sentences == (f"a x and b y (r = +0.95): {HARDLY_DISTINGUISHED}.",)
    section = correlation_section(matrix.names, matrix.values, matrix.sentences)
    assert section.blocks[0].rows[1][-1] == "–" and section.paragraphs == matrix.sentences


@pytest.mark.parametrize("fraction", [0.2, 0.5])
def test_a_number_at_its_upper_bound_has_the_sign_that_it_has_below(monkeypatch, fraction):
    """Signals that are linear in both numbers; the step from the bound is downwards, and stays within the bounds."""
    columns, sigma = np.array([[1.0, 2.0, 0.5], [1.0, 1.0, 2.0]]), 0.01
    effects = tuple(
        replace(apply_checked(name, {key: value}, "test"), sigma={key: sigma})
        for name, key, value in (("veiling-glare", "fraction", fraction), ("lamp-power", "scale", 1.0))
    )

    def linear(base, effects, draft):
        values = np.array([effects[0].values["fraction"], effects[1].values["scale"]])
        assert values[0] <= 0.5
        fit = SimpleNamespace(missed=lambda camera: SimpleNamespace(vector=np.zeros(1)))
        rendered = SimpleNamespace(fit=fit)
        return SimpleNamespace(signal=values @ columns, sigma=np.ones(3), rendered=rendered, effects=effects)

    prepared = SimpleNamespace(expected_camera=lambda effects: None, lamp_sigma=1.0)
    base = SimpleNamespace(
        validation=SimpleNamespace(prepared=prepared), rendered=SimpleNamespace(used=np.ones(3, bool))
    )
    monkeypatch.setattr("cboxlab.validation.study.correlations.predict", linear)
    monkeypatch.setattr("cboxlab.validation.study.correlations.nuisance_priors", lambda camera, sigma: np.zeros((1, 1)))
    covariance = np.linalg.inv(columns @ columns.T)
    expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert np.isclose(fitted_correlations([base], effects).values[0, 1], expected, rtol=1e-9)
