"""Blocks by their scatter between independent cubes, on numbers drawn at random."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.patterns import (
    Difference,
    block_changes,
    fixed_lines,
    fixed_pixels,
    ranked_squares,
)
from scipy.ndimage import gaussian_filter

BLOCK = np.add.outer(np.arange(32) // 4 * 8, np.arange(32) // 4)


def cubes(rng, mean, noise, count=4):
    return mean * (1 + noise * rng.standard_normal((count, *mean.shape)))


def probabilities(first, second):
    return np.array([finding.probability for finding in block_changes(first, second, BLOCK, 0.0)])


@pytest.mark.parametrize("unlike", [0.0, 1.0])
def test_probabilities_of_equal_pictures_are_uniform(unlike):
    """200 pairs of 64 blocks; the count below 1 % is binomial, below its mean plus five standard deviations (3e-7).

    unlike : scatter of the logarithm of the blocks' noise. A block's own variance holds where it is larger, so that
    fewer fall below than stated.
    """
    rng = np.random.default_rng(7)
    below = 0
    for _ in range(200):
        noise = 0.1 * np.exp(unlike * rng.standard_normal(64))[BLOCK][..., None]
        below += int((probabilities(*(cubes(rng, np.ones((32, 32, 2)), noise) for _ in range(2))) < 0.01).sum())
    assert below < 128 + 5 * 128**0.5
    assert below > 20


def test_a_change_of_few_pixels_in_all_cubes_counts_and_a_firefly_does_not():
    rng = np.random.default_rng(3)
    first, second = (cubes(rng, np.ones((32, 32, 2)), 0.02) for _ in range(2))
    changed, firefly = second.copy(), second.copy()
    changed[:, 9, 9] += 1.0
    firefly[2, 9, 9] += 40.0
    (clearest,) = [finding for finding in block_changes(first, changed, BLOCK, 0.0) if finding.probability < 1e-6]
    assert clearest.name == "row 3, column 3, between cubes"
    assert clearest.size == pytest.approx(1 / 16, abs=0.005)
    assert probabilities(first, firefly).min() > 1e-4
    assert block_changes(first[:1], changed, BLOCK, 0.0) == ()


def test_the_stated_error_is_the_scatter_of_repeated_pairs():
    rng = np.random.default_rng(5)
    pairs = [block_changes(*(cubes(rng, np.ones((32, 32, 2)), 0.1) for _ in range(2)), BLOCK, 0.0) for _ in range(60)]
    sizes = np.array([[finding.size for finding in pair] for pair in pairs])
    sigma = np.mean([[finding.sigma for finding in pair] for pair in pairs])
    # 3,840 sizes fix a standard deviation to 1.1 %; the larger of two variances adds up to 15 %
    assert sizes.std() == pytest.approx(0.1 / np.sqrt(16 * 2) / np.sqrt(2), rel=0.06)
    assert 0.97 < sigma / sizes.std() < 1.2


def test_equal_noise_and_a_floor_bound_the_errors_from_below():
    """By six degrees of freedom alone the error of one block in ten is below 0.6 of the true one."""
    first, second = (cubes(np.random.default_rng(seed), np.ones((32, 32, 2)), 0.1) for seed in (1, 2))
    true = 0.1 / np.sqrt(16 * 2) / np.sqrt(2)
    sigmas = [finding.sigma for finding in block_changes(first, second, BLOCK, 0.0)]
    assert min(sigmas) > 0.85 * true
    with_floor = [finding.sigma for finding in block_changes(first, second, BLOCK, 0.05)]
    np.testing.assert_allclose(np.square(with_floor), np.square(sigmas) + 0.05**2)


def skewed(rng, mean, shape, count=3):
    """Cubes of gamma-distributed noise, 1 / sqrt(shape) of the light: many dark pixels, few very bright ones."""
    return mean * rng.gamma(shape, 1 / shape, (count, *mean.shape))


def test_ranks_of_equal_skewed_cubes_are_below_a_tenth_in_a_tenth_of_the_pairs():
    """30 pairs, of one to 16 times the samples of others: more than 9 have a probability of 0.2 %.

    A third of them have 3 cubes against 4.
    """
    rng, light = np.random.default_rng(4), np.ones((36, 36))
    counts = (3, 3), (4, 4), (3, 4)
    pairs = [[skewed(rng, light, 4.0 ** (n % 4 - 1.5), k) for k in counts[n % 3]] for n in range(30)]
    assert sum(ranked_squares(*pair).probability < 0.1 for pair in pairs) <= 9


def test_ranks_see_a_square_among_fireflies_that_means_do_not():
    rng, light = np.random.default_rng(6), np.full((40, 40), 2.0)
    changed = light.copy()
    changed[20:27, 9:16] *= 3
    first, second = skewed(rng, light, 4.0), skewed(rng, 1.1 * changed, 4.0)
    first[0, 21, 10] += 200
    second[2, 25, 14] += 400
    block = np.add.outer(np.arange(40) // 5 * 8, np.arange(40) // 5)
    means = block_changes(first[..., None], second[..., None], block, 0.0)
    assert min(finding.probability for finding in means) > 1e-5
    finding = ranked_squares(first, second)
    left, top, right, bottom = finding.parameters["bounds_px"]
    assert finding.probability < 1e-7
    assert abs((left + right) / 2 - 12.5) < 4
    assert abs((top + bottom) / 2 - 23.5) < 4
    assert finding.size > 1
    assert ranked_squares(first[:2], second) is None


@pytest.mark.parametrize("samples", [1.5, 4.0])
def test_other_samples_of_skewed_noise_inside_a_part_change_no_light(samples):
    """Each pixel's mean is the same, its median is not."""
    for seed in range(4):
        rng, light = np.random.default_rng(seed), np.ones((40, 40))
        first, second = (skewed(rng, light, 1.0, 8) for _ in range(2))
        second[:, 5:25, 5:25] = skewed(rng, light[5:25, 5:25], samples, 8)
        assert ranked_squares(first, second).probability > 1e-3


