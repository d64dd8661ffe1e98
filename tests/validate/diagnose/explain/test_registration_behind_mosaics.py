"""Registration of a residual behind a mosaic, where each pixel is one sample."""

from dataclasses import replace

import numpy as np
from cboxlab.validation.diagnose.explain import registration
from helpers.captures.small_excess import COLUMNS, ROWS, SIGNAL, small_excess

USED = np.stack([(ROWS % 2 == i // 2) & (COLUMNS % 2 == i % 2) for i in range(4)])


def test_single_samples_are_no_pattern_of_single_pixels():
    """Levels of channels are a pattern of bands, and not of pixels."""
    plain = small_excess(0.05 * SIGNAL * np.array([1, -1, -1, 1])[:, None, None])
    mosaic = replace(plain, used=USED, residual=np.where(USED, plain.residual, 0.0), cell=(2, 2))
    assert registration(mosaic).in_pixels < 0.05
    assert registration(mosaic).in_bands > 0.8
