"""The light exchange of an excess: what coats mirror; angles and direct light."""

from types import SimpleNamespace

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


def test_the_floor_sees_camera_and_lamp_under_the_angles_of_its_height():
    """Fragments and patches of the floor: heights over distances. All direct light is the lamp's form factor."""
    scene, camera = cornell_box(), cornell_camera(24)
    traced = build_patch_transport(build_patched_scene(scene, 80.0, 64, 0), camera, 16, 0)
    predictor = SimpleNamespace(
        transport=traced,
        effective_nm=np.array([500.0, 600.0]),
        scene=scene,
        included=(),
        lamp_shares=np.ones((1, 2)),
    )
    t = light_exchange(predictor)
    floor = [surface.name for surface in scene.surfaces].index("floor")
    on_floor, patches, (lamp,) = t.surface == floor, t.patch_surface == floor, traced.light.lamps

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
