"""Sensitivities from narrow-band readings: three estimates on the same lights, against the truth behind them."""

import numpy as np
import pytest
from cboxlab.calibration.radiometry.spectral_sensitivity import (
    NarrowBandReadings,
    _curvature,
    band_constant,
    convex_sets,
    least_squares,
    wiener,
)
from cboxlab.utils.errors import InputError

GRID = np.arange(390.0, 711.0, 5.0)
SIGMA = 0.3
#: A channel with a main lobe, a shoulder and dark ends, in DN per unit of light.
TRUTH = np.exp(-0.5 * ((GRID - 540) / 35) ** 2) + 0.3 * np.exp(-0.5 * ((GRID - 620) / 20) ** 2)
ESTIMATES = {
    "wiener": wiener,
    "least squares": least_squares,
    "convex sets": lambda readings: convex_sets(readings)[0],
}


def readings(seed=1, noise=SIGMA) -> NarrowBandReadings:
    """31 lights, 400 to 700 nm, triangles of 20 nm full width at half maximum, brightest reading about 200."""
    centres = np.arange(400.0, 701.0, 10.0)
    stimuli = 10.0 * np.maximum(1 - np.abs(GRID - centres[:, None]) / 20, 0)
    exact = NarrowBandReadings(GRID, stimuli, np.zeros(31), np.ones(31)).predicted(TRUTH)
    response = exact + noise * np.random.default_rng(seed).standard_normal(31)
    return NarrowBandReadings(GRID, stimuli, response, np.full(31, SIGMA))


@pytest.mark.parametrize("name", ESTIMATES)
def test_every_estimate_is_positive_fits_and_is_near_the_truth(name):
    data = readings()
    estimate = ESTIMATES[name](data)
    assert estimate.min() >= 0
    # within 1% of the largest reading, where noise is 0.15%
    assert np.abs(data.predicted(estimate) - data.response).max() < 2.0
    inside = (GRID >= 400) & (GRID <= 700)
    assert np.sqrt(np.mean((estimate - TRUTH)[inside] ** 2)) < 0.03


@pytest.mark.parametrize("name", ESTIMATES)
def test_every_estimate_scales_with_the_readings_unit(name):
    """Light in other units: the sensitivity changes by the inverse, the predictions do not."""
    data = readings()
    other = NarrowBandReadings(GRID, data.stimuli * 1e-7, data.response, data.sigma)
    expected = ESTIMATES[name](data)
    np.testing.assert_allclose(ESTIMATES[name](other) * 1e-7, expected, atol=1e-4 * expected.max())


def test_the_wiener_estimate_is_the_formula_where_that_is_positive():
    """m + K A^T (A K A^T + s^2)^-1 (r - A m), written out here."""
    data = readings()
    data = NarrowBandReadings(GRID, data.stimuli, data.response + 60.0, data.sigma)
    mean = band_constant(data)
    lag = np.abs(np.subtract.outer(np.arange(GRID.size), np.arange(GRID.size)))
    covariance = mean.var() * np.corrcoef(mean[:-1], mean[1:])[0, 1] ** lag
    system = data.matrix @ covariance @ data.matrix.T + 0.02 * data.response.max() * np.eye(31)
    formula = mean + covariance @ data.matrix.T @ np.linalg.solve(system, data.response - data.matrix @ mean)
    assert formula.min() > 0
    np.testing.assert_allclose(wiener(data), formula, rtol=1e-6)


def test_the_wiener_estimate_is_better_than_constant_bands():
    data = readings(noise=0)
    assert np.sum((data.predicted(wiener(data)) - data.response) ** 2) < 0.1 * np.sum(
        (data.predicted(band_constant(data)) - data.response) ** 2
    )


def test_the_smoothest_fit_misses_by_as_much_as_noise_does():
    data = readings()
    misfit = np.sum(((data.predicted(least_squares(data)) - data.response) / data.sigma) ** 2)
    assert misfit == pytest.approx(31, rel=0.01)


def test_convex_sets_are_met_or_the_failure_is_reported():
    data = readings()
    estimate, met = convex_sets(data)
    assert met
    assert np.all(np.abs(data.predicted(estimate) - data.response) <= 2 * data.sigma * (1 + 1e-6))
    apart = NarrowBandReadings(
        GRID, np.vstack([data.stimuli, data.stimuli[:1]]), np.append(data.response, 500.0), np.full(32, SIGMA)
    )
    assert not convex_sets(apart, rounds=20)[1]


def test_a_flat_sensitivity_comes_back_flat():
    data = readings()
    flat = NarrowBandReadings(GRID, data.stimuli, data.predicted(np.ones(GRID.size)), data.sigma)
    np.testing.assert_allclose(wiener(flat), 1.0, rtol=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        {"stimuli": np.ones((30, GRID.size))},
        {"sigma": np.zeros(31)},
        {"wavelength_nm": GRID[::-1]},
        {"stimuli": -np.ones((31, GRID.size))},
    ],
)
def test_readings_that_make_no_sense_are_refused(change):
    data = readings()
    fields = {name: getattr(data, name) for name in ("wavelength_nm", "stimuli", "response", "sigma")}
    with pytest.raises(InputError, match="readings"):
        NarrowBandReadings(**{**fields, **change})


def test_curvature_on_an_uneven_grid_is_that_of_the_function():
    """None for a straight line, and 2 for a square, in units of the mean step."""
    nm = np.array([400.0, 405.0, 420.0, 430.0, 440.0])
    position = nm / 10.0
    rows = _curvature(nm)
    np.testing.assert_allclose(rows @ (3 + 2 * position), 0, atol=1e-9)
    np.testing.assert_allclose(rows @ position**2, 2)
