"""Changes of a picture by paints whose tables are off."""

import numpy as np
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.rendering.perturbation import patch_light
from cboxlab.validation.diagnose.base_flaws.paints import paints
from helpers.fakes.patch_light import NM, fake_patch_light


def _columns():
    light = fake_patch_light()
    signal = np.random.default_rng(3).uniform(50, 100, (3, 3, 2))
    columns = [change.reshape(signal.shape) for _, change in paints(signal, np.ones(signal.shape, bool), light)]
    return light, signal, np.array(columns).reshape(3, -1, *signal.shape)


def _picture(light, material, scale):
    """Picture whose paint reflects ``scale`` times its table, by the catalogue's effect."""
    effect = AppliedEffect(catalogue()["wall-reflectance"], {"material": material, "scale": scale})
    args = light.wavelength_nm, light.grid_nm, light.weights, light.lamp
    return patch_light(light.transport, effect.effect.apply(light.scene, **effect.values), *args).picture()


def test_a_paint_that_is_off_alike_at_all_wavelengths_changes_what_it_lights_too():
    """By central differences; 0.1 % (rms) of a level, and a third of the variance of 0.2 %."""
    light, signal, columns = _columns()
    names = list(light.scene.materials)
    for material, (level, *_) in zip(sorted({names.index(n) for n in names}), columns, strict=True):
        high, low = (_picture(light, names[material], 1 + sign * 0.01) for sign in (1, -1))
        middle = _picture(light, names[material], 1.0)
        rate = np.divide(high - low, 0.02 * middle, out=np.zeros_like(middle), where=middle > 0)
        np.testing.assert_allclose(level, 0.002 / np.sqrt(3) * rate * signal, rtol=0.01, atol=1e-9)
    assert (columns[:, 0, :, 0] > 0).sum() > 3 * 3


def test_waves_over_wavelength_have_the_stated_size_together():
    """Half a period within the visible range, two, three, four; 0.2 % (rms) with the level."""
    _, _, columns = _columns()
    level, *waves = np.moveaxis(columns, 1, 0)
    for order, wave in enumerate(waves, 1):
        phase = np.cos(np.pi * order * (NM - 400) / 300)
        np.testing.assert_allclose(wave, phase[None, :, None, None] * level, atol=1e-12)
    assert len(waves) == 4
