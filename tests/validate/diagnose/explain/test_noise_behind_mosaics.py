"""Level of the noise where a band sees only some of the pixels."""

import numpy as np
import pytest
from cboxlab.calibration.capture import channel_mask
from cboxlab.validation.diagnose.explain.noise import noise_level


@pytest.mark.parametrize("pattern", ["RGGB", "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG"])
def test_the_level_is_that_of_the_noise(pattern):
    shape = (96, 96)
    used = np.stack([channel_mask(pattern, shape, channel) for channel in "RGB"])
    smooth = 3 * np.sin(np.arange(shape[1]) / 30)
    residual = np.where(used, 0.8 * np.random.default_rng(3).standard_normal(used.shape) + smooth, 0.0)
    assert noise_level(residual, used) == pytest.approx(0.64, rel=0.08)


def test_without_pixels_the_noise_is_as_stated():
    assert noise_level(np.zeros((1, 4, 4)), np.zeros((1, 4, 4), bool)) == 1.0
