"""Mirrored pictures by the sign of what is not symmetric."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.patterns import mirror_order
from scipy.ndimage import gaussian_filter

RNG_SEED = 5


def scene(asymmetry):
    y, x = np.mgrid[-1:1:48j, -1:1:40j]
    return (1 + asymmetry * x + 0.7 * asymmetry * y)[..., None] * [1.0, 0.8, 0.6]


def noisy(picture, sigma, rng, blur=0.0):
    noise = gaussian_filter(rng.standard_normal(picture.shape), (blur, blur, 0))
    return picture * (1 + sigma * noise / noise.std())


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda p: p[:, ::-1], "mirrored left to right"),
        (lambda p: p[::-1], "upside down"),
        (lambda p: p[::-1, ::-1], "turned by half a turn"),
    ],
)
def test_an_exchange_is_seen_and_named_without_any_variance(change, name):
    rng = np.random.default_rng(RNG_SEED)
    baseline, candidate = noisy(scene(0.3), 0.3, rng), change(noisy(scene(0.3), 0.3, rng))
    finding = mirror_order(baseline, candidate - baseline)
    assert finding.name == name and finding.probability < 1e-6


@pytest.mark.parametrize("asymmetry", [0.0, 0.3])
@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_equal_pictures_alarm_no_more_often_than_stated(asymmetry, blur):
    rng = np.random.default_rng(RNG_SEED)
    sides = ((noisy(scene(asymmetry), 0.2, rng, blur), noisy(scene(asymmetry), 0.2, rng, blur)) for _ in range(400))
    probabilities = np.array([mirror_order(a, b - a).probability for a, b in sides])
    for level in (0.01, 0.05):  # at most three standard errors above the stated rate
        assert np.mean(probabilities < level) < level + 3 * np.sqrt(level / 400)


def test_small_pictures_have_no_test():
    assert mirror_order(np.ones((15, 40, 3)), np.ones((15, 40, 3))) is None
