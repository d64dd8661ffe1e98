"""Two stacks of planes whose errors are estimated from few batches each."""

from pathlib import Path

import numpy as np
import pytest
from cboxlab.validate.compare.stacks import Stack, compare_stacks

SHAPE = (3, 100, 100)


def estimated(seed, batches, level=10.0):
    """The mean of a few noisy pictures, and the variance of the mean from their scatter."""
    pictures = level + np.random.default_rng(seed).standard_normal((batches, *SHAPE))
    variance = pictures.var(axis=0, ddof=1) / batches
    return Stack(Path(f"{seed}"), ("a", "b", "c"), pictures.mean(axis=0), variance, "DN", batches)


@pytest.mark.parametrize("batches", [3, 5, 9])
def test_chi2_of_noise_is_that_expected_of_few_batches(batches):
    """A square over an estimated variance has the mean n / (n - 2) of F with 1 and n = 2 (batches - 1) degrees.

    30,000 pixels of n >= 4: within 12 % for 4, whose variance is infinite, and within 5 % for the others.
    """
    found = compare_stacks(estimated(1, batches), estimated(2, batches))
    degrees = 2 * (batches - 1)
    assert found.expected_chi2 == pytest.approx(degrees / (degrees - 2))
    mean = np.mean([row.chi2_per_pixel for row in found.rows])
    assert mean == pytest.approx(found.expected_chi2, rel=0.12 if degrees == 4 else 0.05)


def test_the_rows_are_means_and_squares_by_hand():
    a, b = estimated(3, 8, level=10.2), estimated(4, 8)
    found = compare_stacks(a, b)
    for plane, row in enumerate(found.rows):
        difference = a.values[plane] - b.values[plane]
        assert row.mean_first == pytest.approx(a.values[plane].mean())
        assert row.relative_mean == pytest.approx(difference.sum() / b.values[plane].sum())
        chi2 = np.mean(difference**2 / (a.variance[plane] + b.variance[plane]))
        assert row.chi2_per_pixel == pytest.approx(chi2)
