"""Correlations of fitted numbers against the inverse of the complete information, camera and lamp included."""

from dataclasses import replace

import cboxlab
import numpy as np
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.diagnose import nuisance_priors
from cboxlab.validation.report import correlation_section
from cboxlab.validation.study import HARDLY_DISTINGUISHED, Correlations, fitted_correlations, predict
from helpers.captures.glare_capture import glare_capture


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
