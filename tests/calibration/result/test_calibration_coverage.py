"""Whole captures of known truth, calibrated from their files: the stated intervals hold it.

benchmarks/calibration/calibration_coverage.py does so over a thousand captures. These few catch an interval that is
plainly wrong.
"""

import numpy as np
import pytest
from oracles.calibration_coverage import LEVELS, coverage, interval, score

CAPTURES = 5


@pytest.fixture(scope="module")
def shares(tmp_path_factory):
    folder = tmp_path_factory.mktemp("coverage")
    return [score(folder / str(seed), 77_000 + seed) for seed in range(CAPTURES)]


def test_no_interval_misses_the_truth_again_and_again(shares):
    """At most half of a quantity's 95% intervals may miss in four of five captures.

    One interval per capture: chance 2e-5 for each quantity (binomial), with about 40 of them below 1e-3 in all.
    """
    often = [name for name in shares[0] if sum(s[name][1] < 0.5 for s in shares) >= 4]
    assert len(shares[0]) > 35 and not often


def test_pixels_scatter_as_stated(shares):
    """5 x 7 x 2300 signals, independent: shares within 4 binomial standard errors (false alarm 1e-4)."""
    for name in (n for n in shares[0] if n.startswith("signal of a pixel")):
        for level, (share, _) in zip(LEVELS, coverage(shares)[name], strict=True):
            assert abs(share - level) < 4 * np.sqrt(level * (1 - level) / (CAPTURES * 7 * 2200)), name


def test_students_interval_by_hand():
    """t with 6 degrees: 1.09 and 2.52 sigma for 68.27% and 95.45% (GUM, table G.2)."""
    assert interval([1.05, 1.2], [1.0, 1.0], 6) == (0.5, 1.0)
    assert interval([2.40, 2.60], [1.0, 1.0], 6) == (0.0, 0.5)
    assert interval([2.1], [1.0]) == (0.0, 0.0)
