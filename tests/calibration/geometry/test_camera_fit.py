"""The scatter of surveyed points that most of them show, from few points on ten numbers."""

import numpy as np
import pytest
from cboxlab.calibration.geometry.camera_fit import SurveyedPoints, _checked, _robust_fit
from cboxlab.calibration.geometry.lens_model import ONE_TERM
from cboxlab.scenes import cornell_camera
from cboxlab.utils.errors import InputError


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


@pytest.mark.parametrize(("index", "size"), [(6, cornell_camera(64).focal_length_px), (2, 800.0)])
@pytest.mark.parametrize(("share", "is_refused"), [(0.19, False), (0.21, True)])
def test_a_fifth_of_focal_length_or_distance_is_too_uncertain(index, size, share, is_refused):
    """One standard deviation; all points 800 mm in front of the camera."""
    camera = cornell_camera(64)
    points = SurveyedPoints(("a", "b"), np.array([camera.position_mm + np.array([0, 0, 800.0])] * 2), np.zeros((2, 2)))
    covariance = np.diag(np.eye(10)[index] * (share * size) ** 2)
    if is_refused:
        with pytest.raises(InputError, match="21%"):
            _checked(covariance, camera, points, np.ones(2, bool))
    else:
        assert _checked(covariance, camera, points, np.ones(2, bool)) is covariance
