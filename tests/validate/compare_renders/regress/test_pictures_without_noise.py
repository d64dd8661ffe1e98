"""Pictures of several cubes with a part that has no noise: a constant sky, a black border."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress import Side, regress_sides
from cboxlab.validation.compare_renders.regress.patterns import Difference, reused_numbers

SIZE, CUBES = 64, 4
LIGHT = (1 + 0.5 * np.sin(np.indices((SIZE, SIZE)) / 9).prod(axis=0))[..., None] * np.array([0.8, 1.0, 0.6])
SKY = np.hypot(*(np.indices((SIZE, SIZE)) - 30)) > 22


def side(seed, change=1.0, sky=0.0):
    """Cubes whose noise of a tenth is 0 in the sky."""
    noise = 0.1 * np.random.default_rng(seed).standard_normal((CUBES, SIZE, SIZE, 1))
    values = np.where(SKY[..., None], sky, LIGHT * change * (1 + noise))
    variance = values.var(axis=0, ddof=1) / CUBES
    colours = {"in_colour": True, "colours": ("R", "G", "B"), "batches": values}
    return Side("x", np.full(3, np.nan), values.mean(axis=0), variance, CUBES - 1.0, None, **colours)


@pytest.mark.parametrize("sky", [0.0, 0.7])
def test_pixels_without_noise_are_no_correlated_noise(sky):
    outcome, comparison = regress_sides(side(1, sky=sky), side(2, sky=sky))
    assert outcome.same and comparison.noise.clustering == 1


@pytest.mark.parametrize("sky", [0.0, 0.7])
def test_a_texture_that_changes_next_to_a_constant_sky_is_seen(sky):
    texture = 1 + 0.1 * np.random.default_rng(3).standard_normal((SIZE, SIZE, 1))
    assert not regress_sides(side(1, sky=sky), side(2, texture, sky))[0].same


def test_a_sky_of_another_brightness_is_a_difference():
    assert not regress_sides(side(1, sky=0.7), side(2, sky=0.71))[0].same


def test_rounding_of_a_black_sky_is_no_noise_that_repeats():
    """Sums of filters leave rounding where nothing has noise. Over its own scatter it is alike from row to row."""
    sunlit = np.hypot(*(np.indices((SIZE, SIZE)) - 30)) < 14
    draw = np.random.default_rng(4)
    sparse = [np.where(sunlit, draw.gamma(0.6, 1.0, sunlit.shape), 0.0) for _ in range(24)]
    pairs = zip(sparse[::2], sparse[1::2], strict=True)
    findings = [reused_numbers(Difference(before, after - before, None, sunlit, {})) for before, after in pairs]
    assert min(finding.probability for finding in findings if finding) > 1e-3
