"""Single steps of a validation, on values written by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.compare import pipeline


def test_a_camera_is_pulled_by_its_distance_in_the_surveys_errors():
    """Three sigmas of one error and four of another that is independent are five."""
    fit = SimpleNamespace(missed=lambda surveyed: SimpleNamespace(camera=np.array([6.0, -12.0, 0.0])))
    surveyed = SimpleNamespace(covariance=np.diag([4.0, 9.0, 1.0]))
    assert pipeline._camera_pull(fit, surveyed) == pytest.approx(5.0)
    assert pipeline._camera_pull(fit, SimpleNamespace(covariance=None)) == 0.0


def test_the_lamps_scale_weighs_by_the_sensors_and_the_renderings_noise():
    prepared = SimpleNamespace(
        usable=np.ones((1, 2, 2), bool),
        calibration=SimpleNamespace(predicted_variance=lambda signal: 2 * signal),
        lamp_scale=lambda signal, variance, used: (variance, 0.1),
    )
    mask, variance = (SimpleNamespace(values=np.full((1, 2, 2), value)) for value in (0, 0.5))
    bands = SimpleNamespace(mask=mask, variance=variance)
    scaled = pipeline._scaled(prepared, None, None, np.full((1, 2, 2), 3.0), bands)
    assert np.array_equal(scaled.fit.lamp_scale, np.full((1, 2, 2), 6.5))
