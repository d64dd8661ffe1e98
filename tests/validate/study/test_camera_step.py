"""The workbench's step of the camera has the noise of the light that is there, as the camera's fit has."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.scenes import cornell_camera
from cboxlab.validation.compare import NuisanceFit
from cboxlab.validation.study import prediction


def test_pixels_count_by_the_noise_of_the_measured_light_where_the_model_lacks_it():
    """Two pixels ask for steps of 1 and 0 along the only free parameter; their variances are 1 + 1 and 2 + 1 by the
    light that is there, and 101 and 1 by the model's: the step is (1 / 2) / (1 / 2 + 1 / 3)."""
    free, fixed = 1e12, 1e-12
    camera = replace(cornell_camera(64), covariance=np.diag([free, *9 * [fixed]]))
    before, moved_signal = np.array([[[100.0, 0.0]]]), np.array([[[1.0, 2.0]]])
    derivative = np.zeros((10, 1, 1, 2))
    derivative[0] = 1.0
    prepared = SimpleNamespace(
        expected_camera=lambda effects: camera,
        lamp_sigma=fixed,
        measured=before + np.array([1.0, 0.0]),
        noise_reference_signal=lambda signal: moved_signal if signal is before else None,
        calibration=SimpleNamespace(predicted_variance=lambda light: light),
    )
    rendered = SimpleNamespace(
        fit=NuisanceFit(camera, 1.0, fixed), used=np.ones((1, 1, 2), bool), variance=np.ones((1, 1, 2))
    )
    base = SimpleNamespace(
        validation=SimpleNamespace(prepared=prepared),
        rendered=rendered,
        derivative=derivative,
        refit_change=0.0,
    )
    step = prediction._camera_step(base, before, ())
    assert step == pytest.approx([0.6, *9 * [0.0]], abs=1e-9)
