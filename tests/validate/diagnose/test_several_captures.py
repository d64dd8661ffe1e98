"""Several captures of one box: what they share is fitted to all, what belongs to one capture to each by itself."""

from dataclasses import replace
from types import SimpleNamespace

import cboxlab
import numpy as np
import pytest
from cboxlab.rendering.effects import AppliedEffect, Effect, Parameter, catalogue
from cboxlab.validation.diagnose.alternatives import SelectedEffect
from cboxlab.validation.diagnose.evidence import INDISTINGUISHABLE_CHI2
from cboxlab.validation.diagnose.fitting import fit
from cboxlab.validation.diagnose.hypotheses import Hypothesis
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.search import Candidate
from cboxlab.validation.diagnose.several_captures import (
    FurtherFit,
    JointProblem,
    _separate_chi2,
    refitted_to_all,
    same_camera,
)
from helpers.places import ROOT

COUNT, NUISANCES = 400, 11


def model(residual):
    """A linear model whose nuisances can imitate nothing."""
    whitened = np.append(residual, np.zeros(NUISANCES))
    return LinearModel(
        used=np.ones((1, 1, COUNT), bool),
        interior=np.ones(COUNT, bool),
        patch=np.arange(COUNT) // 20,
        sigma=np.ones(COUNT),
        priors=np.zeros((NUISANCES, NUISANCES)),
        by_lamp=np.ones(COUNT),
        basis=np.eye(COUNT + NUISANCES)[:, -1:],
        shared_errors=np.zeros((COUNT + NUISANCES, 1), np.float32),
        residual=whitened,
    )


class OneShape:
    """A problem in which an effect adds its number times a shape."""

    scale = 1.0

    def __init__(self, shape, residual):
        self.shape, self.model = np.append(shape, np.zeros(NUISANCES)), model(residual)

    def change(self, applied):
        return float(applied.values["width"]) * self.shape

    def camera_change(self, applied):
        return np.zeros_like(self.shape)

    def noise_averaging_gain(self, applied):
        return 0.0


def candidate(grows):
    width = Parameter("width", "px", null=0.0, low=-9.0, high=9.0, step=0.1, grows_with_aperture=grows)
    effect = Effect("blurred", "optics", "", (width,), lambda light, width: light, "")
    return Candidate(Hypothesis(effect, (width,), {}), {"width": 0.1}, {}, np.inf, np.zeros(COUNT + NUISANCES))


@pytest.mark.parametrize("grows", [True, False])
def test_a_number_that_grows_with_the_aperture_is_half_at_half_of_it(grows):
    """Two captures of the same width at full aperture, the second at half: a joint fit finds it within 5 sigma.

    By least squares over both, its standard deviation is 1 / sqrt(sum of squares of both shapes).
    """
    rng = np.random.default_rng(4)
    shapes, apertures = rng.standard_normal((2, COUNT)), (1.0, 0.5)
    factors = apertures if grows else (1.0, 1.0)
    residuals = [2.0 * f * s + rng.standard_normal(COUNT) for f, s in zip(factors, shapes, strict=True)]
    problem = JointProblem(tuple(map(OneShape, shapes, residuals)), apertures)
    joined = problem.model.joined([part.model.residual for part in problem.parts])
    fitted = fit(problem, candidate(grows), joined)
    sigma = 1 / np.sqrt(sum(f**2 * np.sum(s**2) for f, s in zip(factors, shapes, strict=True)))
    assert fitted.numbers["width"] == pytest.approx(2.0, abs=5 * sigma)
    assert fitted.chi2 == pytest.approx(2 * COUNT, abs=5 * np.sqrt(4 * COUNT))


def test_an_effect_at_another_aperture():
    defocus = AppliedEffect(catalogue()["defocus"], {"sigma_px": 0.8})
    assert defocus.at_aperture(0.5).values["sigma_px"] == pytest.approx(0.4)
    glare = AppliedEffect(catalogue()["veiling-glare"], {"fraction": 0.01})
    assert glare.at_aperture(0.5) is glare


def test_effects_of_one_capture_are_those_of_lamp_power_and_camera_place():
    members = {effect.id for effect in catalogue().values() if effect.own_to_capture}
    assert members == {"lamp-power", "lamp-drift", "camera-pose"}


