"""The sensor's forward model: light to electrons to counts, against theory and the integral itself."""

import dataclasses

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.files.previews import cube_to_srgb, raw_to_srgb, scene_white
from cboxlab.rendering.image.image import LAMP
from cboxlab.rendering.sensor.cameras import PACKAGED, load_camera, packaged_cameras
from cboxlab.rendering.sensor.detector import Detector, SensorCamera, channel_map, noisy_counts, quantise
from cboxlab.rendering.sensor.light import integration_weights, require_radiance
from cboxlab.rendering.sensor.simulation import auto_exposure, expected_electrons, noiseless_frame, simulate_frame
from cboxlab.scenes.spectra import Spectrum, planck
from cboxlab.utils.errors import InputError

DRAWS = 1_000_000
#: Standard errors that a test of a mean or a variance allows: one false alarm in 1.7 million.
SIGMAS = 5.0


def detector(**changes) -> Detector:
    values = {
        "gain_e_per_dn": 12.0,
        "bit_depth": 12,
        "dark_exposure_s": np.array([1.0, 11.0]),
        "dark_mean_dn": np.array([100.0, 110.0]),
        "dark_sigma_dn": np.array([1.0, 1.0]),
    }
    return Detector(**{**values, **changes})


def cube(radiance, wavelength=None) -> xr.Dataset:
    wavelength = np.arange(400.0, 701.0, 10.0) if wavelength is None else wavelength
    return xr.Dataset(
        {"radiance": (("y", "x", "wavelength"), radiance, {"units": "W m^-2 sr^-1 nm^-1"})},
        coords={"wavelength": ("wavelength", wavelength, {"units": "nm"})},
    )


def tungsten(shape=(8, 8)) -> xr.Dataset:
    """A uniform field of tungsten light."""
    wavelength = np.arange(400.0, 701.0, 10.0)
    return cube(np.broadcast_to(1e-3 * planck(wavelength, 3000.0), (*shape, 31)).copy(), wavelength)


def test_far_too_long_an_exposure_saturates():
    frame = simulate_frame(tungsten(), load_camera("dcs200"), 1e25, 1)
    assert (frame == frame.max()).all()
    assert frame.max() == load_camera("dcs200").detector.full_scale_dn


@pytest.mark.parametrize("electrons", [3.0, 400.0, 30_000.0])
def test_a_million_counts_have_the_mean_and_variance_of_theory(electrons):
    """Mean e / g + dark; variance e / g^2 + sigma^2; both within their own standard errors.

    The standard error of a variance is sqrt((m4 - m2^2) / n), m4 = 3 m2^2 + e / g^4 (Poisson's excess).
    """
    sensor = detector()
    counts = noisy_counts(np.full(DRAWS, electrons), 100.0, 1.0, sensor, np.random.default_rng(1))
    gain = sensor.gain_e_per_dn
    variance = electrons / gain**2 + 1.0
    assert counts.mean() == pytest.approx(100 + electrons / gain, abs=SIGMAS * np.sqrt(variance / DRAWS))
    error = np.sqrt((2 * variance**2 + electrons / gain**4) / DRAWS)
    assert counts.var(ddof=1) == pytest.approx(variance, abs=SIGMAS * error)


def test_rounding_adds_a_twelfth_to_the_variance():
    """Sheppard's correction holds where the noise is at least one count wide."""
    counts = noisy_counts(np.full(DRAWS, 6000.0), 100.0, 1.0, detector(), np.random.default_rng(2))
    rounded = quantise(counts, 12)
    variance = 6000 / 144 + 1 + 1 / 12
    assert rounded.dtype == np.uint16
    assert rounded.var(ddof=1) == pytest.approx(variance, abs=SIGMAS * variance * np.sqrt(2 / DRAWS))


def test_photon_transfer_returns_gain_and_read_noise():
    """The straight line of variance against mean over ten levels has slope 1 / gain and the read floor."""
    generator, sensor, per_level = np.random.default_rng(3), detector(), 200_000
    levels = np.linspace(0, 40_000, 10)
    mean, variance = np.empty(10), np.empty(10)
    for index, level in enumerate(levels):
        pair = [quantise(noisy_counts(np.full(per_level, level), 100.0, 1.0, sensor, generator), 12) for _ in range(2)]
        mean[index] = np.mean(pair)
        variance[index] = np.var(pair[0] - pair[1].astype(float), ddof=1) / 2
    weight = 1 / (variance * np.sqrt(2 / per_level))
    (slope, floor), covariance = np.polyfit(mean - 100, variance, 1, w=weight, cov="unscaled")
    assert abs(1 / slope - 12.0) < SIGMAS * 12.0**2 * np.sqrt(covariance[0, 0])
    assert abs(floor - (1 + 1 / 12)) < SIGMAS * np.sqrt(covariance[1, 1])


