"""Filter weights and XYZ: exact where the filters span the observer, quiet where noise is stated."""

import numpy as np
import pytest
from cboxlab.calibration.colour.colorimetry import fit_filter_weights, xyz_image
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY, colour_matching_functions
from cboxlab.calibration.instrument.band_images import Mask, band_images
from cboxlab.calibration.instrument.band_response import BandResponse
from cboxlab.calibration.radiometry.uncertainty import Uncertainty
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from helpers.fakes.capture import CENTRES_NM, response


def fake_responses(factor=1e-12):
    return tuple(BandResponse(f"f{c}", INTEGRAL_GRID, response(c), factor * (1 + c / 1000)) for c in CENTRES_NM)


def spanning_responses():
    """Three bands that are mixtures of the observer's own functions: the Luther condition."""
    mixtures = np.array([[1.0, 0.3, 0.1], [0.2, 1.0, 0.3], [0.1, 0.2, 1.0]]) @ colour_matching_functions()
    return tuple(BandResponse(str(i), INTEGRAL_GRID, 1e18 * m, 1e-16 * (i + 1)) for i, m in enumerate(mixtures))


def images(signal):
    signal = np.asarray(signal, float)[:, None, None]
    return band_images([str(i) for i in range(len(signal))], signal, np.ones_like(signal))


def test_colour_matching_functions_are_cie_1931():
    """Table values: ybar(555) = 1.0000, xbar(600) = 1.0622, zbar(450) = 1.77211."""
    x, y, z = colour_matching_functions()
    assert y[155] == pytest.approx(1.0, abs=2e-4)
    assert x[200] == pytest.approx(1.0622, abs=1e-4)
    assert z[50] == pytest.approx(1.77211, abs=1e-4)


def test_filters_that_span_the_observer_give_exact_xyz():
    """Any spectrum, an erratic one included, then has the XYZ of direct integration, whatever the K_i."""
    responses = spanning_responses()
    weights = fit_filter_weights(responses)
    assert np.all(weights.residual_rms < 1e-12)
    radiance = np.random.default_rng(4).uniform(0, 1e-3, WAVELENGTH_NM.size)
    measured = xyz_image(images([r.signal(radiance) for r in responses]), weights, responses)
    direct = LUMINOUS_EFFICACY * colour_matching_functions() @ (INTEGRAL_GRID.weights * radiance)
    np.testing.assert_allclose(measured["xyz"].values[:, 0, 0], direct, rtol=1e-9)


def test_luminance_of_a_narrow_line_is_683_lumens_per_watt():
    """A line of 1 W m^-2 sr^-1 at 555 nm has 683 cd m^-2."""
    responses = spanning_responses()
    line = np.where(WAVELENGTH_NM == 555, 1.0, 0.0)
    weights = fit_filter_weights(responses)
    measured = xyz_image(images([r.signal(line) for r in responses]), weights, responses)
    assert measured["xyz"].values[1, 0, 0] == pytest.approx(683.0, rel=1e-3)


def test_exposure_cancels():
    """Twice the exposure in one band doubles its signal and its K: XYZ stays."""
    radiance = 1e-4 * (1 + (WAVELENGTH_NM - 400) / 300)
    results = []
    for factor in (1.0, 2.0):
        responses = list(fake_responses())
        last = responses[3]
        responses[3] = BandResponse(last.band, last.grid, last.response, factor * last.factor)
        weights = fit_filter_weights(responses, 0.01)
        signal = [r.signal(radiance) for r in responses]
        results.append(xyz_image(images(signal), weights, responses)["xyz"].values)
    np.testing.assert_allclose(*results, rtol=1e-12)


def test_without_noise_the_fit_is_least_squares():
    """The residual is orthogonal to every response: the normal equations, weighted by the grid."""
    weights = fit_filter_weights(fake_responses())
    step = INTEGRAL_GRID.weights
    curves = np.stack([r.response for r in fake_responses()])
    residual = weights.target - weights.reconstructed
    scale = np.sqrt(np.outer((residual**2) @ step, (curves**2) @ step))
    np.testing.assert_allclose((residual * step) @ curves.T / scale, 0, atol=1e-7)