def test_the_same_camera_has_the_same_sensor_lens_and_filters():
    """Gain, exposures and the order of the bands may differ."""
    capture = cboxlab.load_capture(ROOT / "validate" / "data" / "demo-capture")
    m = capture.manifest

    def other(**tables):
        return replace(capture, manifest=m.model_copy(update=tables))

    bands = [band.model_copy(update={"exposure_s": 2 * band.exposure_s}) for band in reversed(m.band)]
    gain = m.camera.model_copy(update={"gain_e_per_dn": 3.0})
    assert same_camera(capture, other(band=bands, camera=gain))
    assert not same_camera(capture, other(band=bands[1:]))
    assert not same_camera(capture, other(camera=m.camera.model_copy(update={"bit_depth": 14})))
    assert not same_camera(capture, other(lens=m.lens.model_copy(update={"focal_length_mm": 50.0})))


def photographed(shape, residual, f_number):
    """A prepared capture of that aperture, and its linearised fit."""
    capture = SimpleNamespace(manifest=SimpleNamespace(band=[SimpleNamespace(f_number=f_number)]))
    problem = OneShape(shape, residual)
    fitted = SimpleNamespace(model=problem.model, problem=lambda others: problem)
    return SimpleNamespace(calibration=SimpleNamespace(capture=capture)), fitted


@pytest.mark.parametrize("shared", [True, False])
def test_what_is_settled_by_all_captures_counts_in_all(shared):
    """A blur of 2 px at f/8 is 1 px at f/16, one number where the camera is the same, two where it is another.

    Least squares by hand; a number for one capture alone counts as a further parameter.
    """
    rng = np.random.default_rng(5)
    shapes = rng.standard_normal((2, COUNT))
    residuals = [2.0 * shapes[0] + rng.standard_normal(COUNT), 1.0 * shapes[1] + rng.standard_normal(COUNT)]
    (first, first_fit), (second, second_fit) = (
        photographed(shape, residual, f_number)
        for shape, residual, f_number in zip(shapes, residuals, (8.0, 16.0), strict=True)
    )
    effect = SelectedEffect(candidate(True), (), 0.0, 1.0, 1.0, 0.01, COUNT, 1.0)
    (refitted_candidate,) = refitted_to_all(first, first_fit, [effect], [FurtherFit(second, second_fit, shared)])
    total = sum(float(r @ r) for r in residuals)
    assert refitted_candidate.count == 2 * COUNT and refitted_candidate.chi2_without == pytest.approx(total)
    if shared:
        along, size = shapes[0] @ residuals[0] + 0.5 * shapes[1] @ residuals[1], shapes[0] @ shapes[0]
        size += 0.25 * shapes[1] @ shapes[1]
        expected = total - along**2 / size
    else:
        along, size = shapes[0] @ residuals[0], shapes[0] @ shapes[0]
        expected = total - along**2 / size - (shapes[1] @ residuals[1]) ** 2 / (shapes[1] @ shapes[1])
        expected += INDISTINGUISHABLE_CHI2
    assert refitted_candidate.candidate.numbers["width"] == pytest.approx(along / size, rel=1e-6)
    assert refitted_candidate.candidate.chi2 == pytest.approx(expected, rel=1e-9)


def test_each_separate_number_costs_a_capture_what_chance_gains():
    """Least squares by hand; an effect that gains less than that is left out."""
    rng = np.random.default_rng(6)
    shapes, noise = rng.standard_normal((2, COUNT)), rng.standard_normal(COUNT)
    numbers = tuple(Parameter(name, "px", null=0.0, low=-9.0, high=9.0, step=0.1) for name in ("width", "height"))
    effect = Effect("blurred", "optics", "", numbers, lambda light, **values: light, "")
    pair = Candidate(Hypothesis(effect, numbers, {}), {"width": 0.1, "height": 0.1}, {}, np.inf, np.zeros(1))
    for size in (0.5, 0.0):
        problem = OneShape(shapes[0], noise + size * shapes.sum(axis=0))
        problem.change = lambda applied: np.append([*applied.values.values()] @ shapes, np.zeros(NUISANCES))
        residual = problem.model.residual[:COUNT]
        fitted = SimpleNamespace(model=problem.model, problem=lambda others, problem=problem: problem)
        rest = residual - np.linalg.lstsq(shapes.T, residual, rcond=None)[0] @ shapes
        with_effect = rest @ rest + 2 * INDISTINGUISHABLE_CHI2
        expected = min(with_effect, residual @ residual)
        assert (expected == with_effect) == (size > 0)
        assert _separate_chi2(fitted, [], pair) == pytest.approx(expected, rel=1e-9)
