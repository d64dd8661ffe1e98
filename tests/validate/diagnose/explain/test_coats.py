"""The light exchange of an excess: what coats mirror; angles and direct light."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.perturbation import build_patch_transport
from cboxlab.rendering.radiosity import build_patched_scene
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.diagnose.field_fit import light_exchange
from cboxlab.validation.diagnose.field_fit.light_exchange import _coated


def test_a_mirror_like_floor_shows_fresnels_part_of_an_evenly_bright_box():
    """Index 1.5, both polarisations. Nearly all of the floor mirrors the back wall or a block."""
    scene, camera = cornell_box(), cornell_camera(48)
    patched = build_patched_scene(scene, 80.0, 64, 0)
    traced = build_patch_transport(patched, camera, 64, 0)
    even, none = np.ones((len(patched.patches.area), 1)), np.zeros((1, 1))
    reflected = _coated(traced, even, scene.reflectances(np.array([550.0])), none, 0.002)[0]
    floor = (traced.coverage > 0.999) & (traced.surface == [surface.name for surface in scene.surfaces].index("floor"))
    pixels, to_camera = traced.pixel[floor], camera.position_mm - traced.position[floor]
    cosine = to_camera[:, 1] / np.linalg.norm(to_camera, axis=1)
    inside = np.sqrt(1 - (1 - cosine**2) / 2.25)
    across, along = (
        (cosine - 1.5 * inside) / (cosine + 1.5 * inside),
        (1.5 * cosine - inside) / (1.5 * cosine + inside),
    )
    expected = (across**2 + along**2) / 2
    ratio = reflected.ravel()[pixels] / expected
    assert len(pixels) > 50
    assert np.median(ratio) == pytest.approx(1, abs=0.005) and np.mean(abs(ratio - 1) < 0.02) > 0.8


def _exchange(scene):
    """Patch transport of a scene, and its light exchange in two bands."""
    traced = build_patch_transport(build_patched_scene(scene, 80.0, 64, 0), cornell_camera(24), 16, 0)
    numbers = {"effective_nm": np.array([500.0, 600.0]), "included": (), "lamp_shares": np.ones((1, 2))}
    predictor = type("Picture", (), {"transport": traced, "scene": scene, **numbers})()
    return traced, light_exchange(predictor)


def test_a_lamp_that_is_brighter_at_one_side_is_predicted_from_where_its_light_comes():
    """Five stripes across the lamp, of light 1 - 0.4 to 1 + 0.4: direct light changes by half of the mean place."""
    scene = cornell_box()
    stripes = (1 + 0.5 * np.array([-0.8, -0.4, 0.0, 0.4, 0.8]))[None]
    _, even = _exchange(scene)
    _, striped = _exchange(scene.with_lamps(lambda lamp: replace(lamp, pattern=stripes)))
    bright = even.patch_direct[:, 0] > 0.02 * even.patch_direct.max()
    change = striped.patch_direct[bright, 0] / even.patch_direct[bright, 0] - 1
    amplitude = np.linalg.lstsq(even.patch_side[bright], change, rcond=None)[0]
    assert sorted(abs(amplitude)) == pytest.approx([0.0, 0.5], abs=0.05)
    remainder = change - even.patch_side[bright] @ amplitude
    assert np.median(abs(remainder)) < 0.2 * np.median(abs(change))  # things hide a part of the lamp from few patches


def test_the_floor_sees_camera_and_lamp_under_the_angles_of_its_height():
    """Fragments and patches of the floor: heights over distances. All direct light is the lamp's form factor."""
    scene = cornell_box()
    traced, t = _exchange(scene)
    floor = [surface.name for surface in scene.surfaces].index("floor")
    on_floor, patches, (lamp,) = t.surface == floor, t.patch_surface == floor, traced.light.lamps

    camera = traced.camera

    def cosine(points, position):
        return (points - position)[:, 1] / np.linalg.norm(points - position, axis=1)

    np.testing.assert_allclose(t.view[on_floor], cosine(camera.position_mm, t.position[on_floor]), atol=1e-6)
    np.testing.assert_allclose(t.incidence[on_floor], cosine(lamp.centre, t.position[on_floor]), atol=1e-6)
    np.testing.assert_allclose(t.patch_incidence[patches], cosine(lamp.centre, t.patch_position[patches]), atol=1e-6)
    np.testing.assert_allclose(t.direct, np.repeat(traced.direct, 2, axis=1))
    np.testing.assert_allclose(t.patch_direct, np.repeat(traced.light.exchange.direct, 2, axis=1))
    assert (
        np.all(t.direct <= t.arriving * (1 + 1e-6))
        and 0.3 < t.direct[on_floor].sum() / t.arriving[on_floor].sum() < 0.9
    )
