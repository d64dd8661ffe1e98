"""Pictures in colour against cubes: over which wavelengths, and the steps in which Radiance's files store colours."""

import numpy as np
import pytest
from cboxlab.calibration.instrument import colour_matching_functions
from cboxlab.rendering.files import Declared, primaries_matrix, read_picture, write_cube
from cboxlab.rendering.files.colour_pictures import COLOUR_SPACES, as_xyz_picture
from cboxlab.rendering.files.cube_checks import as_cube
from cboxlab.validation.compare_renders import compare_stacks, read_stack
from cboxlab.validation.compare_renders.regress import regress_sides, side_of
from helpers.files.rgbe import write_rgbe

SIZE = 40
WAVELENGTHS = np.arange(380.0, 731.0, 10.0)
DECLARED = Declared("cd m^-2", 179.0, colour_space="radiance")
RADIANCE = primaries_matrix(COLOUR_SPACES["radiance"])


def light(paint):
    """(y, x, w) smooth light of a warm lamp on two surfaces, grey and of a paint (w,)."""
    y, x = np.indices((SIZE, SIZE)) / SIZE
    lamp = (WAVELENGTHS / 560) ** 3
    level = 0.3 + 0.4 * y * (1 - x) + 0.2 * x
    return level[..., None] * lamp * np.where((x < 0.5)[..., None], 0.6, paint)


def red():
    """Of a saturated red: its blue in Radiance's primaries is below 0."""
    return 0.02 + 0.7 / (1 + np.exp(-(WAVELENGTHS - 610) / 8))


def xyz_of(radiance):
    """cd m^-2, by the trapezoidal rule at each nm of 380 to 730."""
    fine = np.arange(380.0, 730.5)
    between = np.array([np.interp(fine, WAVELENGTHS, row) for row in np.eye(WAVELENGTHS.size)])
    return radiance @ (683.0 * np.trapezoid(between[:, None] * colour_matching_functions(fine), dx=1.0))


def cube(radiance, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    values = radiance * (1 + noise * rng.standard_normal((*radiance.shape[:2], 1)))
    return as_cube(values, WAVELENGTHS)


def test_a_cube_is_integrated_over_its_own_range():
    """The same light, whose X beyond 400 to 700 nm is 0.3 %, agrees to 5e-5, and the range is said."""
    radiance = light(red())
    outcome, _ = regress_sides(
        side_of([cube(radiance)], ["a cube"]), side_of([as_xyz_picture(xyz_of(radiance))], ["a picture"])
    )
    for row in outcome.of_kind("band"):
        assert row.difference == pytest.approx(0, abs=5e-5)
    assert any("a cube: compared in X, Y, Z over 380 to 730 nm" in note for note in outcome.notes)


def test_wavelengths_that_nobody_sees_add_nothing():
    wider = np.arange(300.0, 1001.0, 10.0)
    visible = (wider >= 360) & (wider <= 830)
    values = np.random.default_rng(1).uniform(0.5, 1, (24, 24, wider.size))
    picture = side_of([as_xyz_picture(np.ones((24, 24, 3)))], ["a picture"])
    complete, part = (
        regress_sides(picture, side_of([as_cube(values[..., mask], wider[mask])], ["a cube"]))[0]
        for mask in (wider > 0, visible)
    )
    assert complete.picture_mean.difference == pytest.approx(part.picture_mean.difference, rel=1e-9)
    assert any("over 360 to 830 nm" in note for note in complete.notes)


def radiance_file(tmp_path, radiance):
    rgb = xyz_of(radiance) / 179 @ np.linalg.inv(RADIANCE).T
    path = write_rgbe(tmp_path / "a.hdr", rgb)
    return read_picture(path, DECLARED)


@pytest.mark.parametrize("paint", [red(), np.full(WAVELENGTHS.size, 0.05)], ids=["red", "black"])
def test_the_steps_of_a_radiance_picture_are_no_difference(tmp_path, paint):
    """A cube without noise and its picture, at ten levels of the light."""
    for factor in np.geomspace(0.01, 0.019, 10):
        radiance = factor * light(paint)
        picture = radiance_file(tmp_path, radiance)
        outcome, _ = regress_sides(side_of([cube(radiance)], ["cube"]), side_of([picture], ["hdr"]))
        assert outcome.same, [(row.kind, row.name, row.statistic) for row in outcome.deciding]
    assert abs(outcome.picture_mean.difference) < 4 * outcome.picture_mean.sigma


def test_noisy_radiance_pictures_are_the_same_and_keep_their_power(tmp_path):
    """30 pairs of a noise of 1 %: none is different; light brighter by 1 % always is, in six of them."""
    radiance = light(np.full(WAVELENGTHS.size, 0.3))
    for seed in range(30):
        noisy = cube(radiance, 0.01, 100 + seed)["radiance"].values
        picture = side_of([radiance_file(tmp_path, noisy)], ["hdr"])
        assert regress_sides(side_of([cube(radiance, 0.01, seed)], ["cube"]), picture)[0].same
        if seed < 6:
            brighter = cube(1.01 * radiance, 0.01, seed)
            assert not regress_sides(side_of([brighter], ["cube"]), picture)[0].same


def test_compare_prints_the_same_notes_and_takes_the_steps_as_errors(tmp_path):
    radiance = light(red())
    write_cube(tmp_path / "a.nc", cube(radiance))
    radiance_file(tmp_path, radiance)
    stacks = read_stack(tmp_path / "a.nc"), read_stack(tmp_path / "a.hdr", DECLARED)
    comparison = compare_stacks(*stacks)
    assert any("compared in X, Y, Z over 380 to 730 nm" in note for note in comparison.notes)
    assert any("one exponent for all three" in note for note in comparison.notes)
    for row in comparison.rows:
        assert row.chi2_per_pixel < 1.5
    for mean in comparison.means:
        assert abs(mean.difference) < 4 * mean.sigma
