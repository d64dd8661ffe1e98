"""Chi-square over one number, and the pattern of a number, against changes in closed form."""

import numpy as np
import pytest
from cboxlab.rendering.effects import Parameter
from cboxlab.utils.progress import Cancelled, ProgressReporter
from cboxlab.validation.study import chi2_profile, pattern_of

FRACTION = Parameter("fraction", null=0.0, low=0.0, high=0.5, step=1e-3)
INDEX = Parameter("index", null=float("inf"), low=1.05, scale="inverse square", step=1e-3)


def test_a_profile_reaches_from_null_to_beyond_the_present_value():
    curve = chi2_profile("glare", FRACTION, 0.02, None, lambda v: (1 + ((v - 0.013) / 0.01) ** 2, 2.0))
    assert curve.values[0] == 0.0 and curve.values[-1] == pytest.approx(0.045) and 0.02 in curve.values
    assert np.all(np.diff(curve.values) > 0)
    np.testing.assert_allclose(curve.chi2_per_dof[0], 1 + ((curve.values - 0.013) / 0.01) ** 2)
    np.testing.assert_array_equal(curve.chi2_per_dof[1], 2.0)
    assert curve.best() == pytest.approx(0.013, abs=0.5 * np.diff(curve.values).max())


def test_a_fitted_value_has_further_values_within_four_standard_deviations():
    curve = chi2_profile("glare", FRACTION, 0.02, 1e-4, lambda v: (v,))
    near = curve.values[np.abs(curve.values - 0.02) < 4.1e-4]
    assert len(near) == 9 and near[0] == pytest.approx(0.0196) and near[-1] == pytest.approx(0.0204)


def test_a_number_whose_null_is_infinite_is_followed_in_its_coordinate():
    curve = chi2_profile("shift", INDEX, 2.0, None, lambda v: (0.0 if np.isinf(v) else v**-2,))
    assert np.isinf(curve.values[0]) and 2.0 in curve.values and curve.values.min() >= 1.05
    assert np.all(np.diff(curve.chi2_per_dof[0]) > 0)  # even in the coordinate


def test_a_profile_stops_when_it_is_cancelled():
    progress = ProgressReporter()

    def cancelling(value):
        progress.cancel()
        return (value,)

    with pytest.raises(Cancelled):
        chi2_profile("glare", FRACTION, 0.02, None, cancelling, progress)


def test_a_pattern_is_shown_where_its_hundredth_changes_by_three_sigma():
    shape = np.linspace(-1, 1, 1000).reshape(1, 20, 50)
    pattern = pattern_of(FRACTION, lambda v: 400 * v * shape)
    assert np.percentile(np.abs(pattern.change_sigma), 99) == pytest.approx(3.0)
    np.testing.assert_allclose(pattern.change_sigma, 400 * pattern.value * shape)


@pytest.mark.parametrize("power", [1, 2, 3])
def test_a_pattern_is_as_strong_whatever_the_power_of_its_number(power):
    """Blur grows with the square of its width: the value is that of three standard deviations all the same."""
    shape = np.linspace(0, 1, 700).reshape(7, 10, 10)
    pattern = pattern_of(FRACTION, lambda v: 40 * (v / 0.01) ** power * shape)
    assert np.percentile(np.abs(pattern.change_sigma), 99) == pytest.approx(3.0, rel=0.2)
    assert pattern.value == pytest.approx(0.01 * (3 / 40 / np.percentile(shape, 99)) ** (1 / power), rel=0.2)


def test_a_pattern_of_nothing_and_one_without_null_value():
    assert not pattern_of(FRACTION, lambda v: np.zeros((1, 2, 2))).change_sigma.any()
    bounces = Parameter("bounces", low=0.0, starts=(np.inf,), example=1.0)
    assert pattern_of(bounces, lambda v: np.full((1, 2, 2), v)).value == 1.0
