"""The light on the sensor: a factor on it is a factor on all that is known of it."""

import numpy as np
from cboxlab.rendering.chain import Light
from cboxlab.scenes import cornell_camera
from helpers.fakes.stages import light


def test_a_factor_acts_on_the_signal_and_on_what_edges_do_in_their_pixels():
    before, factor = light(), np.array([2.0, 3.0, 0.5])[:, None, None]
    picture = np.random.default_rng(1).standard_normal(before.signal.shape)
    camera = cornell_camera(48)
    light_before = Light(
        before.signal,
        before.effective_nm,
        before.camera,
        lambda another_camera: another_camera.focal_length_px * picture,
        lambda sigma_px: sigma_px[:, None, None] * picture,
    )
    after, sigma = light_before.scaled(factor), np.array([0.1, 0.2, 0.4])
    np.testing.assert_allclose(after.signal, factor * before.signal)
    np.testing.assert_allclose(after.moved(camera), factor * camera.focal_length_px * picture)
    np.testing.assert_allclose(after.beyond_pixels(sigma), factor * sigma[:, None, None] * picture)
    assert after.effective_nm is before.effective_nm
    assert before.scaled(factor).moved is None and before.scaled(factor).beyond_pixels is None