def test_counts_are_clipped_to_the_bit_depth():
    assert quantise([-3.0, 0.49, 254.6, 1e6], 8).tolist() == [0, 0, 255, 255]


def test_full_well_cuts_the_charge_before_the_converter():
    counts = noisy_counts(np.full(1000, 50_000.0), 0.0, 0.0, detector(full_well_e=24_000.0), np.random.default_rng(0))
    assert np.all(counts == 2000.0)


def test_nonlinearity_acts_on_light_and_noise_together_and_is_undone():
    bent = detector(linear_dn=np.array([0.0, 1000.0, 4000.0]), recorded_dn=np.array([0.0, 1500.0, 4095.0]))
    counts = noisy_counts(np.full(DRAWS, 6000.0), 100.0, 2.0, bent, np.random.default_rng(4))
    slope, linear = 1.5, 600.0
    variance = slope**2 * (6000 / 144 + 4)
    assert counts.mean() == pytest.approx(slope * linear, abs=SIGMAS * np.sqrt(variance / DRAWS))
    assert counts.var() == pytest.approx(variance, rel=SIGMAS * np.sqrt(2 / DRAWS))
    values = np.linspace(0, 4000, 101)
    np.testing.assert_allclose(bent.linearise(bent.record(values)), values, atol=1e-9)


def test_weights_integrate_the_product_of_piecewise_lines_exactly():
    """Against the trapezoidal sum on a grid so fine that its own error is below the tolerance."""
    generator = np.random.default_rng(5)
    table = Spectrum(np.arange(410.0, 691.0, 7.0), generator.random(41), "zero")
    grid = np.concatenate([[400.0], np.sort(generator.uniform(405, 695, 20)), [700.0]])
    radiance = generator.random(22)
    fine = np.linspace(410, 690, 2_000_001)
    expected = np.trapezoid(table.at(fine) * np.interp(fine, grid, radiance), fine)
    assert integration_weights(table, grid) @ radiance == pytest.approx(expected, rel=1e-8)


def test_light_is_proportional_to_radiance_exposure_and_area():
    camera, field = load_camera("pxl1300l"), tungsten()
    electrons = expected_electrons(field, camera, 0.5, "f550")
    np.testing.assert_allclose(expected_electrons(field * 3, camera, 1.0, "f550"), 6 * electrons, rtol=1e-12)


def test_the_monochrome_camera_counts_as_the_capture_format_says():
    """DN = (pi / 4) A t / (N^2 g) (f / d)^2 Int lambda / (h c) Q T_lens T_i L dl, done here by plain sums."""
    camera, exposure = load_camera("pxl1300l"), 2.0
    wavelength = np.arange(400.0, 701.0)
    radiance = 1e-5 * planck(wavelength, 3000.0)
    text = np.genfromtxt(PACKAGED / "pxl1300l.csv", delimiter=",", names=True)
    filters = np.genfromtxt(PACKAGED / "pxl1300l-filters.csv", delimiter=",", names=True)
    curve = text["quantum_efficiency"] * text["lens"] * filters["f600"][20:321]
    quanta = wavelength * 1e-9 / (6.626e-34 * 2.998e8)
    factor = np.pi / 4 * 35.0**2 * 97.65625e-6**2 * exposure / (12.0 * 8.0**2 * 36.6**2)
    expected = factor * np.trapezoid(quanta * curve * radiance, wavelength)
    counts = noiseless_frame(cube(radiance[None, None], wavelength), camera, exposure, "f600")[0, 0]
    # 1e-5: the responsivity counts as linear between samples, where the format's sum has its product so
    assert counts - camera.detector.dark(exposure)[0] == pytest.approx(expected, rel=1e-5)


