"""Grids of wavelengths: parts of one another by place, integrals by the trapezoidal rule."""

import numpy as np
import pytest
from cboxlab.scenes.wavelength_grid import FILTER_GRID, INTEGRAL_GRID, WavelengthGrid

TENTHS = WavelengthGrid(400.0, 0.1, 3001)  # steps that no binary number holds exactly


def test_the_wavelengths_are_evenly_spaced_and_cannot_be_changed():
    np.testing.assert_array_equal(INTEGRAL_GRID.nm, np.linspace(400.0, 700.0, 301))
    np.testing.assert_array_equal(FILTER_GRID.nm, np.linspace(380.0, 800.0, 421))
    with pytest.raises(ValueError, match="read-only"):
        INTEGRAL_GRID.nm[0] = 0.0


@pytest.mark.parametrize(
    "inner",
    [
        INTEGRAL_GRID,
        FILTER_GRID.between(380.0, 730.0),
        WavelengthGrid(400.0, 10.0, 31),
        WavelengthGrid(381.0, 7.0, 2),
    ],
)
def test_a_part_is_where_the_others_wavelengths_lie(inner):
    np.testing.assert_array_equal(FILTER_GRID.nm[FILTER_GRID.part(inner)], inner.nm)


def test_a_part_is_found_where_floats_differ_in_their_last_digits():
    inner = WavelengthGrid(400.3, 0.3, 101)
    assert not np.isin(inner.nm, TENTHS.nm).all()
    np.testing.assert_allclose(TENTHS.nm[TENTHS.part(inner)], inner.nm, rtol=1e-12)
    assert inner.matches(TENTHS.nm[TENTHS.part(inner)])


@pytest.mark.parametrize(
    "inner",
    [
        WavelengthGrid(379.0, 1.0, 10),
        WavelengthGrid(790.0, 1.0, 12),
        WavelengthGrid(400.5, 1.0, 5),
        WavelengthGrid(400.0, 0.5, 3),
    ],
)
def test_a_grid_with_other_wavelengths_is_no_part(inner):
    with pytest.raises(ValueError, match="not part"):
        FILTER_GRID.part(inner)


def test_membership():
    assert all(wavelength in INTEGRAL_GRID for wavelength in (400.0, 555, 700.0))
    assert not any(wavelength in INTEGRAL_GRID for wavelength in (399.0, 400.5, 701.0))
    assert 400.7 in TENTHS


def test_matches_refuses_other_grids():
    assert INTEGRAL_GRID.matches(list(range(400, 701)))
    for other in (FILTER_GRID.nm, INTEGRAL_GRID.nm[::10], INTEGRAL_GRID.nm + 0.5, INTEGRAL_GRID.nm[:, None]):
        assert not INTEGRAL_GRID.matches(other)


def test_the_weights_integrate_straight_lines_exactly():
    for grid in (INTEGRAL_GRID, FILTER_GRID, TENTHS):
        first, last = grid.nm[[0, -1]]
        assert grid.weights.sum() == pytest.approx(last - first)
        assert grid.weights @ grid.nm == pytest.approx((last**2 - first**2) / 2)


def test_between_refuses_what_is_no_wavelength_of_the_grid():
    with pytest.raises(ValueError, match="not a wavelength"):
        INTEGRAL_GRID.between(380.0, 700.0)


@pytest.mark.parametrize(("step", "count"), [(0.0, 5), (-1.0, 5), (1.0, 1)])
def test_a_grid_takes_two_wavelengths_in_ascending_order(step, count):
    with pytest.raises(ValueError, match="not a grid"):
        WavelengthGrid(400.0, step, count)
