"""Cubes with the same random numbers on both sides: their differences, cube by cube."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.regress import regress_inputs, regress_sides, side_of
from pictures import SIZE, WAVELENGTHS, noisy

CUBES = 4


def side(first_seed, changed=lambda radiance, rng: radiance):
    """Mean of cubes with different seeds."""
    rng = np.random.default_rng(first_seed)
    cubes = []
    for number in range(CUBES):
        radiance = changed(noisy(first_seed + number, noise=0.08).radiance, rng).astype(np.float32)
        data = {"radiance": (("y", "x", "wavelength"), radiance)}
        cubes.append(xr.Dataset(data, coords={"wavelength": WAVELENGTHS}))
    return side_of(cubes, [f"{first_seed} {number} {id(changed)}" for number in range(CUBES)])


def other_paths(radiance, rng):
    """A fifth of the pixels got other paths; their mean is the same."""
    differing = rng.random((SIZE, SIZE, 1)) < 0.2
    return radiance * np.where(differing, 1 + 0.1 * (rng.standard_gamma(1, (SIZE, SIZE, 1)) - 1), 1)


def test_a_change_of_three_thousandths_of_a_percent_is_seen():
    outcome, names = regress_sides(side(100), side(100, lambda radiance, rng: radiance * (1 + 3e-5)))
    assert names.pooling.paired
    assert not outcome.same
    assert outcome.picture_mean.difference == pytest.approx(3e-5, abs=4 * outcome.picture_mean.sigma)
    assert outcome.would_have_seen < 3e-5
    assert any("same random numbers" in note for note in outcome.notes)


def many_other_paths(radiance, rng):
    """Nine tenths of the pixels got other paths."""
    differing = rng.random((SIZE, SIZE, 1)) < 0.9
    return radiance * np.where(differing, 1 + 0.15 * (rng.standard_gamma(1, (SIZE, SIZE, 1)) - 1), 1)


def test_pairs_that_the_user_states_are_compared_cube_by_cube():
    """Most paths differ, so that the sides are not recognised as pairs; the light is the same."""
    sides = side(100), side(100, many_other_paths)
    assert not regress_sides(*sides)[1].pooling.paired
    outcome, comparison = regress_sides(*(replace(s, same_seeds=True) for s in sides))
    assert comparison.pooling.paired
    assert outcome.same


def test_stated_pairs_need_as_many_cubes_on_each_side(tmp_path):
    planes = {name: np.ones((8, 8), np.float32) for name in "RGB"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(tmp_path / "a.exr"))
    with pytest.raises(InputError, match="1 and 1 cubes; expected 2 or more of each side"):
        regress_inputs(str(tmp_path / "a.exr"), str(tmp_path / "a.exr"), same_seeds=True)


def test_other_random_numbers_are_not_paired():
    outcome, names = regress_sides(side(100), side(200))
    assert not names.pooling.paired
    assert outcome.same


def test_other_paths_of_the_same_light_are_no_change():
    """Few pixels differ, skewed; weights by their own variances gave three alarms in thirty pairs."""
    outcomes = [regress_sides(side(1000 * s), side(1000 * s, other_paths))[0] for s in range(6)]
    assert all(outcome.same for outcome in outcomes)
