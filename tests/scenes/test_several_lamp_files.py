"""Scene files with several lamps."""

import numpy as np
import pytest
from helpers.scenes.scene_files import BLOCK, CEILING, GOOD, HEADER, LAMP, WHITE, fault, load

SECOND = """
[[lamp]]
name = "cold"
quads_mm = [[[-4, 10, 4], [-4, 10, 3], [-3, 10, 3], [-3, 10, 4]]]
radiance = { wavelength_nm = [400, 700], values = [6.0, 0.0] }
reflectance = 0.5
"""
#: The ceiling as two quads, side by side.
HALVES = CEILING.replace(
    "[5, 10, -5], [5, 10, 5]]]",
    "[-2, 10, -5], [-2, 10, 5]], [[-2, 10, 5], [-2, 10, -5], [5, 10, -5], [5, 10, 5]]]",
)
TWO = (
    HEADER
    + LAMP.replace("[lamp]", "[[lamp]]")
    + SECOND
    + WHITE
    + HALVES.replace('"light"', '["light", "cold"]')
    + BLOCK
)


def test_two_lamps_have_their_own_spectra_and_holes(tmp_path):
    scene = load(tmp_path, TWO)
    assert [lamp.surface.name for lamp in scene.lamps] == ["light", "cold"]
    assert scene.surface("ceiling").areas_mm2.sum() == pytest.approx(100 - 4 - 1)
    assert scene.lamp_areas == pytest.approx([0.8, 0.2])
    assert scene.lamp_radiance([400, 550, 700]) == pytest.approx([2.0, 1.8, 1.6])
    assert scene.lamp_shares([400, 800]) == pytest.approx(np.array([[0.5, 1.0], [3.0, 1.0]]))
    assert scene.reflectances([550])[:, 0] == pytest.approx([0.75, 0.0, 0.5])
    single = load(tmp_path, GOOD)
    assert single.further_lamps == () and np.array_equal(single.lamp_radiance([550]), single.lamp.radiance.at([550]))
    assert load(tmp_path, GOOD.replace("[lamp]", "[[lamp]]")).lamps[0].surface.name == "light"


def test_a_reading_of_the_first_lamp_scales_all(tmp_path):
    """Scale errors of a meter are common: a reading 3 % low of the first lamp makes the whole light 3 % lower."""
    scene = load(tmp_path, TWO)
    read = scene.with_lamp(scene.lamp.radiance.scaled(0.97))
    wavelengths = np.linspace(400, 700, 7)
    assert read.lamp_radiance(wavelengths) == pytest.approx(0.97 * scene.lamp_radiance(wavelengths))


def test_two_lamps_in_one_quad(tmp_path):
    """The ceiling as one quad leaves the same two holes as two quads do."""
    joined, two = (load(tmp_path, text) for text in (TWO.replace(HALVES[:-15], CEILING[:-15]), TWO))
    ceilings = [scene.surface("ceiling") for scene in (joined, two)]
    assert len(ceilings[0].vertices_mm) != 0
    areas = [np.sum(ceiling.areas_mm2) for ceiling in ceilings]
    assert areas == pytest.approx([100 - 4 - 1] * 2)
    centres = [np.average(c.vertices_mm[c.faces].mean(axis=1), axis=0, weights=c.areas_mm2) for c in ceilings]
    np.testing.assert_allclose(*centres, atol=1e-12)


def test_lamps_that_overlap_are_refused(tmp_path):
    text = TWO.replace(HALVES[:-15], CEILING[:-15])
    moved = text.replace(
        "[-4, 10, 4], [-4, 10, 3], [-3, 10, 3], [-3, 10, 4]", "[0, 10, 2], [0, 10, 0], [2, 10, 0], [2, 10, 2]"
    )
    message = fault(tmp_path, moved)
    assert "surface[0] (ceiling).quads_mm[0]: found 2 lamps (no straight line separates the holes)" in message


def test_faults_of_several_lamps_name_the_lamp(tmp_path):
    assert "lamp[1].radiance: found nothing" in fault(
        tmp_path,
        TWO.replace("values = [6.0, 0.0] }", "values = [6.0, 0.0] }\nx = 1").replace(
            "radiance = { wavelength_nm = [400, 700], values = [6.0",
            "radiant = { wavelength_nm = [400, 700], values = [6.0",
        ),
    )
    assert "lamp[1].reflectance: found reflectance 1.5" in fault(
        tmp_path, TWO.replace("reflectance = 0.5", "reflectance = 1.5")
    )
    assert "a name used before" in fault(tmp_path, TWO.replace('name = "cold"', 'name = "light"'))
    assert "one of the lamps' names, 'light', 'cold'" in fault(
        tmp_path, TWO.replace('["light", "cold"]', '["light", "warm"]')
    )
    alone = fault(tmp_path, TWO.replace('["light", "cold"]', '"light"'))
    assert "the lamp in this surface's plane" in alone and 'hole = ["light", "cold"]' in alone
    assert "room.toml: lamp.quads_mm" in fault(tmp_path, GOOD.replace("quads_mm = [[[-1, 10, 1], ", "quads_mm = [[", 1))
    assert "room.toml: lamp: " in fault(tmp_path, HEADER + "lamp = 3\n" + WHITE + BLOCK)
