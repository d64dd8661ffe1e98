"""Scatter of the pixels' sensitivities without a flat, by the residuals of a comparison."""

import numpy as np
import pytest
from cboxlab.calibration.capture import channel_mask
from cboxlab.calibration.correction.picture_noise import (
    pixel_scatter,
    scatter_of_residuals,
    second_differences,
    steps_within,
)

SIDE, GAIN = 96, 4.0


def estimated(measured, rendered, variance, usable, cell=(1, 1)):
    """Scatter of the sensitivities."""
    (scatter,) = scatter_of_residuals(measured, rendered, variance, usable, [rendered], cell)
    return scatter


def photograph(scatter, seed, flaw=0.0, dim=0.3):
    """Measured and rendered signals of two bands, with an edge, shading, and a flaw of the rendering."""
    rng = np.random.default_rng(seed)
    v, u = np.indices((SIDE, SIDE)) / SIDE
    walls = 2000 * np.where(u < 0.4, dim, 1.0) * (1 - 0.5 * v**2)
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
        estimates = [estimated(*photograph(scatter, seed, flaw), usable) for seed in range(4)]
        assert np.sqrt(np.mean(np.square(estimates))) == pytest.approx(scatter, rel=0.05, abs=0.002)


@pytest.mark.parametrize("pattern", ["RGGB", "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG"], ids=["Bayer", "X-Trans"])
def test_behind_a_mosaic_neighbours_of_one_channel_count(pattern):
    """Pixels of another channel have three times the light, or a third of it. An edge lies every 20 pixels."""
    estimates, across = [], np.where(np.arange(SIDE) // 20 % 2, 0.2, 1.0)
    channel = np.stack([channel_mask(pattern, (SIDE, SIDE), letter) for letter in "RG"])
    for seed in range(4):
        colours = np.where(channel[0], 1.0, np.where(channel[1], 3.0, 1 / 3)) * across
        measured, rendered, variance = photograph(0.01, seed)
        in_colours = measured * colours, rendered * colours, variance * colours**2
        estimates.append(estimated(*in_colours, channel, (6, 6) if " " in pattern else (2, 2)))
    assert np.sqrt(np.mean(np.square(estimates))) == pytest.approx(0.01, rel=0.05)


def test_steps_are_the_shortest_between_pixels_of_one_channel():
    """X-Trans has red pixels at (3, 3) from each other, the nearest triples of one row are 12 pixels long."""
    pattern = "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG"
    red, green = (channel_mask(pattern, (48, 48), letter) for letter in "RG")
    assert steps_within(red, (6, 6)) == ((3, -3), (3, 3))
    assert (1, 1) in steps_within(green, (6, 6))
    bayer = channel_mask("RGGB", (48, 48), "G")
    assert steps_within(bayer, (2, 2)) == ((1, -1), (1, 1))
    assert steps_within(np.ones((48, 48), bool), (1, 1)) == ((1, 0), (0, 1))


def test_the_mean_of_variances_is_that_of_the_difference():
    """The middle pixel of three has two thirds of it, by the difference's answer to each pixel alone."""
    variance, usable, steps = np.array([[2.0, 7.0, 1.0]]), np.ones((1, 3), bool), ((0, 1),)
    answers = [second_differences(pixel[None], usable, steps)[0] for pixel in np.eye(3)]
    expected = variance @ np.square(answers)
    np.testing.assert_allclose(second_differences(variance, usable, steps)[1], expected.ravel())


def test_without_darks_their_levels_scatter_besides_sensitivities():
    """Levels of 0.8 DN rms show in the darkest third; sensitivities of 1 % show in the rest."""
    rng, estimates = np.random.default_rng(2), []
    for seed in range(8):
        measured, rendered, variance = photograph(0.01, seed, dim=0.02)
        measured = measured + 0.8 * rng.standard_normal((SIDE, SIDE))
        usable, levels = np.ones((2, SIDE, SIDE), bool), np.ones_like(rendered)
        estimates.append(scatter_of_residuals(measured, rendered, variance, usable, [rendered, levels]))
    assert np.sqrt(np.mean(np.square(estimates), axis=0)) == pytest.approx([0.01, 0.8], rel=0.08)


def test_edges_of_the_picture_widen_the_first_estimate():
    measured, _, variance = photograph(0.01, 6)
    first = pixel_scatter(measured[0], variance[0], np.ones((SIDE, SIDE), bool))
    assert 0.009 < first < 0.02


def test_too_few_pixels_say_nothing():
    measured, rendered, variance = photograph(0.01, 7)
    few = np.zeros((2, SIDE, SIDE), bool)
    few[0, :8, :8] = True
    assert np.isnan(estimated(measured, rendered, variance, few))