def test_simulated_frames_scatter_about_the_expected_counts():
    camera, field = load_camera("dcs200"), tungsten((500, 500))
    exposure = auto_exposure(field, camera)
    expected = noiseless_frame(field, camera, exposure)
    frame = simulate_frame(field, camera, exposure, seed=7).astype(float)
    for where in ((0, 0), (0, 1), (1, 0), (1, 1)):
        lattice = (slice(where[0], None, 2), slice(where[1], None, 2))
        dark, sigma = camera.detector.dark(exposure)
        variance = (expected[lattice][0, 0] - dark) / 300.0 + sigma**2 + 1 / 12
        assert frame[lattice].mean() == pytest.approx(expected[lattice][0, 0], abs=SIGMAS * np.sqrt(variance / 62_500))
        assert frame[lattice].var() == pytest.approx(variance, rel=SIGMAS * np.sqrt(2 / 62_500))


def test_the_same_seed_gives_the_same_frame():
    camera, field = load_camera("dcs200"), tungsten()
    frames = [simulate_frame(field, camera, 0.1, seed) for seed in (1, 1, 2)]
    assert np.array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


def test_dark_level_of_the_dcs200_follows_table_two():
    """Vora et al. 2001, Table II: means of red, green and blue; 13.6 DN over all exposures."""
    sensor = load_camera("dcs200").detector
    for exposure, mean in ((8.0, 12.54), (1.0, 13.54), (0.5, 13.88), (1 / 125, 11.88)):
        assert sensor.dark(exposure)[0] == pytest.approx(mean, abs=0.01)
    assert sensor.dark_mean_dn.mean() == pytest.approx(13.62, abs=0.01)
    counts = noisy_counts(np.zeros(DRAWS), *sensor.dark(1.0), sensor, np.random.default_rng(8))
    # The level's place between two counts decides how much rounding adds: a few per cent at this noise.
    assert quantise(counts, 8).std() == pytest.approx(0.89, abs=0.01)


def test_sensitivities_of_the_dcs200_are_those_published(shared):
    published = shared / "real" / "kodak-dcs200" / "sensitivity.csv"
    assert (PACKAGED / "dcs200.csv").read_text() == published.read_text()
    camera = load_camera("dcs200")
    table = np.genfromtxt(published, delimiter=",", names=True)
    ratio = camera.channels["R"].at(table["wavelength_nm"]) / camera.channels["G"].at(table["wavelength_nm"])
    np.testing.assert_allclose(ratio, table["red"] / table["green"], rtol=1e-9)


def test_auto_exposure_puts_the_bright_surfaces_at_seventy_per_cent():
    field = tungsten((20, 20))
    field["radiance"] *= 1e-4
    field["radiance"][:2, :2] *= 1000
    surface = np.zeros((20, 20), np.int16)
    surface[:2, :2] = LAMP
    field["surface"] = (("y", "x"), surface)
    for name, channel in (("dcs200", None), ("pxl1300l", "f550")):
        camera = load_camera(name)
        counts = noiseless_frame(field, camera, auto_exposure(field, camera, channel), channel)
        level = np.percentile(counts[surface != LAMP], 99) / camera.detector.full_scale_dn
        assert level == pytest.approx(0.7, abs=1e-3)
        assert np.percentile(counts[surface == LAMP], 99) == camera.detector.full_scale_dn


def test_mosaic_of_any_size_repeats_over_the_sensor():
    channels = channel_map(("ABC", "BCD"), ("A", "B", "C", "D"), (5, 7))
    assert channels.tolist()[0] == [0, 1, 2, 0, 1, 2, 0]
    assert channels.tolist()[3] == [1, 2, 3, 1, 2, 3, 1]
    assert channels.shape == (5, 7)


