"""Outliers, typical noise and smooth descriptions, each on numbers made up."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress import naming, verdict
from cboxlab.validation.compare_renders.regress.outliers import trimmed


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("sigmas", "is_outlier"), [(5.0, False), (7.5, True)])
def test_an_outlier_is_six_stated_sigmas_away_in_any_unit(unit, sigmas, is_outlier):
    """Stated errors of twice the scatter, for wavelengths that err alike."""
    scatter = np.random.default_rng(3).standard_normal((32, 32, 1))
    scatter = np.clip(scatter, -2, 2) * 0.01 * unit * np.ones(3)
    scatter[16, 16] = sigmas * 0.02 * unit
    level = np.full((32, 32, 3), unit)
    variance = np.full((32, 32, 3), (0.02 * unit) ** 2)
    outlier = trimmed(scatter, level, variance, 1e6, np.zeros((32, 32), bool)).outlier
    assert outlier[16, 16] == is_outlier
    assert outlier.sum() == is_outlier


def test_typical_noise_is_a_standard_deviation_over_the_light(monkeypatch):
    monkeypatch.setattr(verdict, "_quiet", lambda strata, estimated: np.ones((2, 2), bool))
    level = np.full((2, 2, 3), 4.0)
    noise = SimpleNamespace(total=np.full((2, 2), 0.36))
    comparison = SimpleNamespace(strata=None, trimmed=SimpleNamespace(level=level), noise=noise)
    assert verdict._typical_noise(comparison) == pytest.approx(0.6 / 12)


def test_smooth_descriptions_are_polynomials_up_to_the_second_order():
    """Each of them over a picture of ones is in the span of the templates."""
    descriptions = []
    evidence = SimpleNamespace(baseline=np.ones((5, 6, 2)), fit=descriptions.append)
    free = [explanation.free for explanation in naming._over_picture(evidence)]
    y, x = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 6), indexing="ij")
    expected = [[x, y], [x * x + y * y], [x, y, x * x, x * y, y * y]]
    assert free == [len(shapes) + 1 for shapes in expected]
    for templates, shapes in zip(descriptions, expected, strict=True):
        columns = np.array([template[..., 0].ravel() for template in templates]).T
        for shape in (np.ones_like(x), *shapes):
            remainder = shape.ravel() - columns @ np.linalg.lstsq(columns, shape.ravel(), rcond=None)[0]
            assert np.abs(remainder).max() < 1e-9


def test_what_is_set_aside_is_what_an_outlier_had_beyond_its_neighbours():
    rng = np.random.default_rng(2)
    level, variance = np.full((16, 16, 3), 5.0), np.full((16, 16, 3), 0.01)
    difference = rng.normal(0, 0.1, level.shape)
    difference[8, 8] += 40.0
    result = trimmed(difference, level, variance, 1e6, np.zeros((16, 16), bool))
    assert np.argwhere(result.outlier).tolist() == [[8, 8]]
    np.testing.assert_allclose(result.difference.sum(axis=-1) + result.excess, difference.sum(axis=-1))
    assert result.excess[8, 8] == pytest.approx(120.0, abs=1.0) and np.count_nonzero(result.excess) == 1


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_an_outlier_of_a_dim_band_is_judged_by_that_bands_light(unit):
    """One band has a hundredth of the other's light: half of it is nothing in the sum of both."""
    light = unit * np.array([1.0, 0.01])
    difference = np.clip(np.random.default_rng(5).standard_normal((32, 32, 2)), -2, 2) * 0.01 * light
    difference[9, 20, 1] = 0.5 * light[1]
    variance = np.broadcast_to((0.01 * light) ** 2, difference.shape)
    result = trimmed(difference, light * np.ones_like(difference), variance, 1e6, np.zeros((32, 32), bool))
    assert np.argwhere(result.outlier).tolist() == [[9, 20]]


def test_the_relative_difference_is_over_the_baselines_light():
    baseline, candidate = np.array([[[4.0, 4.0], [0.0, 0.0]]]), np.array([[[1.0, 3.0], [1.0, 0.0]]])
    common = SimpleNamespace(baseline=SimpleNamespace(radiance=baseline), candidate=SimpleNamespace(radiance=candidate))
    np.testing.assert_array_equal(verdict._relative(SimpleNamespace(common=common)), [[-0.5, np.nan]])
