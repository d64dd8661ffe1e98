"""Pictures are compared where equal pixels show the same points, and their mean difference is one of sums."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cboxlab.rendering.files import camera_of_attribute
from cboxlab.scenes.cornell_box import cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders import ImageStack, compare_stacks
from cboxlab.validation.compare_renders.cameras import Instrument, shift_px

CAMERA = cornell_camera(128)


def turned(degrees):
    """About the vertical axis."""
    parameters = CAMERA.parameters.copy()
    parameters[4] += degrees
    return CAMERA.with_parameters(parameters)


def stack(values, camera=None, numbers=None, name="a"):
    values = np.asarray(values, float)
    names = tuple(f"band{i}" for i in range(len(values)))
    return ImageStack(Path(name), names, values, None, "DN s^-1", instrument=Instrument(camera, numbers or {}))


def test_the_shift_of_a_moved_principal_point():
    moved = replace(CAMERA, principal_point_px=CAMERA.principal_point_px + np.array([3.0, -4.0]))
    assert shift_px(CAMERA, moved) == pytest.approx(5.0)


def test_the_shift_of_a_turn_and_of_a_step():
    """A turn by a small angle moves the corner by f a (1 + tan^2), a step to the side the nearest point by f d / z."""
    edge = (CAMERA.width_px - 1) / 2 / CAMERA.focal_length_px
    expected = CAMERA.focal_length_px * np.radians(0.1) * np.hypot(1 + edge**2, edge**2)
    assert shift_px(CAMERA, turned(0.1)) == pytest.approx(expected, rel=0.01)
    step = replace(CAMERA, position_mm=CAMERA.position_mm + np.array([2.0, 0, 0]))
    nearest_depth = 800 / np.sqrt(1 + 2 * edge**2)
    assert shift_px(CAMERA, step) == pytest.approx(CAMERA.focal_length_px * 2 / nearest_depth, rel=1e-6)


@pytest.mark.parametrize("text", [None, "", "[]", "{}", '{"width_px": 3, "height_px": 3, "parameters": [1, 2]}'])
def test_a_cube_without_a_camera_is_compared(text):
    assert camera_of_attribute(text) is None


def test_other_cameras_are_refused_and_near_ones_noted():
    values = np.ones((1, 4, 4))
    with pytest.raises(InputError, match=r"b: found a camera .* px elsewhere; expected the camera of a"):
        compare_stacks(stack(values, CAMERA), stack(values, turned(1.0), name="b"))
    notes = compare_stacks(stack(values, CAMERA), stack(values, turned(0.1))).notes
    assert any("same points" in note for note in notes)
    assert not compare_stacks(stack(values, CAMERA), stack(values, turned(0.001))).notes


def test_other_sensors_are_noted():
    values = np.ones((1, 4, 4))
    notes = compare_stacks(stack(values, None, {"gain, e-/DN": 12}), stack(values, None, {"gain, e-/DN": 6})).notes
    assert notes == ("the cameras differ in gain, e-/DN: 12 and 6; their counts differ in meaning",)


@pytest.mark.parametrize("value", [0.01, 12.0, 5000.0])
def test_numbers_that_differ_by_rounding_are_the_same(value):
    """Up to a thousandth of the number, whatever its unit."""
    instrument = Instrument(None, {"pixel pitch, um": value})
    assert instrument.differences(Instrument(None, {"pixel pitch, um": 1.0009 * value})) == []
    assert len(instrument.differences(Instrument(None, {"pixel pitch, um": 0.9989 * value}))) == 1


def test_the_mean_is_a_ratio_of_sums():
    """A is B with 2 % more light and noise. In dark pixels ratios reach hundreds of per cent; the sums do not care."""
    generator = np.random.default_rng(3)
    light = np.tile(np.array([0.2, 100.0]), 5000).reshape(1, 100, 100)
    b = light + generator.normal(0, 0.1, light.shape)
    a = 1.02 * light + generator.normal(0, 0.1, light.shape)
    comparison = compare_stacks(stack(a), stack(b))
    assert comparison.rows[0].relative_mean == pytest.approx(0.02, abs=2e-4)
    assert comparison.rows[0].relative_rms == pytest.approx(0.02, abs=2e-3)
    assert np.nanmean(comparison.relative) > 0.05


def test_a_dark_plane_has_no_relative_difference():
    row = compare_stacks(stack(np.ones((1, 4, 4))), stack(np.zeros((1, 4, 4)))).rows[0]
    assert np.isnan(row.relative_mean) and np.isnan(row.relative_rms) and row.mean_first == 1
