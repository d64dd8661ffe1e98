"""Closed forms against each other, and our integrators against them; the full run is `cbox renderers --references`."""

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.visibility import point_to_polygon
from cboxlab.validation.compare_renders.renderers.closed_form_scenes import _furnace, measure_closed_forms
from cboxlab.validation.compare_renders.renderers.closed_forms import (
    disk_above,
    parallel_squares,
    perpendicular_rectangles,
)
from cboxlab.validation.compare_renders.renderers.enclosure import FACES, cube_radiosity
from oracles.form_factors import corner_to_rectangle


def test_lamberts_polygon_is_the_catalogues_rectangle_and_disk():
    """From a point to a rectangle with one corner straight above, and to a disk as a polygon of 4000 corners."""
    rectangle = [[0.0, 2.0, 0.0], [1.5, 2.0, 0.0], [1.5, 2.0, 0.7], [0.0, 2.0, 0.7]]
    up = [0.0, 1.0, 0.0]
    assert point_to_polygon(np.zeros(3), up, rectangle) == pytest.approx(corner_to_rectangle(1.5, 0.7, 2.0), rel=1e-9)
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    ring = np.stack([3 * np.cos(angle), np.full(4000, 2.0), 3 * np.sin(angle)], axis=1)
    assert point_to_polygon(np.zeros(3), up, ring) == pytest.approx(disk_above(3.0, 2.0), rel=1e-5)


def test_the_walls_of_a_cube_take_all_light_of_one():
    """Five form factors of one face add up to 1: one opposed, four at right angles."""
    assert parallel_squares(1.0) + 4 * perpendicular_rectangles(1.0, 1.0) == pytest.approx(1.0, abs=1e-12)


def test_radiosity_of_a_white_cube_is_its_lamps():
    assert cube_radiosity(dict.fromkeys(FACES, 1.0), "ceiling", 8) == pytest.approx(dict.fromkeys(FACES, 1.0), abs=1e-9)


def test_radiosity_of_a_nearly_black_cube_is_direct_light():
    """Reflectance e: the floor has e F(parallel) and the walls e F(perpendicular), up to e squared."""
    radiosity = cube_radiosity(dict.fromkeys(FACES, 1e-6), "ceiling", 8)
    assert radiosity["floor"] / 1e-6 == pytest.approx(parallel_squares(1.0), rel=1e-5)
    for wall in ("left", "right", "front", "back"):
        assert radiosity[wall] / 1e-6 == pytest.approx(perpendicular_rectangles(1.0, 1.0), rel=1e-5)


def test_a_furnace_is_closed_by_its_lamp_in_the_middle_of_the_ceiling():
    """Areas of the faces and the lamp are those of a cube; the ceiling's ring and the lamp have one centre."""
    scene = _furnace().scene
    surfaces = {s.name: s.vertices_mm[s.faces] for s in (*scene.surfaces, scene.lamp.surface)}
    areas = {n: np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1) / 2 for n, c in surfaces.items()}
    edge = np.ptp(surfaces["floor"][..., 0])
    assert sum(area.sum() for area in areas.values()) == pytest.approx(6 * edge**2)
    assert 0 < areas["light"].sum() < edge**2
    middle = surfaces["light"].reshape(-1, 3).mean(axis=0)
    assert middle == pytest.approx([edge / 2, surfaces["ceiling"][0, 0, 1], edge / 2])


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")
@pytest.mark.parametrize("name", ["polygon lamp", "perpendicular squares", "camera"])
def test_our_integrators_pass_their_references(name):
    """Within 0.05 % and five standard errors, whose false alarms are below 1 in 100 (7 degrees of freedom, 8 tests)."""
    for measured in measure_closed_forms((name,), effort=0.05):
        assert abs(measured.difference) < 5e-4 + 5 * measured.sigma and measured.sigma < 2e-3, measured