def lines_of(first, second):
    """Finding of two sides (b, y, x) without edges."""
    level, total = first.mean(axis=0), second.mean(axis=0) - first.mean(axis=0)
    return fixed_lines(Difference(level, total, None, np.ones(level.shape, bool), {}), (second - first)[:, None])


@pytest.mark.parametrize("filtered", [0.0, 1.0])
def test_lines_of_equal_pictures_have_uniform_probabilities(filtered):
    """300 pairs of heavy tails (Student's t, 3 degrees), raw and filtered: below 5 % are 15 + 5 sigma at most."""
    rng = np.random.default_rng(11)
    noise = 0.1 * gaussian_filter(rng.standard_t(3, (300, 2, 4, 40, 48)), (0, 0, 0, filtered, filtered))
    below = sum(lines_of(1 + first, 1 + second).probability < 0.05 for first, second in noise)
    assert below < 15 + 5 * 15**0.5


@pytest.mark.parametrize(("axis", "name"), [(0, "columns"), (1, "rows")])
def test_lines_that_differ_in_all_cubes_are_a_pattern_of_their_size(axis, name):
    rng = np.random.default_rng(12)
    first, second = 1 + 0.05 * rng.standard_normal((2, 4, 64, 64))
    gains = 1 + 0.02 * np.expand_dims(rng.standard_normal(64), axis)
    finding = lines_of(first, gains * second)
    assert (finding.name, finding.probability < 1e-8) == (f"a fixed pattern of {name}", True)
    assert finding.size == pytest.approx(0.02, rel=0.3)  # 62 lines fix a scatter to 9 %
    assert lines_of(first, np.concatenate([gains * second[:1], second[1:]])).probability > 1e-3
    assert lines_of(first, (1 + 0.1 * np.linspace(-1, 1, 64)) * second).probability > 1e-3  # slow changes are no lines
    assert lines_of(first[:1], second[:1]) is None


def pixels_of(first, second):
    """Finding of two sides (n, g, y, x) without edges."""
    light = (first.mean(axis=0) + second.mean(axis=0)) / 2
    used = np.ones(light.shape[1:], bool)
    total = (second - first).mean(axis=0).sum(axis=0)
    return fixed_pixels(Difference(light.sum(axis=0), total, None, used, {"all": used}), second - first, light)


def test_pixels_of_equal_pictures_are_no_fixed_pattern():
    """21 pairs of skewed noise through a filter, one side with four times the samples: a few are below 5 %."""
    rng, shares = np.random.default_rng(21), []
    for cubes in (2, 3, 4) * 7:
        noise = rng.gamma(2.0, 0.5, (5, cubes, 3, 48, 48)) - 1
        first, second = (1 + 0.1 * gaussian_filter(n, (0, 0, 0.8, 0.8)) for n in (noise[0], noise[1:].mean(axis=0)))
        finding = pixels_of(first, second)
        shares += [] if finding is None else [finding.probability]
    assert len(shares) > 15
    assert sum(np.array(shares) < 0.05) < 1 + 5


@pytest.mark.parametrize("colours", [(1, 1, 1), (1, -1, 0)], ids=["light", "colour alone"])
def test_pixels_that_differ_in_all_cubes_are_a_pattern_of_their_size(colours):
    """A texture of 10 % in a part, below noise of 14 % in the mean of the cubes' differences."""
    rng = np.random.default_rng(22)
    first, second = 1 + 0.2 * rng.standard_normal((2, 4, 3, 48, 48))
    texture = np.zeros((48, 48))
    texture[:24, 24:] = 0.1 * rng.standard_normal((24, 24))
    added = np.array(colours)[:, None, None] * texture
    finding = pixels_of(first, second + added)
    assert finding.probability < 1e-5
    assert finding.name.endswith("x 24 to 47, y 0 to 23")
    if colours == (1, 1, 1):
        assert finding.size == pytest.approx(0.1, rel=0.3)
    assert pixels_of(first, np.concatenate([second[:1] + added, second[1:]])).probability > 1e-3  # in one cube: noise
    assert pixels_of(first[:1], second[:1]) is None