@pytest.mark.parametrize("noise", [0.003, 0.03, 0.3])
def test_regularised_weights_err_less_at_the_stated_noise(noise):
    """Simulated light of independent values per stretch of 43 nm with the stated noise: smaller total error.

    Paired over 4000 spectra; the difference is compared with its own standard error.
    """
    responses = fake_responses()
    plain, quiet = fit_filter_weights(responses), fit_filter_weights(responses, noise)
    rng = np.random.default_rng(9)
    step = INTEGRAL_GRID.weights
    stretch = 300 / len(responses)
    values = rng.standard_normal((4000, WAVELENGTH_NM.size)) * np.sqrt(stretch)
    areas = np.array([r.response @ step for r in responses])
    # White light whose integral over one stretch has the variance of one constant value over that stretch.
    exact = (values * np.sqrt(step)) @ np.stack([r.response for r in responses]).T
    truth = (values * np.sqrt(step)) @ plain.target.T
    signal = exact + noise * areas * rng.standard_normal(exact.shape)
    error = [np.sum((signal @ w.weights.T - truth) ** 2, axis=1) for w in (plain, quiet)]
    gain = error[0] - error[1]
    assert gain.mean() > -3 * gain.std() / np.sqrt(gain.size)
    if noise >= 0.03:
        assert gain.mean() > 0
    assert np.all(quiet.noise_gain <= plain.noise_gain * (1 + 1e-9))
    assert np.all(quiet.residual_rms >= plain.residual_rms * (1 - 1e-9))


def test_noise_gain_by_simulation():
    """Equal-energy light with 1% noise in every band: the relative scatter of X, Y, Z is 1% of noise_gain.

    20,000 draws: relative standard error of a standard deviation 0.5%; limit 4.5 of it.
    """
    responses = fake_responses()
    weights = fit_filter_weights(responses, 0.01)
    clean = np.array([r.signal(np.ones(WAVELENGTH_NM.size)) for r in responses])
    draws = clean * (1 + 0.01 * np.random.default_rng(2).standard_normal((20000, clean.size)))
    xyz = draws / [r.factor for r in responses] @ weights.weights.T
    spread = xyz.std(axis=0) / xyz.mean(axis=0)
    np.testing.assert_allclose(spread, 0.01 * weights.noise_gain, rtol=0.0225)


def test_variance_of_xyz_by_simulation():
    """Independent band noise: 40,000 draws, limits at 4.5 standard errors of a variance (0.7% each)."""
    responses = fake_responses()
    weights = fit_filter_weights(responses, 0.01)
    rng = np.random.default_rng(6)
    variance = rng.uniform(1, 9, 7)
    signal = 1000 + np.sqrt(variance)[:, None, None] * rng.standard_normal((7, 200, 200))
    data = band_images([r.band for r in responses], signal, np.broadcast_to(variance[:, None, None], signal.shape))
    measured = xyz_image(data, weights, responses)
    sample = measured["xyz"].values.reshape(3, -1).var(axis=1)
    np.testing.assert_allclose(sample, measured["variance"].values[:, 0, 0], rtol=4.5 * 0.0071)


def test_flags_of_all_bands_are_joined():
    signal = np.ones((3, 2, 2))
    mask = np.zeros((3, 2, 2), np.uint8)
    mask[0, 0, 0], mask[2, 0, 0], mask[1, 1, 1] = Mask.HOT, Mask.SATURATED, Mask.LAMP
    responses = spanning_responses()
    joined = xyz_image(band_images("012", signal, signal, mask), fit_filter_weights(responses), responses)
    assert joined["mask"].values.tolist() == [[Mask.HOT | Mask.SATURATED, 0], [0, Mask.LAMP]]


def test_errors_of_the_weights_are_parts_of_the_colour():
    """X and Y 1 % too large together in half of all spectra: 0.5e-4 of their products; a bright pixel has 4 times."""
    signal = np.full((3, 1, 2), 10.0) * np.array([1.0, 2.0])
    responses, errors = spanning_responses(), np.array([[0.01, 0.01, 0.0], [0.0, 0.0, 0.0]])
    none = Uncertainty(("0", "1", "2"), np.zeros((3, 3)), 0.0)
    weights = fit_filter_weights(responses)
    result = xyz_image(band_images("012", signal, signal), weights, responses, none, errors)
    xyz = np.moveaxis(result["xyz"].values, 0, -1)
    expected = xyz[..., :, None] * xyz[..., None, :] * 0.5e-4 * np.outer([1, 1, 0], [1, 1, 0])
    np.testing.assert_allclose(result["covariance_weights"].values, expected, rtol=1e-9)
    assert expected[0, 1, 0, 1] == pytest.approx(4 * expected[0, 0, 0, 1])
