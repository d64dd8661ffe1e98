"""Variances of few batches: squared errors over them are 1 on average, inside surfaces and at edges."""

import numpy as np
import pytest
from cboxlab.validation.predict.few_batches import MANY_BATCHES, pooled_variance

SIZE, WAVELENGTHS = 64, 3


def picture(batches, seed):
    """Mean, its variance, and its error; edges are noisier, in proportion to their step."""
    rng = np.random.default_rng(seed)
    level = np.where(np.arange(SIZE) < SIZE // 2, 1.0, 3.0)[None, :, None] * np.ones((SIZE, SIZE, WAVELENGTHS))
    edges = np.zeros((SIZE, SIZE), bool)
    edges[:, SIZE // 2 - 1 : SIZE // 2 + 1] = True
    sigma = np.where(edges[..., None], 0.2, 0.05 * level)
    values = level + sigma * np.sqrt(batches) * rng.standard_normal((batches, SIZE, SIZE, 1))
    return values.mean(axis=0), values.var(axis=0, ddof=1) / batches, edges, values.mean(axis=0) - level


@pytest.mark.parametrize("batches", [2, 4, 8])
def test_squared_errors_over_the_variance_are_one(batches):
    """Within a quarter, where the pixels' own variances give 3 for four batches and no mean at all for two."""
    for part in ("edges", "inside"):
        ratios = []
        for seed in range(6):
            mean, variance, edges, error = picture(batches, seed)
            used = edges if part == "edges" else ~edges
            ratios.append((error**2 / pooled_variance(mean, variance, edges, batches))[used].mean())
        assert np.mean(ratios) == pytest.approx(1, abs=0.25)


def test_many_batches_are_left_as_they_are():
    mean, variance, edges, _ = picture(MANY_BATCHES, 1)
    assert pooled_variance(mean, variance, edges, MANY_BATCHES) is variance
