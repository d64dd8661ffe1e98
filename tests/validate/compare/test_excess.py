"""Excess chi2 by region: sums of squares by hand, and shares that add up."""

import numpy as np
import pytest
from cboxlab.validation.compare.comparison import Expectation
from cboxlab.validation.compare.excess import regions_of
from helpers.fakes.box import BANDS, SURFACES, FakeBox

BOX = FakeBox()


def test_every_region_has_its_own_squares_and_its_part_of_the_freedom():
    """A floor 2 % too bright and 600 numbers fitted: each residual counts for as much freedom as any other."""
    factor = np.ones(BOX.truth.shape)
    factor[:, BOX.surface == SURFACES.index("floor")] = 1.02
    c = BOX.compare(seed=3, factor=factor, expectation=Expectation(600))
    residual = c.maps["residual_over_sigma"].values
    used = np.isfinite(residual)
    each = 1 - 600 / used.sum()
    excess = float(np.nansum(residual**2)) - used.sum() * each
    regions = regions_of(c)
    for rows in regions.values():
        assert sum(row.share_of_excess for row in rows) == pytest.approx(1)
        assert sum(row.share_of_residuals for row in rows) == pytest.approx(1)
        assert sum(row.chi2.count for row in rows) == used.sum()
    wheres = {name: BOX.surface == i for i, name in enumerate(SURFACES)}
    for row in regions["surface"][: len(SURFACES)]:
        in_region = residual[:, wheres[row.name]]
        count, value = np.isfinite(in_region).sum(), float(np.nansum(in_region**2))
        assert (row.chi2.count, row.chi2.value, row.chi2.dof) == pytest.approx((count, value, count * each))
        assert row.share_of_excess == pytest.approx((value - count * each) / excess)
        assert row.share_of_residuals == pytest.approx(count / used.sum())
    for band, row in zip(residual, regions["band"], strict=True):
        assert row.chi2.value == pytest.approx(np.nansum(band**2))
    assert [row.name for row in regions["band"]] == list(BANDS)
    most = max(regions["surface"], key=lambda row: row.share_of_excess)
    assert most.name == "floor" and most.share_of_excess > 0.9


def test_where_noise_explains_all_there_is_no_share():
    regions = regions_of(BOX.compare(seed=1))
    assert all(np.isnan(row.share_of_excess) for rows in regions.values() for row in rows)
