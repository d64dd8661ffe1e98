"""EMVA 1288 figures: against its reference implementation, and covering the truth as often as stated."""

import logging

import numpy as np
import pytest
from cboxlab.calibration.detector.photon_transfer import FrameStatistics, frame_statistics, transfer
from scipy import stats

SATURATION = 4095
GAIN_E_PER_DN, READ_E, BIAS, DSNU_DN, PRNU = 12.0, 10.0, 100.0, 0.8, 0.01


def sensor(rng, shape=(48, 64), levels=(1200.0, 2300.0), repeats=2):
    """(dark stack, bright stacks) of one simulated sensor."""
    bias = BIAS + DSNU_DN * rng.standard_normal(shape)
    gain = 1 + PRNU * rng.standard_normal(shape)

    def stack(level):
        charge = rng.poisson(GAIN_E_PER_DN * level * gain, (repeats, *shape))
        counts = (charge + READ_E * rng.standard_normal(charge.shape)) / GAIN_E_PER_DN + bias
        return np.clip(np.rint(counts), 0, SATURATION).astype(np.uint16)

    return stack(0.0), [stack(level) for level in levels]


def figures(dark, bright, flatten=False):
    return transfer(
        frame_statistics(dark, SATURATION, flatten=False),
        [frame_statistics(b, SATURATION, flatten=flatten) for b in bright],
        SATURATION,
    )


def test_agrees_with_the_reference_implementation(monkeypatch):
    """One level within 70% of saturation and one beyond: both programs then use the same numbers."""
    emva = pytest.importorskip("emva1288", reason="needs the package emva1288 (extra 'dev')")
    from emva1288.process.data import Data1288
    from emva1288.process.results import Results1288
    from emva1288.process.routines import get_int_imgs

    assert emva
    # the package was written for NumPy 1
    monkeypatch.setattr(np, "asfarray", lambda values: np.asarray(values, float), raising=False)
    dark, bright = sensor(np.random.default_rng(1), levels=(1200.0, 3400.0))

    def temporal(stack):
        images = get_int_imgs(stack)
        return {
            "sum": np.sum(images["sum"]),
            "pvar": np.sum(images["pvar"]),
            "dmean": images["dmean"],
        }

    steps = {0.0: temporal(dark), 1200.0: temporal(bright[0]), 3400.0: temporal(bright[1])}
    spatial = {0.0: get_int_imgs(dark), 1200.0: get_int_imgs(bright[0])}
    data = {"width": 64, "height": 48, "temporal": {0.01: steps}, "spatial": {0.01: spatial}}
    theirs = Results1288(Data1288(data, loglevel=logging.ERROR).data, index_u_ysat=1, loglevel=logging.ERROR)
    ours = figures(dark, bright)
    assert ours.gain_dn_per_e == pytest.approx(theirs.K, rel=1e-6)
    assert ours.dark_noise_e == pytest.approx(theirs.sigma_d, rel=1e-6)
    # they leave the difference between the frames' own means in the stack's variance
    assert ours.dsnu_e == pytest.approx(theirs.DSNU1288, rel=1e-3)
    assert 100 * ours.prnu == pytest.approx(theirs.PRNU1288, rel=1e-3)


TRUTH = {
    "gain_dn_per_e": ("gain_sigma", 1 / GAIN_E_PER_DN),
    "dark_noise_e": ("dark_noise_sigma", READ_E),
    "dsnu_e": ("dsnu_sigma", DSNU_DN * GAIN_E_PER_DN),
    "prnu": ("prnu_sigma", PRNU),
}


@pytest.fixture(scope="module")
def ensemble():
    rng = np.random.default_rng(7)
    return [figures(*sensor(rng, shape=(20, 24)), flatten=True) for _ in range(600)]


@pytest.mark.parametrize("name", TRUTH)
def test_intervals_cover_the_truth_as_often_as_stated(ensemble, name):
    """600 simulated sensors: one and two sigma hold the truth in 68.3% and 95.4% of them.

    Binomial standard errors 1.9% and 0.9%; limits at 4 of them, and 2% more for the normal approximation of
    chi-square distributed variances with 479 degrees of freedom.
    """
    sigma, truth = TRUTH[name]
    pulls = np.array([(getattr(f, name) - truth) / getattr(f, sigma) for f in ensemble])
    pulls = pulls[np.isfinite(pulls)]
    assert pulls.size > 590
    for limit in (1, 2):
        expected = stats.norm.cdf(limit) - stats.norm.cdf(-limit)
        error = np.sqrt(expected * (1 - expected) / pulls.size)
        assert abs(np.mean(np.abs(pulls) < limit) - expected) < 4 * error + 0.02