def test_each_pixel_behind_a_mosaic_sees_its_own_channel():
    grid = np.array([400.0, 700.0])
    channels = {
        letter: Spectrum(grid, np.full(2, value), "zero") for letter, value in zip("WXYZ", (1, 2, 3, 4), strict=True)
    }
    camera = SensorCamera("four", channels, ("WX", "YZ"), detector(), "test")
    electrons = expected_electrons(cube(np.ones((2, 2, 31))), camera, 1.0)
    np.testing.assert_allclose(electrons, [[300, 600], [900, 1200]])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: channel_map(("RG", "GX"), ("R", "G", "B"), (4, 4)), "letter 'X'"),
        (lambda: channel_map(("RG", "G"), ("R", "G"), (4, 4)), "same length"),
        (lambda: simulate_frame(tungsten(), load_camera("dcs200"), 0.0, 1), "time above 0"),
        (lambda: simulate_frame(tungsten(), load_camera("dcs200"), 1.0, 1, "R"), "none: a mosaic"),
        (lambda: simulate_frame(tungsten(), load_camera("pxl1300l"), 1.0, 1), "one of f400"),
        (lambda: simulate_frame(tungsten(), load_camera("pxl1300l"), 1.0, 1, "f999"), "'f999'"),
        (
            lambda: simulate_frame(tungsten().isel(wavelength=slice(0, 12)), load_camera("dcs200"), 1.0, 1),
            "Render the cube over a wider range",
        ),
        (lambda: require_radiance(np.ones((2, 2, 30)), 31), "one value per wavelength"),
        (lambda: auto_exposure(tungsten() * 0, load_camera("dcs200")), "no light"),
        (lambda: load_camera("dcs2000"), "Did you mean 'dcs200'"),
    ],
)
def test_mistakes_are_reported(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_negative_radiance_beyond_noise_is_reported_with_its_place():
    field = tungsten()
    field["radiance"][3, 2, 10] = -1e-6
    with pytest.raises(InputError, match=r"radiance\[3, 2, 10\].*found -1e-06"):
        simulate_frame(field, load_camera("dcs200"), 1.0, 1)
    field["standard_error"] = field["radiance"].dims, np.full(field["radiance"].shape, 1e-6)
    simulate_frame(field, load_camera("dcs200"), 1.0, 1)


def test_every_packaged_camera_loads():
    assert packaged_cameras() == ["dcs200", "dcs420", "nikon-d5100", "pxl1300l", "sigma-sd-merrill", "sony-a7r2"]
    for name in packaged_cameras():
        assert load_camera(name).source


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bit_depth = 8", "bit_depth = 20", "detector.bit_depth"),
        ("bit_depth = 8", "bit_dept = 8", "Did you mean 'bit_depth'"),
        ('pattern = ["RG", "GB"]', 'pattern = ["RG", "GE"]', "letter 'E'"),
        ("dcs200.csv:blue", "dcs200.csv:bleu", "Did you mean 'blue'"),
        ("mean_dn    = [11.88, ", "mean_dn    = [", "columns of equal length"),
        ('kind = "relative_energy"', 'kind = "quantum_efficiency"', "peak_quantum_efficiency"),
        ("[detector]", "[detector", "TOML"),
    ],
)
def test_faults_of_a_camera_file_are_reported(tmp_path, old, new, message):
    text = (PACKAGED / "dcs200.toml").read_text()
    assert old in text
    (tmp_path / "dcs200.csv").write_text((PACKAGED / "dcs200.csv").read_text())
    path = tmp_path / "mine.toml"
    path.write_text(text)
    assert load_camera(path).name == "Kodak DCS-200"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        load_camera(path)


def test_a_white_field_develops_neutral_and_a_red_one_red():
    camera, field = load_camera("dcs200"), tungsten((16, 16))
    white = Spectrum(field["wavelength"].values, planck(field["wavelength"].values, 3000.0))
    exposure = auto_exposure(field, camera)
    noiseless = quantise(noiseless_frame(field, camera, exposure), 16)
    colour = raw_to_srgb(noiseless, camera, exposure, white)[8, 8].astype(int)
    # a half count of rounding is 1% of the weak blue channel
    assert np.ptp(colour) <= 8
    assert colour.min() > 200
    red = field * xr.DataArray(np.where(field["wavelength"] < 590, 0.02, 1.0), dims="wavelength")
    r, g, b = raw_to_srgb(quantise(noiseless_frame(red, camera, exposure), 16), camera, exposure, white)[8, 8]
    assert r > 1.5 * max(g, b)


def test_pictures_need_a_bayer_mosaic():
    camera = dataclasses.replace(load_camera("dcs200"), pattern=("RGGB",))
    with pytest.raises(InputError, match="Bayer"):
        raw_to_srgb(np.zeros((8, 8), np.uint16), camera, 1.0, Spectrum(np.array([550.0]), np.ones(1)))


def test_the_lamps_own_light_is_neutral_in_the_picture_of_a_cube():
    field = tungsten((6, 6))
    field["radiance"][3:] *= 0.5
    surface = np.zeros((6, 6), np.int16)
    surface[0, 0] = LAMP
    field["surface"] = (("y", "x"), surface)
    picture = cube_to_srgb(field, scene_white(field)).astype(int)
    assert np.ptp(picture, axis=-1).max() <= 1
    # sRGB of a linear 0.5 is 188
    assert picture[1].min() >= 254
    assert np.all(np.abs(picture[4] - 188) <= 1)
