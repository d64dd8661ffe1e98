"""Three kinds of uncertainty, apart: over a thousand simulated captures the intervals hold the truth."""

import numpy as np
import pytest
from cboxlab.calibration.radiometry.radiometry import BandConstant, band_scatter, join_constants
from cboxlab.calibration.radiometry.uncertainty import Uncertainty, measure_uncertainty, xyz_parts
from scipy import stats

CAPTURES, PIXELS = 1000, 400
BANDS = tuple("abcdefg")
MATRIX = np.random.default_rng(0).uniform(-0.2, 1.0, (3, 7))
SIGNAL = np.linspace(300, 2500, 7)
STATED = Uncertainty(BANDS, 0.004**2 * np.eye(7), 0.01)


def captures(uncertainty, rng):
    """(capture, band) mean signals over PIXELS pixels and the variance of these means."""
    variance = SIGNAL / 12 / PIXELS
    common = 1 + uncertainty.common * rng.standard_normal((CAPTURES, 1))
    band = 1 + uncertainty.band * rng.standard_normal((CAPTURES, 7))
    return SIGNAL * common * band + np.sqrt(variance) * rng.standard_normal((CAPTURES, 7)), variance


@pytest.mark.parametrize(
    "kinds", [(0.0, 0.0), (0.004, 0.0), (0.0, 0.01), (0.004, 0.01)], ids=["pixel", "band", "common", "all"]
)
def test_intervals_cover_the_truth(kinds):
    """Mahalanobis squares of XYZ follow chi-square with 3 degrees: KS at 1e-4; 68% and 95% by the binomial."""
    uncertainty = Uncertainty(BANDS, kinds[0] ** 2 * np.eye(7), kinds[1])
    means, variance = captures(uncertainty, np.random.default_rng(11))
    parts = xyz_parts(SIGNAL, variance, MATRIX, uncertainty)
    off = means @ MATRIX.T - SIGNAL @ MATRIX.T
    squares = np.einsum("ni,ij,nj->n", off, np.linalg.inv(parts.total), off)
    assert stats.kstest(squares, stats.chi2(3).cdf).pvalue > 1e-4
    pulls = off / np.sqrt(np.diag(parts.total))
    for limit in (1, 2):
        expected = stats.norm.cdf(limit) - stats.norm.cdf(-limit)
        shares = np.mean(np.abs(pulls) < limit, axis=0)
        assert np.all(np.abs(shares - expected) < 4 * np.sqrt(expected * (1 - expected) / CAPTURES))


def test_one_kind_alone_would_not_do():
    """The independent part alone covers the truth far too seldom: what the three kinds are for."""
    means, variance = captures(STATED, np.random.default_rng(12))
    parts = xyz_parts(SIGNAL, variance, MATRIX, STATED)
    off = means @ MATRIX.T - SIGNAL @ MATRIX.T
    assert np.mean(np.abs(off) < np.sqrt(np.diag(parts.pixel))) < 0.3


def test_chromaticity_knows_no_common_error():
    """x = X / (X + Y + Z) does not change with a common factor: its variance from that part is 0."""
    parts = xyz_parts(SIGNAL, np.zeros(7), MATRIX, STATED)
    xyz = MATRIX @ SIGNAL
    gradient = (np.array([1.0, 0, 0]) * xyz.sum() - xyz[0]) / xyz.sum() ** 2
    assert gradient @ parts.common @ gradient < 1e-12 * (gradient @ parts.band @ gradient)


def test_maps_have_a_covariance_in_every_pixel():
    signal = SIGNAL[:, None, None] * np.ones((7, 4, 5))
    parts = xyz_parts(signal, signal / 12, MATRIX, STATED)
    single = xyz_parts(SIGNAL, SIGNAL / 12, MATRIX, STATED)
    assert parts.total.shape == (4, 5, 3, 3)
    np.testing.assert_allclose(parts.total[2, 3], single.total)