def test_saturation_is_where_the_variance_turns():
    """A full well of 30,000 e- (2500 DN) below the converter's limit: excess charge is lost."""
    rng = np.random.default_rng(3)
    stacks = []
    for level in (500, 1000, 1500, 2000, 2400, 2450, 2600, 3000):
        charge = np.minimum(rng.poisson(12.0 * level, (2, 40, 40)), 30000)
        counts = (charge + READ_E * rng.standard_normal(charge.shape)) / GAIN_E_PER_DN + BIAS
        stacks.append(np.rint(counts).astype(np.uint16))
    result = figures(sensor(rng, (40, 40))[0], stacks)
    assert result.saturation_e == pytest.approx(2400 * 12, rel=0.03)
    assert result.gain_dn_per_e == pytest.approx(1 / 12, abs=4 * result.gain_sigma)
    assert result.converter_limit_e == pytest.approx((SATURATION - BIAS) * 12, rel=0.02)


def test_a_flats_own_slope_is_no_pattern():
    """Cosine-fourth fall-off of 20% at the corner leaves the PRNU where it is."""
    rng = np.random.default_rng(5)
    v, u = np.indices((60, 80))
    field = 1 - 0.2 * ((u - 39.5) ** 2 + (v - 29.5) ** 2) / 2400
    gain = field * (1 + PRNU * rng.standard_normal(field.shape))
    dark, _ = sensor(rng, field.shape)
    bright = np.rint(rng.poisson(12 * 1500 * gain, (2, *field.shape)) / 12 + BIAS).astype(np.uint16)
    result = figures(dark, [bright], flatten=True)
    assert result.prnu == pytest.approx(PRNU, abs=4 * result.prnu_sigma)
    assert result.prnu_sigma < 0.05 * PRNU


def test_the_pattern_is_relative_to_the_local_light():
    """Light that falls to a tenth across the field: relative to its mean the pattern would look 10% larger."""
    rng = np.random.default_rng(6)
    field = np.broadcast_to(np.linspace(0.1, 1.0, 80), (60, 80))
    gain = field * (1 + PRNU * rng.standard_normal(field.shape))
    dark, _ = sensor(rng, field.shape)
    bright = np.rint(rng.poisson(12 * 3000 * gain, (8, *field.shape)) / 12 + BIAS).astype(np.uint16)
    result = figures(dark, [bright], flatten=True)
    assert result.prnu == pytest.approx(PRNU, rel=0.05)


def test_the_gains_error_holds_that_of_the_dark():
    """Twelve dim levels share one dark: its error is theirs in common, and most of the gain's."""
    rng = np.random.default_rng(8)
    charge, gain, floor, sigma = np.linspace(900, 1100, 12), 0.08, 9.0, 2.0

    def statistics(mean, temporal):
        return FrameStatistics(mean, temporal + sigma * rng.standard_normal(), sigma, 1.0, 0.1, 0.0)

    pulls = []
    for _ in range(1000):
        levels = [statistics(BIAS + x, floor + gain * x) for x in charge]
        result = transfer(statistics(BIAS, floor), levels, SATURATION)
        pulls.append((result.gain_dn_per_e - gain) / result.gain_sigma)
    # a standard deviation from 1000 samples has a standard error of 2.2%
    assert np.std(pulls) == pytest.approx(1.0, abs=0.1)


def test_one_repeat_shows_no_temporal_noise():
    with pytest.raises(ValueError, match="two repeats"):
        frame_statistics(np.zeros((1, 4, 4), np.uint16), SATURATION, flatten=False)


def test_levels_that_scatter_are_no_saturation():
    """Seven flats of nearly the same level, as a capture has them, at 55% of full scale."""
    dark, bright = sensor(np.random.default_rng(9), (30, 40), levels=np.linspace(2030, 2210, 7))
    result = figures(dark, bright)
    assert result.saturation_e is None
    assert result.gain_dn_per_e == pytest.approx(1 / 12, abs=4 * result.gain_sigma)


def test_relative_errors_of_a_quotient_add_in_quadrature():
    """Read noise and dark pattern are roots over the gain: half the variance's own relative error, and the gain's."""
    for dark_sigma, bright_sigma in ((1e-6, 4.0), (0.9, 1e-6), (0.9, 4.0)):
        dark = FrameStatistics(BIAS, 9.0, dark_sigma, 0.5, 0.1 * dark_sigma, 0.0)
        bright = FrameStatistics(BIAS + 1000, 9.0 + 80.0, bright_sigma, 101.0, 0.2, 0.0)
        result = transfer(dark, [bright], SATURATION)
        gain_sigma = np.hypot(bright_sigma, dark_sigma) / 1000
        assert (result.gain_dn_per_e, result.gain_sigma) == pytest.approx((0.08, gain_sigma), rel=1e-6)
        read = 9.0 - 1 / 12
        for value, sigma, part in (
            (result.dark_noise_e, result.dark_noise_sigma, dark_sigma / (2 * read)),
            (result.dsnu_e, result.dsnu_sigma, 0.1 * dark_sigma / (2 * 0.5)),
        ):
            assert sigma / value == pytest.approx(np.hypot(part, gain_sigma / 0.08), rel=1e-6)
        # the pattern of the light: 100.5 DN^2 of 1000 DN
        prnu_sigma = np.hypot(0.2, 0.1 * dark_sigma) / (2 * 100.5)
        assert result.prnu == pytest.approx(np.sqrt(100.5) / 1000, rel=1e-9)
        assert result.prnu_sigma / result.prnu == pytest.approx(prnu_sigma, rel=1e-6)
