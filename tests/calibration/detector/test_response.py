"""Response series and the static nonlinearity: laws that hold, departures named with their size."""

import numpy as np
import pytest
from cboxlab.calibration.detector.nonlinearity import LightSeries, fit_curve
from cboxlab.calibration.detector.response import LAWS, fit_response
from scipy import stats

FULL = 4095.0
TIMES = np.array([0.1, 0.2, 0.5, 1.0, 2.0, 4.0])


@pytest.mark.parametrize(
    ("key", "settings"),
    [
        ("exposure", TIMES),
        ("f_number", np.array([4.0, 5.6, 8.0, 11.0, 16.0])),
        ("image_distance", np.array([35.5, 36.6, 38.0, 42.0, 50.0])),
        ("flux", np.array([1.0, 3.0, 10.0, 30.0])),
    ],
)
def test_laws_that_hold(key, settings):
    """Proportional signals with the stated noise: slope within 4.5 sigma, improbable less than once in 1000."""
    law = LAWS[key]
    x = settings**law.power
    slope = 3000 / x.max()
    rng = np.random.default_rng(1)
    noise = 0.002 * slope * x
    fit = fit_response(law, settings, slope * x + noise * rng.standard_normal(x.size), noise, FULL)
    assert abs(fit.slope - slope) < 4.5 * fit.slope_sigma
    assert fit.departure is None and "holds" in fit.verdict


def test_probabilities_are_uniform_under_the_law():
    """500 series with noise far above the repeatability: the p-values are uniform (KS at 1e-4)."""
    rng = np.random.default_rng(6)
    signal = 500 * TIMES
    fits = [
        fit_response(LAWS["exposure"], TIMES, signal + 0.02 * signal * rng.standard_normal(6), 0.02 * signal, FULL)
        for _ in range(500)
    ]
    assert stats.kstest([f.probability for f in fits], "uniform").pvalue > 1e-4


@pytest.mark.parametrize(
    ("kind", "size", "signal"),
    [
        ("offset", 0.01, 700 * (TIMES + 0.01)),
        ("bend", -0.08, 700 * TIMES * (1 - 0.08 * 700 * TIMES / FULL)),
        ("exponent", 0.02, 700 * TIMES**1.02),
    ],
)
def test_a_departure_is_named_with_its_size(kind, size, signal):
    """A shutter 10 ms late, 8% compression, a dial that is 2% steep: distinguished, sizes within 4 sigma."""
    rng = np.random.default_rng(3)
    noisy = signal * (1 + 5e-4 * rng.standard_normal(signal.size))
    fit = fit_response(LAWS["exposure"], TIMES, noisy, 5e-4 * signal, FULL)
    assert fit.departure is not None and fit.departure.kind == kind
    assert abs(fit.departure.size - size) < 4 * fit.departure.sigma
    assert fit.departure.sigma < 0.2 * abs(size)
    if kind == "exponent":
        assert float(fit.departure.text.split()[1]) == pytest.approx(1.02, abs=4 * fit.departure.sigma)
    assert fit.departure.text in fit.verdict
    assert np.abs(fit.residual_after).max() < 0.005 < np.abs(fit.residual).max()


def test_a_stray_light_offset_in_an_f_number_series_is_in_counts():
    f = np.array([4.0, 5.6, 8.0, 11.0, 16.0, 22.0])
    signal = 40000 / f**2 + 15.0
    fit = fit_response(LAWS["f_number"], f, signal, 1e-3 * signal, FULL)
    assert fit.departure.kind == "offset" and fit.departure.text.endswith("DN")
    assert fit.departure.size == pytest.approx(15.0, abs=3 * fit.departure.sigma)


def test_chaos_is_explained_by_nothing():
    signal = 700 * TIMES * np.array([1, 1.1, 0.9, 1.1, 0.9, 1.0])
    fit = fit_response(LAWS["exposure"], TIMES, signal, 1e-3 * signal, FULL)
    assert fit.departure is None and "no single departure" in fit.verdict


def test_two_points_are_no_series():
    with pytest.raises(ValueError, match="three settings"):
        fit_response(LAWS["exposure"], [1, 2], [1, 2], [0.1, 0.1], FULL)


def dcs420(count, dark=25.0):
    """12 bits to 8 as a square root does it, a stand-in: the paper does not print its table."""
    return dark + (255 - dark) * np.sqrt(np.clip(count, 0, 4095) / 4095)


def simulated_series(rng, mapping, noise, names=8, points=14):
    series = []
    for index in range(names):
        light = np.geomspace(0.02, 1, points) * rng.uniform(0.5, 1)
        count = mapping(4095 * light) + noise * rng.standard_normal(points)
        unit = rng.uniform(0.1, 10)
        series.append(LightSeries(f"s{index}", light * unit, count, np.full(points, noise)))
        series[-1].__dict__["true"] = light, unit
    return series


def test_the_curve_of_a_12_to_8_bit_camera():
    """Eight series of unknown scale: the curve within 0.5% of full scale, residuals as small as the noise.

    Noise 0.476 counts, the paper's dark noise; through the steepest slope of the curve, 2 / 230 per count,
    that is at most 0.0041 of full scale, where the paper's residual has an rms of 0.0021.
    """
    rng = np.random.default_rng(0)
    series = simulated_series(rng, dcs420, 0.476)
    curve = fit_curve(series, 25.0)
    true = np.linspace(0.05, 0.9, 40)
    top = curve.linear(dcs420(4095 * 0.9)) / 0.9
    np.testing.assert_allclose(curve.linear(dcs420(4095 * true)) / top, true, atol=0.005)
    assert np.all(np.diff(curve.knot_value) >= 0)
    assert curve.statistics["rms"] < 0.0041 < curve.statistics["rms"] + 0.0035
    assert 0.7 * 0.476 < curve.statistics["rms_dn"] < 1.3 * 0.476
    assert curve.line_rms > 10 * curve.statistics["rms"]
    for frame in series:
        light, unit = frame.__dict__["true"]
        assert curve.scales[frame.name] * unit / top == pytest.approx(1.0, rel=0.01)
        assert light.max() <= 1


def test_a_linear_camera_needs_no_curve():
    """Then the curve is the line: no better than it by more than the noise that the curve follows."""
    rng = np.random.default_rng(1)
    series = simulated_series(rng, lambda c: 13.6 + 240 * c / 4095, 0.89)
    curve = fit_curve(series, 13.6)
    assert 0.8 * curve.line_rms < curve.statistics["rms"] <= curve.line_rms * 1.001


def test_counts_and_light_are_inverse():
    curve = fit_curve(simulated_series(np.random.default_rng(2), dcs420, 0.2), 25.0)
    value = np.linspace(0.01, 0.99, 50)
    np.testing.assert_allclose(curve.linear(curve.count(value)), value, atol=1e-9)


def test_too_few_points_for_a_curve():
    few = LightSeries("a", np.array([1.0, 2.0]), np.array([10.0, 20.0]), np.ones(2))
    with pytest.raises(ValueError, match="6 points"):
        fit_curve([few], 0.0)