def test_scatter_between_bands_by_simulation():
    """Mean square of the estimate over 2000 sets of seven bands: the true one within 4 standard errors."""
    rng = np.random.default_rng(3)
    squares = []
    for _ in range(2000):
        values = 1 + 0.004 * rng.standard_normal(7) + 0.001 * rng.standard_normal(7)
        constants = tuple(BandConstant(b, v, 0.001, 100) for b, v in zip(BANDS, values, strict=True))
        squares.append(band_scatter(constants) ** 2)
    assert abs(np.mean(squares) - 0.004**2) < 4 * np.std(squares) / np.sqrt(2000) + 0.004**2 * 0.02


def test_bands_that_agree_have_no_scatter():
    constants = tuple(BandConstant(b, 1.0, 0.001, 100) for b in BANDS)
    assert band_scatter(constants) == 0.0 and band_scatter(constants[:1]) == 0.0


def test_constant_and_bands_share_their_errors():
    """5000 sets of seven bands: C within Student's interval as often as stated, and band errors, correlated
    through C, scatter by the stated covariance. False alarms: 4 standard errors each, below 1e-3 together.
    """
    rng, sets, scatter, noise = np.random.default_rng(8), 5000, 0.004, 0.0015
    inside, residual, stated_covariance = np.zeros(2), np.zeros((7, 7)), np.zeros((7, 7))
    for _ in range(sets):
        deviations = scatter * rng.standard_normal(7)
        values = 1 + deviations + noise * rng.standard_normal(7)
        constants = join_constants([BandConstant(b, v, noise, 100) for b, v in zip(BANDS, values, strict=True)], 1.0)
        limits = stats.t.ppf([0.84134, 0.97725], constants.degrees) * constants.sigma
        inside += np.abs(constants.constant - 1) < limits
        off = 1 + deviations - constants.constant
        shared = measure_uncertainty(constants, BANDS)
        residual += np.outer(off, off)
        stated_covariance += shared.band_covariance + shared.common**2
    expected = np.array([0.68268, 0.9545])
    # A scatter of 0 is all that is known of a small one: up to 1% too few.
    assert np.all(np.abs(inside / sets - expected) < 0.01 + 4 * np.sqrt(expected * (1 - expected) / sets))
    spread = np.diag(residual) / np.diag(stated_covariance)
    assert np.all(np.abs(spread - 1) < 0.03 + 4 * np.sqrt(2 / sets))
    assert residual.sum() / stated_covariance.sum() == pytest.approx(1.0, abs=0.15)


def test_bands_known_unequally_well_err_less_the_error_of_their_mean():
    """With weights a in C the errors are (I - 1 a^T) times independent ones; noise makes the weights unequal."""
    rng = np.random.default_rng(9)
    noise = np.geomspace(0.002, 0.03, 7)
    values = 1 + np.hypot(0.008, noise) * rng.standard_normal(7)
    constants = join_constants([BandConstant(b, v, n, 100) for b, v, n in zip(BANDS, values, noise, strict=True)], 1)
    assert constants.scatter > 0 and np.ptp(constants.weights) > 0.05
    projection = np.eye(7) - np.outer(np.ones(7), constants.weights)
    shared = measure_uncertainty(constants, tuple(c.band for c in constants.by_band))
    np.testing.assert_allclose(
        shared.band_covariance, constants.scatter**2 * projection @ projection.T, rtol=1e-9, atol=1e-15
    )


def test_two_references_of_a_band_are_one_band():
    constants = [
        BandConstant("a", 1.01, 0.001, 9),
        BandConstant("a", 1.01, 0.001, 9),
        BandConstant("b", 1.0, 0.001, 9),
    ]
    joined = join_constants(constants, None)
    assert [c.band for c in joined.by_band] == ["a", "b"] and joined.chi2_degrees == 1
    assert joined.constant == pytest.approx(1.005, abs=2e-4) and joined.degrees == pytest.approx(1.0, rel=0.1)
