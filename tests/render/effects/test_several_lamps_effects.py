"""Effects of the lamp in a scene of several lamps."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.effects import apply_checked
from cboxlab.scenes import Spectrum, cornell_box
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM


def apply(identifier, value, **parameters):
    return apply_checked(identifier, parameters, "test").apply(value)


def test_effects_of_the_lamp_act_on_all_lamps():
    """Power, tilt, fall-off and offset alike on each; the reflectance's mean over both areas is the given one."""
    box = cornell_box()
    second = box.lamp.surface.vertices_mm + np.array([120.0, -1.0, 60.0])
    blue = Spectrum(np.array([400.0, 700.0]), np.array([5.0, 1.0]))
    other = replace(box.lamp, surface=replace(box.lamp.surface, name="second", vertices_mm=second), radiance=blue)
    inside = np.arange(450.0, 700.0)
    two = replace(box, further_lamps=(replace(other, reflectance=blue.scaled(0.05)),))
    for before, after in zip(two.lamps, apply("lamp-power", two, scale=1.5).lamps, strict=True):
        np.testing.assert_allclose(after.radiance.values, 1.5 * before.radiance.values)
    for before, after in zip(two.lamps, apply("lamp-spectrum", two, mired_shift=20).lamps, strict=True):
        ratio = after.radiance.at(inside) / before.radiance.at(inside)
        assert np.all(np.diff(ratio) > 0) and ratio[0] < 1 < ratio[-1]
    assert [x.edge_ratio for x in apply("lamp-nonuniform", two, edge_ratio=0.4).lamps] == [0.4, 0.4]
    assert [x.exponent for x in apply("lamp-directional", two, exponent=1.5).lamps] == [1.5, 1.5]
    for before, after in zip(two.lamps, apply("lamp-offset", two, dx_mm=4, dz_mm=-2).lamps, strict=True):
        np.testing.assert_allclose(after.surface.vertices_mm - before.surface.vertices_mm, [[4, 0, -2]] * 4)
    grey = apply("lamp-reflectance", two, reflectance=0.2)
    means = [lamp.reflectance.at(WAVELENGTH_NM).mean() for lamp in grey.lamps]
    assert two.lamp_areas @ means == pytest.approx(0.2, abs=1e-3) and means[0] > 2 * means[1]
