"""Errors that samples share, as columns over the noise."""

import numpy as np
from cboxlab.validation.diagnose.linear_model.model import BandErrors, _shared_errors


def test_shared_errors_are_dark_levels_then_bands_then_faces():
    """0.07 % of a band and what its spectra add in quadrature, 0.1 % of a face by its share of the pixel."""
    signal = np.array([[[100.0, 200]], [[300, 400]]])
    coverage = np.array([[[0.25, 0.75], [1.0, 0.0]]])
    used = np.ones(signal.shape, bool)
    sigma = np.array([2.0, 4, 5, 8])
    errors = BandErrors(np.array([0.0, 0.0024]), 0.5)
    columns = _shared_errors(signal, coverage, used, sigma, errors)[:4].T
    flat = signal.ravel()
    expected = [
        [0.5, 0.5, 0, 0],
        [0, 0, 0.5, 0.5],
        0.0007 * flat * [1, 1, 0, 0],
        0.0025 * flat * [0, 0, 1, 1],
        0.001 * flat * [0.25, 1, 0.25, 1],
        0.001 * flat * [0.75, 0, 0.75, 0],
    ]
    np.testing.assert_allclose(columns, np.array(expected, float) / sigma, rtol=1e-6)
