"""A render's bands: the sensor equation as a sum over wavelengths, and noise that neighbours of one face share."""

import numpy as np
import pytest
from cboxlab.calibration.instrument import BandResponse
from cboxlab.calibration.instrument.band_images import Mask
from cboxlab.rendering.chain import render_bands
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID

NM = INTEGRAL_GRID.nm
RESPONSES = tuple(
    BandResponse(f"f{nm}", INTEGRAL_GRID, 1e18 * np.exp(-0.5 * ((NM - nm) / 20) ** 2), 1e-15) for nm in (450, 600)
)


@pytest.fixture
def image():
    """Two faces side by side and the lamp in one pixel; four batches of three spectra in random proportions."""
    random = np.random.default_rng(1)
    coefficients = (1 + 0.1 * random.standard_normal((4, 7, 9, 3))).astype(np.float32)
    spectra = np.stack([NM / 700, (750 - NM) / 300, 1 + np.sin(NM / 20)])
    coverage = np.zeros((7, 9, 3), np.float32)
    coverage[:, :4, 0], coverage[:, 5:, 1], coverage[:, 4, :2] = 1, 1, 0.5
    coverage[6, 8] = [0, 0.25, 0.75]
    return RenderedImage(coefficients, spectra, NM, coverage, np.array([0, 1]), ("left", "right"))


def test_signals_are_the_integral_and_variances_means_of_relative_ones(image):
    bands = render_bands(image, RESPONSES)
    weights = np.full(NM.size, 1.0)
    weights[[0, -1]] = 0.5
    for index, response in enumerate(RESPONSES):
        each = (image.coefficients.astype(float) @ image.spectra) @ (response.factor * response.response * weights)
        mean, variance = each.mean(axis=0), each.var(axis=0, ddof=1) / 4
        np.testing.assert_allclose(bands.signal.values[index], mean, rtol=1e-6)
        pooled = variance.copy()
        mask = image.coverage.max(axis=-1) == 1
        for v, u in np.argwhere(mask):
            # beyond the picture its border is repeated
            rows, columns = ([max(i - 1, 0), i, min(i + 1, last)] for i, last in ((v, 6), (u, 8)))
            near = [(r, c) for r in rows for c in columns if mask[r, c]]
            pooled[v, u] = mean[v, u] ** 2 * np.mean([variance[p] / mean[p] ** 2 for p in near])
        np.testing.assert_allclose(bands.variance.values[index], pooled, rtol=1e-5)


def test_the_lamp_and_its_neighbours_are_masked(image):
    mask = render_bands(image, RESPONSES).mask.values
    expected = np.zeros((7, 9), np.uint8)
    expected[5:, 7:] = Mask.LAMP
    np.testing.assert_array_equal(mask, np.stack([expected] * 2))
