"""Which arrangements of surveyed points can determine a camera."""

import numpy as np
import pytest
from cboxlab.calibration.geometry.surveyed_points import (
    FLATTEST,
    SMALLEST_EXTENT,
    SurveyedPoints,
    read_points,
    require_determined,
)
from cboxlab.scenes import cornell_camera
from cboxlab.utils.errors import InputError

WIDTH, HEIGHT = 400, 300


def survey(world, image=None):
    image = cornell_camera(WIDTH).project(world) if image is None else image
    return SurveyedPoints(tuple(map(str, range(len(world)))), np.asarray(world, float), image)


def cloud(count=12, seed=1):
    return np.random.default_rng(seed).uniform([0, 0, 0], [550, 550, 560], (count, 3))


def check(points, inliers=None):
    require_determined(points, np.ones(len(points.ids), bool) if inliers is None else inliers, WIDTH, HEIGHT)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("coordinate", [0.0, 550.0])
def test_points_of_one_wall_are_refused_wherever_it_stands(axis, coordinate):
    """The thickness counts against the size: just below the limit refused, twice the limit taken."""
    world = cloud()
    thickness = world[:, axis] - world[:, axis].mean()
    for factor, flat in ((0.0, True), (0.5, True), (2.0, False)):
        world[:, axis] = coordinate
        singular = np.linalg.svd(world - world.mean(axis=0), compute_uv=False)
        world[:, axis] += factor * FLATTEST * singular[0] * thickness / np.linalg.norm(thickness)
        if flat:
            with pytest.raises(InputError, match="in one plane"):
                check(survey(world))
        else:
            check(survey(world))


def test_semicolons_are_reported(tmp_path):
    (tmp_path / "p.csv").write_text("id;x_mm;y_mm;z_mm;u_px;v_px\np;1;2;3;4;5\n")
    with pytest.raises(InputError, match="separated by semicolons"):
        read_points(tmp_path / "p.csv")


def test_points_close_together_in_the_picture_are_refused():
    """A tenth of the diagonal of 500 px: 50 px."""
    world = cloud()
    unit = world[:, :2] / np.linalg.norm(np.ptp(world[:, :2], axis=0))
    assert SMALLEST_EXTENT == 0.1
    check(survey(world, 200 + 51.0 * unit))
    with pytest.raises(InputError, match=r"within 49\.0 px of an image of 500 px"):
        check(survey(world, 200 + 49.0 * unit))


@pytest.mark.parametrize(("lost", "refused"), [(6, False), (7, True)])
def test_more_than_half_may_not_be_outliers(lost, refused):
    points, inliers = survey(cloud(14)), np.arange(14) >= lost + 1
    if refused:
        with pytest.raises(InputError, match=f"{lost + 1} of 14 points"):
            check(points, inliers)
    else:
        check(points, inliers)


def test_five_points_are_too_few():
    with pytest.raises(InputError, match="5 usable points"):
        check(survey(cloud()), np.arange(12) < 5)
