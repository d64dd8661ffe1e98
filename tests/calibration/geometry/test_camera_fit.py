"""The scatter of surveyed points that most of them show, from few points on ten numbers."""

import numpy as np
import pytest
from cboxlab.calibration.geometry.camera_fit import SurveyedPoints, _robust_fit
from cboxlab.calibration.geometry.lens_model import ONE_TERM
from cboxlab.scenes import cornell_camera


def test_few_points_show_the_scatter_that_they_have():
    """Twelve points, 0.2 px: residuals are smaller by sqrt(14 / 24), which is made good.

    The scatter of one fit is known to about a quarter; the mean of 40 to 0.04 of it, within 4 of that.
    """
    rng, camera = np.random.default_rng(3), cornell_camera(400)
    results = []
    for _ in range(40):
        world = rng.uniform([0, 0, 0], [550, 550, 560], (12, 3))
        image = camera.project(world) + 0.2 * rng.standard_normal((12, 2))
        points = SurveyedPoints(tuple(map(str, range(12))), world, image)
        results.append(_robust_fit(camera, points, None, ONE_TERM)[2])
    assert np.mean(results) == pytest.approx(0.2, rel=0.16)
