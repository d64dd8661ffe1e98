"""Fields on surfaces in the exchange of light: against an effect of the catalogue, and a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.fitted_fields import FittedField, WaveMap, field_effect
from cboxlab.rendering.perturbation import build_patch_transport, patch_light
from cboxlab.rendering.radiosity import solve_light
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import camera_inside, lamp_and, quad, square, walls

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: traces rays")

NM = np.array([450.0, 550.0, 650.0])


def _light(scene, transport):
    return patch_light(transport, scene, NM, NM, np.eye(3), np.ones(3))


@pytest.fixture(scope="module")
def published():
    scene = cornell_box()
    transport = build_patch_transport(solve_light(scene, NM, patch_edge_mm=120.0), cornell_camera(24), 64)
    return scene, transport


def _even(*surfaces, value=1.0):
    return tuple(WaveMap(name, np.zeros(3), np.ones(3), np.zeros((1, 3)), np.array([value])) for name in surfaces)


def _effect(acts, surfaces, spectrum):
    field = FittedField(acts, ("a", "b", "c"), NM, (24, 24), surfaces=surfaces, spectrum=np.array(spectrum))
    return field_effect("found", field, "", "")


def test_another_paint_is_the_catalogues_with_all_that_it_reflects_on(published):
    scene, transport = published
    light = _light(scene, transport)
    changed = _effect("reflectance", _even("left"), [-0.1] * 3).apply(light, amplitude=0.5)
    other = apply_checked("wall-reflectance", {"material": "red", "scale": 0.95}, "test").apply(scene)
    assert changed.picture() == pytest.approx(_light(other, transport).picture(), rel=1e-5, abs=1e-9)
    change = np.abs(changed.picture() / np.maximum(light.picture(), 1e-12) - 1)
    ceiling = transport.pixel[transport.surface == [s.name for s in scene.surfaces].index("ceiling")]
    assert change.reshape(3, -1)[2, ceiling].max() > 1e-3


def test_a_paint_that_changed_in_one_band_changes_that_band(published):
    scene, transport = published
    light = _light(scene, transport)
    changed = _effect("reflectance", _even("left"), [0.0, 0.0, -0.1]).apply(light, amplitude=1.0).picture()
    before = light.picture()
    assert changed[:2] == pytest.approx(before[:2], rel=1e-6)
    assert changed[2].sum() < 0.999 * before[2].sum()


def test_light_on_all_walls_of_a_closed_room_has_its_closed_form():
    """Irradiance over pi of 1 everywhere, a reflectance of 0.5: radiance 0.5 / (1 - 0.5) of every wall."""
    corners = walls()
    lamp = square(np.array([5000.0, 5000.0, 5000.0]), 10.0, 1, -1)
    scene = lamp_and([quad(name, c) for name, c in corners.items()], lamp)
    field = solve_light(scene, NM, patch_edge_mm=250.0, patch_samples=128)
    light = _light(scene, build_patch_transport(field, camera_inside(8), 64))
    bright = _effect("irradiance", _even(*corners), [1.0, 1.0, 0.5]).apply(light, amplitude=1.0).picture()
    assert light.picture() == pytest.approx(0.0, abs=1e-6)
    assert bright[1] == pytest.approx(1.0, rel=1e-4)
    assert bright[2] == pytest.approx(0.5, rel=1e-4)


def test_a_thing_in_front_hides_and_shines(published):
    scene, transport = published
    light = _light(scene, transport)
    names = [surface.name for surface in scene.surfaces]
    effect = _effect("front", _even(*names, value=0.4), [0.01, 0.02, 0.03])
    before, after = light.picture(), effect.apply(light, amplitude=1.0).picture()
    shares = np.bincount(transport.pixel, transport.coverage, minlength=before[0].size)
    shine = np.array([0.01, 0.02, 0.03])[:, None, None] * shares.reshape(before[0].shape)
    of_lamp = transport.surface == len(names)
    dark = np.bincount(transport.pixel, of_lamp, minlength=before[0].size).reshape(before[0].shape) == 0
    assert after[:, dark] == pytest.approx((0.6 * before + 0.4 * shine)[:, dark], rel=1e-5, abs=1e-9)


def test_a_sheen_is_seen_and_lights_nothing(published):
    scene, transport = published
    light = _light(scene, transport)
    shiny = _effect("radiance", _even("back"), [0.01] * 3).apply(light, amplitude=2.0)
    added = (shiny.picture() - light.picture())[1].ravel()
    back = transport.surface == [surface.name for surface in scene.surfaces].index("back")
    share = np.bincount(transport.pixel[back], transport.coverage[back], minlength=added.size)
    assert added == pytest.approx(0.02 * share, abs=1e-7)


def test_a_surface_that_is_not_there_is_named(published):
    scene, transport = published
    with pytest.raises(InputError, match=r"effect found: found surface 'shelf'; expected one of .*floor"):
        _effect("reflectance", _even("shelf"), [0.1] * 3).apply(_light(scene, transport), amplitude=1.0)


def test_surfaces_with_different_spectra_change_as_each_would_alone(published):
    scene, transport = published
    light = _light(scene, transport)
    left, right = np.array([[0.1, -0.05, 0.02], [-0.02, 0.03, 0.08]])
    maps = (replace(_even("left")[0], spectrum=left), replace(_even("right")[0], spectrum=right))
    both = _effect("reflectance", maps, [0.5, 1.0, 1.0]).apply(light, amplitude=1.0)
    painted = _effect("reflectance", _even("left"), left * [0.5, 1.0, 1.0]).apply(light, amplitude=1.0)
    then = _effect("reflectance", _even("right"), right * [0.5, 1.0, 1.0]).apply(painted, amplitude=1.0)
    assert both.picture() == pytest.approx(then.picture(), rel=1e-9)
