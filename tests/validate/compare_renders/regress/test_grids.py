"""Pictures at other wavelengths: what is interpolated, how far that may be off; the map of what differs."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.grids import common_wavelengths
from cboxlab.validation.compare_renders.regress.sides import Side
from cboxlab.validation.compare_renders.regress.verdict import _relative


def side(wavelength_nm, radiance, variance=None):
    values = np.broadcast_to(radiance, (2, 3, len(wavelength_nm))).astype(float).copy()
    return Side("a.nc", np.array(wavelength_nm, float), values, variance, 7.0, None)


@pytest.mark.parametrize("curvature", [0.0, 0.4])
def test_the_error_of_interpolated_ratios_is_what_lines_miss_of_a_curve(curvature):
    """A ratio of 2 + c x^2 at x = 0, 1, 2, 3: half way a line is above it by c / 4."""
    baseline_nm, nm = np.array([450.0, 550.0, 650.0]), np.array([400.0, 500.0, 600.0, 700.0])
    baseline = side(baseline_nm, [1.0, 2.0, 3.0])
    ratio = 2 + curvature * np.arange(4.0) ** 2
    light = ratio * (nm - 350) / 100  # the baseline's line goes on beyond its ends
    common = common_wavelengths(side(nm, light, np.full((2, 3, 4), 0.01) * ((nm - 350) / 100) ** 2), baseline)
    true = 2 + curvature * np.array([0.5, 1.5, 2.5]) ** 2
    np.testing.assert_allclose(common.interpolation, curvature / 4 / true + 1e-3, rtol=1e-9)
    np.testing.assert_allclose(common.candidate.radiance[0, 0], (true + curvature / 4) * np.array([1, 2, 3]))
    # half of either neighbour: half the variance of one, relative to the baseline's light
    np.testing.assert_allclose(common.candidate.variance[0, 0], 0.01 / 2 * np.array([1, 4, 9]))


def test_the_map_of_differences_is_relative_to_the_sum_of_the_baseline():
    """Of all wavelengths together, where the baseline has light."""
    baseline, candidate = (side([450.0, 550.0], spectrum) for spectrum in ([1.0, 3.0], [2.0, 3.0]))
    baseline.radiance[1, 2] = 0.0
    relative = _relative(SimpleNamespace(common=SimpleNamespace(candidate=candidate, baseline=baseline)))
    assert relative[0] == pytest.approx(0.25) and np.isnan(relative[1, 2])
