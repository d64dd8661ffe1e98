"""Scatter of the pixels' sensitivities without a flat, by the residuals of a comparison."""

import numpy as np
import pytest
from cboxlab.calibration.correction.picture_noise import pixel_scatter, scatter_of_residuals

SIDE, GAIN = 96, 4.0


def photograph(scatter, seed, flaw=0.0):
    """Measured and rendered signals of two bands, with an edge, shading, and a flaw of the rendering."""
    rng = np.random.default_rng(seed)
    v, u = np.indices((SIDE, SIDE)) / SIDE
    walls = 2000 * np.where(u < 0.4, 0.3, 1.0) * (1 - 0.5 * v**2)
    rendered = np.stack([walls, 0.5 * walls * (1 + u)])
    sensitivity = 1 + scatter * rng.standard_normal((SIDE, SIDE))
    light = rendered * (1 + flaw * np.sin(2 * np.pi * u)) * sensitivity
    measured = rng.poisson(GAIN * light) / GAIN
    return measured, rendered, rendered / GAIN


@pytest.mark.parametrize("scatter", [0.0, 0.003, 0.01, 0.03])
def test_the_residuals_show_the_scatter(scatter):
    """Noise of 1.1 to 3 % is taken off. A flaw of 5 % that changes gradually does not count as scatter."""
    usable = np.ones((2, SIDE, SIDE), bool)
    for flaw in (0.0, 0.05):
        estimates = [scatter_of_residuals(*photograph(scatter, seed, flaw), usable) for seed in range(4)]
        assert np.sqrt(np.mean(np.square(estimates))) == pytest.approx(scatter, rel=0.05, abs=0.002)


def test_behind_a_mosaic_neighbours_of_one_channel_count():
    measured, rendered, variance = photograph(0.01, 5)
    channel = np.zeros((2, SIDE, SIDE), bool)
    channel[0, ::2, ::2], channel[1, 1::2, 1::2] = True, True
    colours = np.where(channel.any(axis=0), 1.0, 3.0)
    estimate = scatter_of_residuals(measured * colours, rendered, variance, channel, (2, 2))
    assert estimate == pytest.approx(0.01, rel=0.15)


def test_edges_of_the_picture_widen_the_first_estimate():
    measured, _, variance = photograph(0.01, 6)
    first = pixel_scatter(measured[0], variance[0], np.ones((SIDE, SIDE), bool))
    assert 0.009 < first < 0.02


def test_too_few_pixels_say_nothing():
    measured, rendered, variance = photograph(0.01, 7)
    few = np.zeros((2, SIDE, SIDE), bool)
    few[0, :8, :8] = True
    assert np.isnan(scatter_of_residuals(measured, rendered, variance, few))
