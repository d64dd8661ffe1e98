"""Radiances that filter weights are trained and judged on: lamps that vary smoothly, surfaces that reflect a part."""

import numpy as np
import pytest
from cboxlab.calibration.colour.radiance_ensemble import (
    evaluation_radiances,
    general_lamps,
    measured_reflectances,
    object_reflectances,
    training_radiances,
)
from cboxlab.scenes import cornell_box
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM as NM

COUNT = 10_000


@pytest.fixture(scope="module")
def trained():
    return training_radiances({"flat": np.full(NM.size, 7.0), "slope": NM}, count=COUNT)


def test_a_lamps_deviations_are_of_one_per_cent_and_50_nm_long(trained):
    """Whites in direct light show them: every twentieth. Of 500, deviations to 3 %, correlations to 0.05.

    A Gaussian process of length L: the correlation at a distance d is exp(-(d / L)^2 / 2).
    """
    lamp = np.stack([np.ones(NM.size), NM / NM.mean()])[np.arange(COUNT) % 2]
    shape = (trained / lamp)[::20] - 1
    assert shape.mean() == pytest.approx(0, abs=0.002)
    assert shape.std(axis=0) == pytest.approx(np.full(NM.size, 0.01), rel=0.12)
    for distance, correlation_expected in ((10, 0.980), (50, 0.607), (100, 0.135)):
        correlation = np.mean(shape[:, :-distance] * shape[:, distance:]) / 1e-4
        assert correlation == pytest.approx(correlation_expected, abs=0.06)


def test_surfaces_reflect_between_nothing_and_a_white_in_an_enclosure(trained):
    """At most what a white in an enclosure of 0.9 gets, 1 / (1 - 0.9) of its light; at least none."""
    lamp = np.stack([np.ones(NM.size), NM / NM.mean()])[np.arange(COUNT) % 2]
    ratio = trained / lamp
    assert ratio.min() > 0 and ratio.max() < 10.5


def test_half_of_the_surfaces_are_the_scenes_own():
    """One material of reflectance 1e-3 at every wavelength: a quarter of what is reflected twice has it twice."""
    ours = np.full((1, NM.size), 1e-3)
    dark = training_radiances({"flat": np.ones(NM.size)}, ours, count=COUNT).mean(axis=1) < 0.02
    others = training_radiances({"flat": np.ones(NM.size)}, count=COUNT).mean(axis=1) < 0.02
    assert np.mean(dark) - np.mean(others) == pytest.approx(0.95 * 0.5, abs=0.05)


def test_lamps_have_a_mean_of_1_and_objects_reflect_a_part():
    for spectrum in general_lamps().values():
        assert spectrum.mean() == pytest.approx(1) and spectrum.min() >= 0
    objects = object_reflectances()
    assert objects.shape == (99, NM.size) and 0 <= objects.min() and objects.max() <= 1
    measured = measured_reflectances()
    table = cornell_box().materials["red"].reflectance
    np.testing.assert_allclose(measured["box red"], table.at(NM))
    assert measured["white 9.5 (.05 D)"][NM == 550] == pytest.approx(0.9, abs=0.02)


def test_light_by_way_of_a_wall_is_reflected_once_or_more_in_half_an_enclosure():
    """rho (1 + rho/2 + rho^2/4 + ...), summed term by term, times the patch's own reflectance and the lamp."""
    lamp = np.linspace(1, 3, NM.size)
    ensemble = evaluation_radiances({"slope": lamp})
    measured = measured_reflectances()
    index = ensemble.names.index("slope, box green via box red")
    wall = sum(measured["box red"] * (measured["box red"] / 2) ** n for n in range(60))
    np.testing.assert_allclose(ensemble.values[index], lamp / 2 * measured["box green"] * wall)
    direct = ensemble.names.index("slope, box green")
    np.testing.assert_allclose(ensemble.values[direct], lamp / 2 * measured["box green"])
    np.testing.assert_allclose(ensemble.white[index], lamp / 2)
