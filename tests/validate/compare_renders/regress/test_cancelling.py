"""Patterns whose means cancel: seen, described, hiding nothing else, and never in equal pictures."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress import UNKNOWN, Outcome, regress_pictures, regress_sides
from cboxlab.validation.compare_renders.regress.patterns import Difference, Finding, pool_of_finding, textures
from pictures import SIZE, noisy, rendered
from scipy.ndimage import gaussian_filter, median_filter
from scipy.stats import norm

ROWS, COLUMNS = np.indices((SIZE, SIZE))


def checkerboard(edge_px, contrast):
    return 1 + contrast * np.where((ROWS // edge_px + COLUMNS // edge_px) % 2, 1, -1)


def texture(contrast):
    return 1 + contrast * np.random.default_rng(9).standard_normal((SIZE, SIZE))


def black():
    factor = np.ones((SIZE, SIZE))
    factor[30, 20] = factor[28, 22] = 0
    return factor


PATTERNS = {
    "checkerboard of 1 px": checkerboard(1, 0.05),
    "checkerboard of 2 px": checkerboard(2, 0.1),
    "checkerboard of 4 px": checkerboard(4, 0.2),
    "columns with a period of 2 px": 1 + 0.05 * np.where(COLUMNS % 2, 1, -1),
    "rows with a period of 4 px": 1 + 0.1 * np.where(ROWS % 4 < 2, 1, -1),
    "2 black pixels of the candidate": black(),
}


@pytest.mark.parametrize("with_errors", [True, False], ids=["stated errors", "single pictures"])
@pytest.mark.parametrize("name", PATTERNS)
def test_a_pattern_is_described(name, with_errors):
    candidate = noisy(2, rendered()[0] * PATTERNS[name][..., None], with_errors=with_errors)
    outcome = regress_pictures(noisy(1, with_errors=with_errors), candidate)
    assert not outcome.same
    assert outcome.cancelling.startswith(name)
    assert outcome.to_dict()["cancelling"] == outcome.cancelling
    assert outcome.changes[0].change == UNKNOWN
    assert name in outcome.changes[0].parameters["description"]


def test_a_pattern_of_the_baseline_is_seen_too():
    outcome, _ = regress_sides(noisy(1, rendered()[0] * checkerboard(2, 0.3)[..., None]), noisy(2))
    assert outcome.cancelling.startswith("checkerboard of 2 px")


def test_a_fixed_texture_is_seen_by_stated_errors():
    """Twice the noise; without errors it looks like noise."""
    spoilt = rendered()[0] * texture(0.1)[..., None]
    outcome = regress_sides(noisy(1), noisy(2, spoilt))[0]
    assert "texture" in {row.kind for row in outcome.deciding}
    assert regress_sides(noisy(1, with_errors=False), noisy(2, spoilt, with_errors=False))[0].same


def test_a_pattern_hides_no_change_of_the_mean():
    """1.2 % more light beneath a checkerboard of 30 %, within four standard deviations of 0.2 %."""
    spoilt = 1.012 * rendered()[0] * checkerboard(2, 0.3)[..., None]
    outcome, names = regress_sides(noisy(1), noisy(2, spoilt))
    assert names.removed == "checkerboard of 2 px"
    assert outcome.picture_mean.different
    assert outcome.picture_mean.difference == pytest.approx(0.012, abs=4 * outcome.picture_mean.sigma)


def filtered(seed, by):
    """A single picture through a filter; its lamp is quiet, as lamps are."""
    clean, surfaces = rendered()
    side = noisy(seed, with_errors=False)
    radiance = np.where(surfaces.lamp[..., None], clean, np.maximum(side.radiance, 0))
    return replace(side, radiance=by(radiance))


@pytest.mark.parametrize(
    "by",
    [
        lambda p: gaussian_filter(p, (0.5, 0.5, 0)),
        lambda p: gaussian_filter(p, (2, 2, 0)),
        lambda p: median_filter(p, (3, 3, 1)),
    ],
    ids=["pixel filter", "wide filter", "median"],
)
def test_equal_pictures_through_a_filter_are_the_same(by):
    """Their noise is correlated over several pixels."""
    assert all(regress_sides(filtered(2 * s, by), filtered(2 * s + 1, by))[0].same for s in range(4))


@pytest.mark.parametrize(("factor", "is_found"), [(0.3, False), (1.0, True)])
def test_structure_that_a_factor_carries_is_no_texture(factor, is_found):
    """The picture itself has grains of 6 %: a factor of 0.3 shows them in the difference, new grains do not pass."""
    random = np.random.default_rng(8)
    smooth = 10 + np.add.outer(np.linspace(0, 2, 48), np.linspace(0, 1, 48))
    level = smooth * (1 + 0.06 * random.standard_normal(smooth.shape))
    grains = 0.1 * smooth * random.standard_normal(smooth.shape) if is_found else 0.0
    sigma = 0.01 * smooth
    total = (factor - 1) * level + grains + sigma * random.standard_normal(smooth.shape)
    (finding,) = textures(Difference(level, total, sigma**2, np.ones(smooth.shape, bool), {"smooth parts": level > 0}))
    assert (finding.probability < 1e-3) == is_found


def test_pixels_that_a_filter_makes_one_count_once():
    """Each pixel four times, where four are said to be one: as sure as the picture of single ones."""
    excess = 0.1 * np.random.default_rng(4).standard_normal((16, 16))

    def probability(picture, alike):
        level = np.ones(picture.shape)
        groups = {"edges": np.ones(picture.shape, bool)}
        (finding,) = textures(Difference(level, picture, 0.003 * level, ~groups["edges"], groups, alike))
        return finding.probability

    single = probability(excess, 1.0)
    assert 1e-12 < single < 1e-4
    assert probability(np.kron(excess, np.ones((2, 2))), 4.0) == pytest.approx(single, rel=1e-6)


def test_nine_of_ten_patterns_of_the_stated_size_are_seen():
    """By the probability of normal noise, two-sided, beyond the size that decides."""
    finding = Finding("waves", 100, 0.02, 0.003, 1e6, 0.5)
    pool = pool_of_finding("waves", finding, 0.01)
    smallest = norm.isf(0.01 / 2) * 0.003
    assert norm.sf(smallest, pool.detectable, 0.003) == pytest.approx(0.9, abs=1e-4)


@pytest.mark.parametrize(("kind", "is_stated"), [("filter", True), ("whole", False), ("fixed", False)])
def test_repeated_noise_is_stated_where_nothing_differs_that_noise_leaves_alone(kind, is_stated):
    rows = [pool_of_finding(k, Finding(k, 100, 0.1, 0.01, 50.0, 1e-9), 1e-6) for k in ("reused", kind)]
    outcome = Outcome("a", "b", tuple(rows), 1e-3, 0, 0.0, 0, np.zeros((2, 2)))
    assert (outcome.cancelling == "reused, 0.1 of its fine structure's variance") == is_stated
