"""Dark level against exposure: a straight line where it is one, and the real camera where it is not."""

import numpy as np
import pytest
from cboxlab.calibration.correction.dark import DarkLibrary
from cboxlab.calibration.correction.noise import NoiseModel
from cboxlab.calibration.detector.dark_fit import dark_level_sigma, fit_dark, ordinary_pixels
from scipy import stats

#: Vora et al. 2001, Table II: mean dark value of the DCS-200 over R, G, B; exposure in s, counts.
TABLE_2 = {
    8: 12.54,
    4: 12.84,
    2: 12.93,
    1: 13.54,
    0.5: 13.88,
    0.25: 14.30,
    0.125: 14.45,
    1 / 15: 14.32,
    1 / 30: 14.54,
    1 / 60: 14.57,
    1 / 125: 11.88,
}
#: Table III, taken later.
TABLE_3 = {0.125: 14.04, 1 / 125: 13.10}


def test_a_straight_line_comes_back():
    time = np.array([1.0, 2.0, 4.0, 8.0, 30.0])
    fitted = fit_dark(time[::-1], (100 + 0.5 * time)[::-1])
    assert fitted.bias_dn == pytest.approx(100) and fitted.rate_dn_s == pytest.approx(0.5)
    assert fitted.rms_dn < 1e-10 and fitted.monotonic
    assert "rises by 0.5 DN/s" in fitted.verdict
    np.testing.assert_array_equal(fitted.exposure_s, time)


def test_sigmas_cover_the_truth():
    """1000 noisy lines of 8 exposures: pulls follow Student's t with 6 degrees (Kolmogorov-Smirnov, 1e-4)."""
    rng = np.random.default_rng(2)
    time = np.geomspace(0.1, 10, 8)
    fits = [fit_dark(time, 50 + 0.3 * time + 0.1 * rng.standard_normal(8)) for _ in range(1000)]
    for value, sigma, truth in (("bias_dn", "bias_sigma", 50.0), ("rate_dn_s", "rate_sigma", 0.3)):
        pulls = [(getattr(f, value) - truth) / getattr(f, sigma) for f in fits]
        assert stats.kstest(pulls, stats.t(6).cdf).pvalue > 1e-4
    # the mean of 1000 variances of 6 degrees has a standard error of 1.8%
    spread = 0.01 / np.sum((time - time.mean()) ** 2)
    assert np.mean([f.rate_sigma**2 for f in fits]) == pytest.approx(spread, rel=0.08)


def test_scatter_beyond_the_noise_is_not_counted_twice():
    """Of levels that scatter by 1 DN, noise of 0.2 DN is a part: the sigmas are those of the whole scatter alone."""
    time = np.arange(1.0, 9.0)
    level = 50 + 0.3 * time + np.array([1.0, -1, 1, -1, 1, -1, 1, -1])
    plain, noisy = fit_dark(time, level), fit_dark(time, level, noise_dn=0.2)
    assert noisy.bias_sigma == pytest.approx(plain.bias_sigma, rel=1e-12)
    assert noisy.rate_sigma == pytest.approx(plain.rate_sigma, rel=1e-12)
    # and noise that explains the scatter is all there is
    covered = fit_dark(time, level, noise_dn=1.0)
    spread = np.sum((time - time.mean()) ** 2)
    assert covered.rate_sigma == pytest.approx(1 / np.sqrt(spread), rel=1e-12)
    assert covered.bias_sigma == pytest.approx(np.sqrt(1 / 8 + time.mean() ** 2 / spread), rel=1e-12)


def test_the_papers_camera():
    """Table II: the shortest exposure falls 2 counts out of line, and from 1/60 s on the level goes down."""
    fitted = fit_dark(list(TABLE_2), list(TABLE_2.values()), noise_dn=0.02)
    assert not fitted.monotonic
    assert "not monotonic" in fitted.verdict
    assert fitted.exposure_s[np.argmax(np.abs(fitted.residual_dn))] == pytest.approx(1 / 125)
    assert fitted.residual_dn.min() == pytest.approx(-2.0, abs=0.3)
    without = {t: v for t, v in TABLE_2.items() if t > 0.01}
    later = fit_dark(list(without), list(without.values()))
    assert later.rate_dn_s == pytest.approx(-0.24, abs=0.05)
    assert "falls by" in later.verdict and later.rms_dn < 0.4
    assert len(TABLE_3) == 2


def test_two_exposures_make_no_fit():
    with pytest.raises(ValueError, match="three exposures"):
        fit_dark(list(TABLE_3), list(TABLE_3.values()))


def test_noise_alone_is_no_trend():
    """A level that scatters is not said to rise or fall: at most 1 in 20 of 200 (expected 2)."""
    rng = np.random.default_rng(4)
    verdicts = [fit_dark(np.arange(1, 9), rng.standard_normal(8)).verdict for _ in range(200)]
    assert sum("no trend" not in v for v in verdicts) <= 10


@pytest.mark.parametrize("repeats", [1, 25])
def test_a_pixel_is_hot_against_the_noise_of_the_mean_of_the_darks(repeats):
    """Levels that are all rounded alike: what is left is read noise, 2 DN in a frame, over the root of the frames."""
    noise = NoiseModel(1.0, None, 2.0, None)
    sigma = 2.0 / np.sqrt(repeats)
    level = np.full((1, 40, 40), 100.0)
    level[0, 3, 4], level[0, 5, 6] = 100 + 3 * sigma, 100 + 9 * sigma
    dark = DarkLibrary(np.ones(1), np.array([repeats]), level, level[0], 0 * level[0], False)
    assert sorted(map(tuple, np.argwhere(~ordinary_pixels(dark, noise)))) == [(5, 6)]


def test_a_levels_error_is_its_frames_and_pixels_share_of_the_noise():
    """Read noise of 6 e- at 3 e-/DN and shot noise of the thermal charge, over 5 frames and 1200 pixels, and 2."""
    noise = NoiseModel(3.0, None, 6.0, None)
    rate = np.tile([0.5, 1.5], (30, 20))
    dark = DarkLibrary(np.array([2.0, 8.0]), np.array([5, 2]), np.zeros((2, 30, 40)), 0 * rate, rate, False)
    floor = 4.0 + 1 / 12
    expected = [(floor + 1.0 * 2.0 / 3.0) / (5 * 1200), (floor + 1.0 * 8.0 / 3.0) / (2 * 1200)]
    np.testing.assert_allclose(dark_level_sigma(dark, noise), np.sqrt(expected))


def test_a_fall_is_judged_by_the_noise_of_both_levels():
    """Levels of unequal repeats: a fall by 0.5 DN after a level known to 0.2 DN is none, to 0.02 DN it is."""
    time, level = np.array([1.0, 2.0, 4.0, 8.0]), np.array([10.0, 10.5, 10.0, 10.6])
    loud, quiet = np.full(4, 0.02), np.full(4, 0.02)
    loud[1] = 0.2
    assert fit_dark(time, level, loud).monotonic
    assert not fit_dark(time, level, quiet).monotonic
