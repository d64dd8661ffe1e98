"""Surveyed points that lie on no surface of the stated scene."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from cboxlab.calibration.quality.points import _check_surfaces
from cboxlab.scenes import cornell_box


def suspicions(points_mm):
    return [*_check_surfaces(SimpleNamespace(points_mm=points_mm), cornell_box(), "points.csv")]


def test_points_of_another_box_suggest_the_stated_scene_and_points_of_this_one_nothing():
    corners = cornell_box().corners_mm
    assert suspicions(corners) == []
    (other_box,) = suspicions(0.6 * corners + 60.0)
    assert "the box is not the one that capture.toml states (scene)" in other_box.what
    (unit,) = suspicions(corners / 10)
    assert unit.what == "the points are in cm"


def test_points_inside_the_air_of_the_box_are_on_no_surface():
    air = np.random.default_rng(1).uniform([40, 380, 40], [500, 500, 500], (20, 3))
    assert len(suspicions(air)) == 1
