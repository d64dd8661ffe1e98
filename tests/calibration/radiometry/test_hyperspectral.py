"""The hyperspectral camera: registration to hundredths of a pixel, and radiances that come back."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.correction.corrected_bands import correct_bands
from cboxlab.calibration.correction.dark import read_darks
from cboxlab.calibration.correction.noise import measure_noise
from cboxlab.calibration.radiometry.hyperspectral import _centre, _filter_mean, hyperspectral_cube
from cboxlab.calibration.radiometry.registration import Registration, move, register
from cboxlab.rendering.files.cube_files import read_cube, write_cube
from cboxlab.scenes import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.validation.app.commands.cli import main
from helpers.fakes.capture import GRID, FakeCapture, bell
from helpers.places import ROOT
from scipy.ndimage import minimum_filter
from scipy.special import erf

SIZE = 120


def chart(shift=(0.0, 0.0), magnification=1.0, seed=5):
    """(y, x) patches on black, reflectances drawn by ``seed``, edges blurred by 0.7 px: an exact formula."""
    values = np.random.default_rng(seed).uniform(0.1, 0.9, (5, 6))
    middle, pixels = (SIZE - 1) / 2, np.arange(SIZE)
    picture = np.full((SIZE, SIZE), 0.03)

    def profile(offset, start, end):
        position = (pixels - middle - offset) / magnification + middle
        return (erf((position - start) / 0.7 / 2**0.5) - erf((position - end) / 0.7 / 2**0.5)) / 2

    for row in range(5):
        for column in range(6):
            across = profile(shift[0], 20.7 * column + 3, 20.7 * column + 18.4)
            down = profile(shift[1], 24.3 * row + 3, 24.3 * row + 22.1)
            picture += values[row, column] * np.outer(down, across)
    return picture


@pytest.mark.parametrize(("shift", "magnification"), [((0.37, -0.81), 1.0), ((0.0, 0.0), 1.006), ((-1.6, 0.4), 0.995)])
@pytest.mark.parametrize("seed", [5, 6])
def test_registration_to_hundredths_of_a_pixel(shift, magnification, seed):
    """1% noise; other reflectances in the band than in the reference (seed 6): edges differ in strength.

    Limits: 0.06 px in the centre, 0.03 px more at the border (5e-4).
    """
    rng = np.random.default_rng(1)
    band = 800 * chart(shift, magnification, seed)
    band = band + 8 * rng.standard_normal(band.shape)
    registration = register(1000 * chart(), band)
    assert registration.converged
    np.testing.assert_allclose(registration.shift_px, shift, atol=0.06)
    assert registration.magnification == pytest.approx(magnification, abs=5e-4)


def test_bands_of_one_camera_that_lie_on_each_other_are_left_there():
    """The bundled capture's bands have one lens and red and green walls: their edges differ in strength.

    Limits: 0.1 px in the centre, 0.06 px more at the border (1e-3). The strength of edges alone gives 0.2 and 0.7 px.
    """
    capture = load_capture(ROOT / "validate" / "data" / "demo-capture")
    dark = read_darks(capture)
    signals = correct_bands(capture, dark, measure_noise(capture, dark)).images["signal"].values
    for signal in signals:
        registration = register(signals[3], signal)
        np.testing.assert_allclose(registration.shift_px, 0.0, atol=0.1)
        assert registration.magnification == pytest.approx(1.0, abs=1e-3)


def test_moved_back_the_band_lies_on_the_reference():
    reference, band = chart(), chart((0.6, -0.4), 1.004)
    before = np.abs(band - reference)[8:-8, 8:-8]
    after = np.abs(move(band, register(reference, band)) - reference)[8:-8, 8:-8]
    assert after.max() < 0.15 * before.max() and after.mean() < 0.15 * before.mean()


@pytest.mark.parametrize("smooth", [True, False])
def test_what_the_band_does_not_show_is_nan_and_nothing_else(smooth):
    matrix = np.array([[1.0, 0.0, 3.5], [0.0, 1.0, -2.0]])
    moved = move(chart(), Registration(matrix, 1.0, matrix[:, 2], 1.0, True), smooth=smooth)
    outside = np.zeros((SIZE, SIZE), bool)
    outside[:, -4:] = outside[:2] = True
    np.testing.assert_array_equal(np.isnan(moved), outside)
    assert 0 < np.nanmin(moved) and np.nanmax(moved) < 1


def test_the_cube_holds_no_value_but_light_and_nan(measured):
    """Along the border, where other bands are not seen, too: -2^31 counts had been there with OpenCV 5."""
    capture, bands, reading, region, _ = measured
    cube = hyperspectral_cube(capture, bands, region, reading).cube
    sigma = cube["standard_error"].values
    finite = np.isfinite(cube["radiance"].values)
    assert 0.95 < finite.mean() < 1
    np.testing.assert_array_equal(finite, np.isfinite(sigma))
    assert (cube["radiance"].values[finite] > -6 * sigma[finite]).all()
    assert (cube["radiance"].values[finite] < 20 * np.median(cube["radiance"].values[finite])).all()


def test_without_edges_nothing_is_moved():
    flat = np.ones((40, 40))
    registration = register(flat, flat)
    np.testing.assert_array_equal(registration.matrix, np.eye(2, 3))


class ShiftedCapture(FakeCapture):
    """Bands that a lens shifts and magnifies each in its own way; the scene is a chart."""

    def expected(self, band):
        wavelength = int(band[1:])
        away = (wavelength - 550) / 100
        return chart((0.5 * away, -0.3 * away), 1 + 0.004 * away) * self.scene_per_s[band] * self.exposure[band]


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """(capture, corrected bands, reading, region): the reading is the spectrum of one patch."""
    fake = ShiftedCapture(tmp_path_factory.mktemp("cube") / "c", seed=3, height=SIZE, width=SIZE)
    capture = load_capture(fake.write())
    dark = read_darks(capture)
    bands = correct_bands(capture, dark, measure_noise(capture, dark))
    truth = chart()
    v, u = np.indices(truth.shape)
    region = (np.abs(v - 37) < 5) & (np.abs(u - 52) < 4)
    assert np.ptp(truth[region]) < 1e-5
    patch = float(truth[region].mean())
    return capture, bands, Spectrum(GRID, patch * fake.spectrum, "zero"), region, fake


def truth_of(fake, band):
    """Radiance (y, x) of the band: mean of the scene's spectrum over the filter."""
    filter_curve = bell(int(band[1:]))
    return chart() * float(np.sum(filter_curve * fake.spectrum) / np.sum(filter_curve))


