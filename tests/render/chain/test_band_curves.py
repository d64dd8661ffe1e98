"""Responses at field angles: between the angles exact to a small error, beyond the largest of them its own."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.calibration.instrument.band_response import ResponseFactors, quanta_per_joule
from cboxlab.rendering.chain.band_curves import FIELD_ANGLES, field_shares, field_sine_squared, over_field
from cboxlab.rendering.chain.projection import band_signals, uniform_light
from cboxlab.rendering.effects import apply_checked
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.scenes.wavelength_grid import FILTER_GRID, INTEGRAL_GRID

NM = FILTER_GRID.nm
CENTRES = np.array([480.0, 550.0])
SHIFT = apply_checked("filter-shift", {"effective_index": 1.5}, "test")
CAMERA = cornell_camera(48)


def factors() -> ResponseFactors:
    bells = 0.7 * np.exp(-0.5 * ((NM - CENTRES[:, None]) / 20) ** 2)
    rest = np.zeros(NM.size)
    rest[FILTER_GRID.part(INTEGRAL_GRID)] = quanta_per_joule(INTEGRAL_GRID.nm)
    return ResponseFactors(("f480", "f550"), FILTER_GRID, bells, np.stack([rest, rest]), np.ones(2))


def wider(camera: Camera, times: float) -> Camera:
    """The camera with a focal length that many times shorter: its corners look farther off the axis."""
    return replace(camera, focal_length_px=camera.focal_length_px / times)


def test_shares_of_the_angles_add_up_and_single_one_out_at_its_own_place():
    curves = SHIFT.apply(over_field(factors(), CAMERA))
    shares = field_shares(curves, CAMERA)
    assert shares.shape == (FIELD_ANGLES, 48, 48)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-9)
    knots = np.linspace(0, 1, FIELD_ANGLES) * curves.sine_squared[-1]
    np.testing.assert_allclose(curves.sine_squared, knots)


def test_filters_alike_at_all_angles_take_one_projection():
    assert field_shares(over_field(factors(), CAMERA), CAMERA).shape == (1, 1, 1)


@pytest.mark.parametrize("times", [1.2, 2.0])
def test_pixels_beyond_the_largest_angle_have_its_response(times):
    """Not that of a cubic continued: 2 times as far off the axis it would be wrong by more than the signal."""
    curves = SHIFT.apply(over_field(factors(), CAMERA))
    wide_camera = wider(CAMERA, times)
    beyond = field_sine_squared(wide_camera) > curves.sine_squared[-1]
    assert 0.01 < beyond.mean() < 0.9
    spectrum = 1e-4 * (1 + (INTEGRAL_GRID.nm - 400) / 300)
    signal = band_signals(uniform_light(spectrum), curves, field_shares(curves, wide_camera))
    last = np.array([response.signal(spectrum) for response in curves.responses(FIELD_ANGLES - 1)])
    np.testing.assert_allclose(signal[:, beyond], np.broadcast_to(last[:, None], signal[:, beyond].shape), rtol=1e-9)
    bounds = [[r.signal(spectrum) for r in curves.responses(angle)] for angle in range(FIELD_ANGLES)]
    assert np.all(signal <= np.max(bounds, axis=0)[:, None, None] * (1 + 1e-6))
    assert np.all(signal >= np.min(bounds, axis=0)[:, None, None] * (1 - 1e-6))


def test_pixels_without_a_ray_have_a_signal():
    """A lens so distorted that no ray reaches the corners: they hold no scene, but no NaN either."""
    wide_camera = replace(CAMERA, k1=-0.9)
    assert np.isnan(field_sine_squared(wide_camera)).any()
    curves = SHIFT.apply(over_field(factors(), wide_camera))
    shares = field_shares(curves, wide_camera)
    assert np.isfinite(shares).all()
    without = np.isnan(field_sine_squared(wide_camera))
    np.testing.assert_allclose(shares[-1][without], 1.0, atol=1e-9)


def test_a_uniform_source_may_have_a_spectrum_for_every_band():
    """The same as each band's own source alone."""
    curves = over_field(factors(), CAMERA)
    spectra = 1e-4 * np.stack([np.linspace(1, 2, 301), np.linspace(3, 1, 301)])
    both = band_signals(uniform_light(spectra), curves, field_shares(curves, CAMERA))
    for band, spectrum in enumerate(spectra):
        alone = band_signals(uniform_light(spectrum), curves, field_shares(curves, CAMERA))
        assert both[band, 0, 0] == pytest.approx(alone[band, 0, 0], rel=1e-12)


def test_the_sine_of_a_ray_is_its_distance_from_the_axis_over_its_length():
    """Without distortion: in units of the focal length, from the principal point."""
    (u0, v0), f = CAMERA.principal_point_px, CAMERA.focal_length_px
    v, u = np.mgrid[:48, :48]
    square = ((u - u0) ** 2 + (v - v0) ** 2) / f**2
    np.testing.assert_allclose(field_sine_squared(CAMERA), square / (1 + square), atol=1e-12)
