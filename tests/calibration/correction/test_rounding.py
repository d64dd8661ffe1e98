"""What rounding to whole counts does to the mean of a dark level."""

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.calibration.correction.noise import ROUNDING_VARIANCE, NoiseModel, _phase_sigma, _read_noise
from helpers.fakes.capture import BIAS, DEPTH, GAIN, READ_NOISE, FakeCapture
from scipy.stats import norm

#: Levels between two counts, whole counts.
LEVELS, COUNTS = (np.arange(20000) + 0.5) / 20000, np.arange(-6, 8)


@pytest.mark.parametrize("sigma", [1e-3, 0.1, 0.25, 0.5])
def test_the_rounding_error_is_that_of_rounded_normal_noise(sigma):
    """The expectation of the rounded counts, from the probability of each count: no series, no random numbers."""
    upper, lower = ((COUNTS + half - LEVELS[:, None]) / sigma for half in (0.5, -0.5))
    error = (norm.cdf(upper) - norm.cdf(lower)) @ COUNTS - LEVELS
    noise = NoiseModel(40.0, None, 40.0 * sigma, None)
    assert noise.rounding_error_dn == pytest.approx(np.sqrt(np.mean(error**2)), rel=2e-3, abs=1e-5)


@pytest.mark.parametrize("sigma", [0.25, 0.35, 0.5])
def test_the_variance_of_rounded_noise_scatters_over_the_phases_as_stated(sigma):
    """From the probability of each count, without a series; the next term of the series is below 1e-3 of the first."""
    upper, lower = ((COUNTS + half - LEVELS[:, None]) / sigma for half in (0.5, -0.5))
    chance = norm.cdf(upper) - norm.cdf(lower)
    variance = chance @ COUNTS**2 - (chance @ COUNTS) ** 2
    assert np.std(variance) == pytest.approx(_phase_sigma(sigma**2), rel=0.02)
    if sigma == 0.5:  # where the read noise is nearly linear in the variance
        electrons = 40.0 * np.sqrt(variance - ROUNDING_VARIANCE)
        _, sigma_e = _read_noise(sigma**2 + ROUNDING_VARIANCE, 40.0, np.zeros((2, 2)), gain_is_fitted=True)
        assert np.std(electrons) == pytest.approx(sigma_e, rel=0.02)


@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.9])
def test_the_sigma_of_the_read_noise_is_that_of_lines_drawn_with_their_covariance(correlation):
    """Floor and slope drawn together 200,000 times; a standard deviation has a standard error of 0.2%.

    With a stated gain the slope's error plays no part.
    """
    floor, slope = 4.0 + ROUNDING_VARIANCE, 0.25
    sigma = np.array([0.02, 0.002])
    covariance = np.outer(sigma, sigma) * np.array([[1, correlation], [correlation, 1]])
    lines = np.random.default_rng(8).multivariate_normal([floor, slope], covariance, 200_000)
    electrons = np.sqrt(lines[:, 0] - ROUNDING_VARIANCE) / lines[:, 1]
    read, stated_read = _read_noise(floor, 1 / slope, covariance, gain_is_fitted=True)
    assert read == pytest.approx(2.0 / slope) and stated_read == pytest.approx(np.std(electrons), rel=0.02)
    by_gain = np.sqrt(lines[:, 0] - ROUNDING_VARIANCE) / slope
    _, with_stated_gain = _read_noise(floor, 1 / slope, covariance, gain_is_fitted=False)
    assert with_stated_gain == pytest.approx(np.std(by_gain), rel=0.02)


class _Coarse(FakeCapture):
    """Counts of many electrons each, with a read noise of a part of a count."""

    gain_e, read_dn = 60.0, 0.25

    def counts(self, signal, exposure_s):
        electrons = self.rng.poisson(self.gain_e * 0.1 * (signal + self.rate * exposure_s))
        counted = electrons / self.gain_e + self.read_dn * self.rng.standard_normal(signal.shape)
        return np.clip(np.rint(counted + self.bias), 0, 2**DEPTH - 1).astype(np.uint16)


@pytest.mark.parametrize("level", [BIAS, BIAS + 0.3, BIAS + 0.5])
@pytest.mark.parametrize("read_dn", [0.1, 0.25, 0.35, 0.5])
def test_gain_and_read_noise_of_coarse_counts_are_as_uncertain_as_stated(tmp_path, read_dn, level):
    """All pixels' dark level lies at one place between two counts: the variance of the darks is no measure of noise.

    Limits at 3.5 standard deviations: one of the 24 values is beyond them in one of 90 seeds.
    """
    fake = _Coarse(tmp_path / "capture", seed=3, centres=(450, 550, 650))
    fake.read_dn, fake.bias = read_dn, np.full_like(fake.bias, level)
    folder = fake.write()
    manifest = (folder / "capture.toml").read_text()
    lines = [line for line in manifest.splitlines() if not line.startswith(("gain_e", "read_noise"))]
    (folder / "capture.toml").write_text("\n".join(lines))
    capture = load_capture(folder)
    noise = measure_noise(capture, read_darks(capture))
    assert noise.gain_e_per_dn == pytest.approx(fake.gain_e, abs=3.5 * noise.gain_sigma)
    assert noise.gain_sigma < 0.04 * fake.gain_e
    read_e = read_dn * fake.gain_e
    assert noise.read_noise_e == pytest.approx(read_e, abs=3.5 * noise.read_noise_sigma)


def test_a_capture_without_flats_and_one_dark_exposure_uses_the_stated_gain(tmp_path):
    """The charge in its darks is everywhere the same: they show the read noise and not the gain."""
    fake = FakeCapture(tmp_path / "capture", seed=5, centres=(550,))
    capture = load_capture(fake.write(flats=False))
    noise = measure_noise(capture, read_darks(capture))
    assert (noise.gain_e_per_dn, noise.gain_sigma) == (GAIN, None)
    assert noise.read_noise_e == pytest.approx(READ_NOISE, abs=4.5 * noise.read_noise_sigma)


def test_without_flats_thermal_noise_of_the_darks_is_taken_off_by_the_stated_gain(tmp_path):
    """A warm sensor: the longest dark holds 600 DN, whose noise is seven times that of reading."""
    fake = FakeCapture(tmp_path / "capture", seed=5, centres=(450, 550, 650))
    fake.rate = fake.rate * 600.0 / 1.5 / max(fake.exposure.values())
    capture = load_capture(fake.write(flats=False))
    noise = measure_noise(capture, read_darks(capture))
    assert noise.read_noise_e == pytest.approx(READ_NOISE, abs=4.5 * noise.read_noise_sigma)
    assert noise.read_noise_sigma < 0.5 * READ_NOISE