def test_radiance_comes_back(measured):
    """In the patches' insides within 5.5 standard errors (once in 2.6e7 pixels) and 0.5% for the scale."""
    capture, bands, reading, region, fake = measured
    merged = hyperspectral_cube(capture, bands, region, reading)
    cube = merged.cube
    inside = np.hypot(*np.gradient(chart())) < 1e-3
    inside = minimum_filter(inside, 5)[8:-8, 8:-8]
    assert inside.mean() > 0.1
    assert cube["radiance"].dims == ("y", "x", "wavelength") and np.all(np.diff(cube["wavelength"]) > 0)
    for index, band in enumerate(merged.bands):
        error = (cube["radiance"].values[..., index] - truth_of(fake, band))[8:-8, 8:-8]
        sigma = cube["standard_error"].values[..., index][8:-8, 8:-8]
        true = truth_of(fake, band)[8:-8, 8:-8]
        good = np.isfinite(error)
        assert good.mean() > 0.99
        good &= inside
        assert np.all(np.abs(error[good]) < 5.5 * sigma[good] + 0.005 * true[good]), band
    assert np.all(merged.scale_relative_sigma < 0.004)


def test_registration_is_what_makes_the_edges_right(measured):
    capture, bands, reading, region, fake = measured
    worst = []
    for aligned in (True, False):
        merged = hyperspectral_cube(capture, bands, region, reading, aligned=aligned)
        index = merged.bands.index("f700")
        worst.append(np.nanstd((merged.cube["radiance"].values[..., index] - truth_of(fake, "f700"))[8:-8, 8:-8]))
    assert worst[0] < 0.3 * worst[1]


def test_the_cube_is_one_that_the_other_rooms_read(measured, tmp_path):
    capture, bands, reading, region, _ = measured
    cube = hyperspectral_cube(capture, bands, region, reading).cube
    write_cube(tmp_path / "a.nc", cube)
    np.testing.assert_allclose(read_cube(tmp_path / "a.nc")["radiance"], cube["radiance"])


def test_a_region_must_lie_in_the_image_and_be_lit(measured):
    capture, bands, reading, region, _ = measured
    with pytest.raises(InputError, match="region"):
        hyperspectral_cube(capture, bands, np.zeros_like(region), reading)
    with pytest.raises(InputError, match="reference band"):
        hyperspectral_cube(capture, bands, region, reading, reference_band="f999")


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return caught.value.code or 0


