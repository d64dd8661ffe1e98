"""A model whose light ends too early: what is black in it has the noise of the light that is there."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.validation.compare import CalibratedCapture, pipeline, validate_capture
from cboxlab.validation.diagnose import diagnose_validation, stepwise
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture

TRIED = ("interreflection", "haze")


def test_noise_is_that_of_the_measured_light_where_the_model_lacks_it():
    """Of a picture of 1000 DN in the median: what is twice the model's and 50 DN at the least. A masked pixel never."""
    measured = np.array([[[1000.0, 1000.0, 1000.0, 1000.0, 60.0, 40.0, 60.0, 4000.0, np.nan]]])
    usable = np.array([[[True, True, True, True, True, True, True, False, False]]])
    signal = np.array([[[990.0, 450.0, 510.0, 1000.0, 0.0, 0.0, 35.0, 0.0, 5.0]]])
    noise_signal = CalibratedCapture.noise_reference_signal(SimpleNamespace(measured=measured, usable=usable), signal)
    assert noise_signal.tolist() == [[[990.0, 1000.0, 510.0, 1000.0, 60.0, 0.0, 35.0, 0.0, 5.0]]]


def test_the_cameras_fit_has_that_noise_and_the_renders(monkeypatch):
    arguments = {}
    monkeypatch.setattr(pipeline, "cached_fit", lambda cache, **keywords: arguments.update(keywords))
    predictor = SimpleNamespace(signal=lambda effects: np.full((1, 1, 2), 100.0), warp=None)
    prepared = SimpleNamespace(
        calibration=SimpleNamespace(predicted_variance=lambda signal_given: 2 * signal_given + 5),
        noise_reference_signal=lambda signal: 3 * signal,
        cache=None,
        measured=None,
        expected_camera=lambda effects: None,
        lamp_sigma=None,
    )
    rendered = SimpleNamespace(predictor=predictor, variance=np.full((1, 1, 2), 7.0), used=None)
    pipeline.refitted(prepared, rendered, ())
    np.testing.assert_array_equal(arguments["variance"], 2 * 300 + 5 + 7)


@pytest.mark.usefixtures("large_patches")
def test_all_reflected_light_missing_is_found_with_a_quiet_camera(monkeypatch, tmp_path):
    """A model of direct light alone is black on a fifth of the picture. Camera and lamp do not follow that: fitted, the
    camera was turned by 10 degrees and the lamp 1.4 or 0.5 times its power, by rounding alone."""
    hypotheses = stepwise.hypotheses
    monkeypatch.setattr(stepwise, "hypotheses", lambda *a: [h for h in hypotheses(*a) if h.effect.id in TRIED])
    quiet = CaptureSettings(bit_depth=16, gain_e_per_dn=1.6, read_noise_e=3.0)
    write_model_capture(tmp_path / "c", Model(), perturbed_camera(32, 2), quiet, 2, relative_error=2e-3)
    validation = validate_capture(load_capture(tmp_path / "c"), Model(render=RenderSettings(noise=1.0, max_bounces=1)))
    surveyed = validation.prepared.expected_camera(())
    np.testing.assert_array_equal(validation.fit.camera.parameters, surveyed.parameters)
    assert abs(validation.fit.lamp_scale - 1) <= 2.001 * validation.prepared.lamp_sigma
    diagnosis = diagnose_validation(validation)
    assert diagnosis.selected == ("interreflection",)
    assert diagnosis.chi2_per_dof > 100 and diagnosis.final_chi2_per_dof < 1.5