@pytest.fixture(scope="module")
def readings(measured, tmp_path_factory):
    """The spectroradiometer's file."""
    path = tmp_path_factory.mktemp("reading") / "reading.csv"
    table = np.column_stack([measured[2].wavelength_nm, measured[2].values])
    np.savetxt(path, table, delimiter=",", header="wavelength_nm,radiance", comments="", fmt="%.10g")
    return path


def test_the_command_writes_what_the_library_finds(measured, readings, tmp_path, capsys):
    capture, bands, reading, region, _ = measured
    v, u = np.nonzero(region)
    source = f"{u.min()},{v.min()},{u.max()},{v.max()}"
    out = tmp_path / "cube.nc"
    assert (
        run(
            "hyperspectral",
            capture.folder,
            "--reading",
            f"{readings}:radiance",
            "--region",
            source,
            "--out",
            out,
        )
        == 0
    )
    output = capsys.readouterr().out
    assert "registered to f550" in output and "f700" in output
    cube = hyperspectral_cube(capture, bands, region, reading).cube
    written = read_cube(out)
    np.testing.assert_allclose(written["radiance"], cube["radiance"], rtol=1e-5)
    np.testing.assert_allclose(written["wavelength"], cube["wavelength"])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"--region": "5,5,500,9"}, "u0,v0,u1,v1 with 0 <= u0 <= u1 < 120"),
        ({"--region": "white"}, "without [labels]"),
        ({"--reading": "{reading}:radiant"}, "radiance"),
        ({"--reading": "reading.csv"}, "such as reading.csv:radiance"),
        ({"--out": "cube.tif"}, ".nc, .exr or .hdr"),
        ({"--reference-band": "f555"}, "one of f400"),
    ],
)
def test_mistakes_end_in_one_message(measured, readings, tmp_path, capsys, changed, message):
    options = {"--region": "48,33,55,41", "--reading": "{reading}:radiance", "--out": "cube.nc", **changed}
    options["--out"] = str(tmp_path / options["--out"])
    arguments = [part.format(reading=readings) for pair in options.items() for part in pair]
    assert run("hyperspectral", measured[0].folder, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error and "Traceback" not in error
    assert not list(tmp_path.iterdir())


def test_a_measured_scene_can_be_photographed_by_another_camera(measured, readings, tmp_path):
    """--scene: no holes and nothing below 0, what is known left as it is; simulate refuses the cube without it."""
    capture = measured[0]
    for name, options in (("holes.nc", ()), ("scene.nc", ("--scene",))):
        arguments = ("--reading", f"{readings}:radiance", "--region", "48,33,55,41", "--out", tmp_path / name)
        assert run("hyperspectral", capture.folder, *arguments, *options) == 0
    holes, scene = (read_cube(tmp_path / name)["radiance"].values for name in ("holes.nc", "scene.nc"))
    assert np.isnan(holes).any() and np.all(scene >= 0)
    finite = np.isfinite(holes)
    np.testing.assert_array_equal(scene[finite], np.maximum(holes[finite], 0))
    assert run("simulate", tmp_path / "holes.nc", "--out", tmp_path / "a.tif") == 2
    assert run("simulate", tmp_path / "scene.nc", "--out", tmp_path / "b.tif") == 0
    assert (tmp_path / "b.tif").exists() and not (tmp_path / "a.tif").exists()


def test_a_filter_of_even_transmittance_reads_the_middle_of_a_slope():
    """Both ends of its table count: 500 to 510 nm, and of an odd width."""
    slope = Spectrum(np.array([400.0, 700.0]), np.array([400.0, 700.0]))
    for last in (510.0, 500.5):
        even = Spectrum(np.array([500.0, last]), np.array([0.7, 0.7]), "zero")
        assert _filter_mean(even, slope) == pytest.approx((500 + last) / 2, rel=1e-12)
    rising = Spectrum(np.array([500.0, 510.0]), np.array([0.0, 1.0]), "zero")
    assert _filter_mean(rising, slope) == pytest.approx(500 + 20 / 3, abs=0.2)


@pytest.mark.parametrize("end_nm", [520.0, 523.0])
def test_the_centre_of_a_table_that_ends_at_its_maximum_counts_its_last_value(end_nm):
    table = Spectrum(np.array([500.0, end_nm]), np.array([0.5, 0.5]), "zero")
    capture = SimpleNamespace(band=lambda _: SimpleNamespace(transmittance="a"), light=lambda _: table)
    assert _centre(capture, "a")[0] == pytest.approx((500 + end_nm) / 2)
