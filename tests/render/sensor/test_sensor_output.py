"""Cameras as data, cubes in a basis, and what comes after the sensor: colour, DNG, capture folders."""

import dataclasses

import numpy as np
import pytest
import xarray as xr
from cboxlab.calibration.capture import band_channels, channel_mask, file_mosaic_notes
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.correction.dark import read_darks
from cboxlab.calibration.correction.noise import measure_noise
from cboxlab.calibration.frame_readers import frame_header
from cboxlab.calibration.instrument import colour_matching_functions
from cboxlab.calibration.radiometry.sensor_equation import band_responses, nominal_constant
from cboxlab.rendering.files.cube_files import open_cube, write_cube
from cboxlab.rendering.files.dng import write_dng
from cboxlab.rendering.image.spectral_basis import from_basis, principal_components, spectral_error, to_basis
from cboxlab.rendering.sensor.cameras import PACKAGED, load_camera, packaged_cameras
from cboxlab.rendering.sensor.colour_correction import (
    chart_reflectances,
    demosaic,
    fit_correction,
    linear_counts,
)
from cboxlab.rendering.sensor.detector import channel_map, noisy_counts, quantise
from cboxlab.rendering.sensor.optics import Blur
from cboxlab.rendering.sensor.simulation import auto_exposure, expected_electrons, noiseless_frame, simulate_frame
from cboxlab.rendering.synthetic.cube_capture import write_cube_capture
from cboxlab.scenes.spectra import Spectrum, planck
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.app.commands.cli import main
from helpers.files.raw_frames import read_raw

WAVELENGTH = np.arange(400.0, 701.0, 10.0)
TUNGSTEN = Spectrum(WAVELENGTH_NM, planck(WAVELENGTH_NM, 3000.0))


def cube(radiance) -> xr.Dataset:
    return xr.Dataset(
        {"radiance": (("y", "x", "wavelength"), radiance, {"units": "W m^-2 sr^-1 nm^-1"})},
        coords={"wavelength": ("wavelength", WAVELENGTH, {"units": "nm"})},
    )


def chart_cube(patch_px=8) -> xr.Dataset:
    """The ColorChecker's 24 patches, 4 rows of 6, under tungsten light."""
    spectra = chart_reflectances()[:, ::10] * 1e-4 * planck(WAVELENGTH, 3000.0)
    return cube(np.kron(spectra.reshape(4, 6, 31), np.ones((patch_px, patch_px, 1))))


# ---- cameras ----


def test_the_dcs420_has_the_dark_level_and_spread_published():
    """Vora et al. 2001, Appendix E: 25.03 and 0.4760 DN, after F and rounding; a million draws."""
    sensor = load_camera("dcs420").detector
    draws = noisy_counts(np.zeros(1_000_000), *sensor.dark(1.0), sensor, np.random.default_rng(1))
    counts = quantise(draws, sensor.bit_depth)
    assert counts.mean() == pytest.approx(25.03, abs=5 * 0.476 / 1000)
    assert counts.std() == pytest.approx(0.476, abs=0.002)


def test_twelve_bits_become_eight_and_come_back():
    """F is a square root: 4095 linear DN become 255, a quarter becomes a half; its table undoes it exactly."""
    sensor = load_camera("dcs420").detector
    np.testing.assert_allclose(sensor.record([0, 4095 / 4, 4095, 9999]), [0, 127.5, 255, 255], atol=2e-3)
    recorded = np.arange(256.0)
    np.testing.assert_allclose(sensor.record(sensor.linearise(recorded)), recorded, atol=1e-9)


def test_a_table_for_the_nonlinearity_may_be_the_identity(tmp_path):
    text = (PACKAGED / "dcs200.toml").read_text()
    (tmp_path / "dcs200.csv").write_text((PACKAGED / "dcs200.csv").read_text())
    (tmp_path / "a.toml").write_text(text + "[nonlinearity]\nlinear_dn = [0, 255]\nrecorded_dn = [0, 255]\n")
    field, plain = chart_cube(), load_camera("dcs200")
    exposure = auto_exposure(field, plain)
    counts = noiseless_frame(field, load_camera(tmp_path / "a.toml"), exposure)
    np.testing.assert_allclose(counts, noiseless_frame(field, plain, exposure), rtol=1e-12)
    for broken in (
        "linear_dn = [0, 255]",
        "linear_dn = [0, 1]\nrecorded_dn = [0, 1]\nsquare_root_from_dn = 4095",
    ):
        (tmp_path / "b.toml").write_text(text + f"[nonlinearity]\n{broken}\n")
        with pytest.raises(InputError, match="nonlinearity"):
            load_camera(tmp_path / "b.toml")


@pytest.mark.parametrize(
    ("name", "key"), [("nikon-d5100", "Nikon 5100 (NPL)"), ("sigma-sd-merrill", "Sigma SDMerill (NPL)")]
)
def test_measured_sensitivities_are_those_of_colour_science(name, key):
    from colour.characterisation import MSDS_CAMERA_SENSITIVITIES

    published = MSDS_CAMERA_SENSITIVITIES[key]
    table = np.genfromtxt(PACKAGED / f"{name}.csv", delimiter=",", skip_header=1)
    np.testing.assert_allclose(table, np.column_stack([published.wavelengths, published.values]), rtol=1e-9)


@pytest.mark.parametrize("name", packaged_cameras())
def test_expected_counts_agree_with_an_independent_photon_count(name):
    """By photons, as ISETCam counts them, on a 0.1 nm grid; within 0.1%.

    Photons s^-1 m^-2 nm^-1 on the sensor = pi L l / (h c) / (1 + 4 N^2) for a distant scene; electrons = photons
    x quantum efficiency x area x time. Conventions that differ: ISETCam's 1 + 4 N^2 (the exact cosine-weighted
    cone) where the 2001 paper's and ours is 4 N^2, 0.4% at f/8, is undone here; its h and c have more digits (7e-5).
    """
    camera = load_camera(name)
    fine = np.arange(400.0, 700.05, 0.1)
    letter = next(iter(camera.channels))
    table = np.genfromtxt(PACKAGED / f"{name.replace('420', '200')}.csv", delimiter=",", names=True)
    energy = name != "pxl1300l"
    if energy:
        column = {"R": "red", "top": "blue"}[letter]
        grid = table["wavelength_nm"]
        curves = {c: np.interp(fine, grid, table[c]) / fine for c in ("red", "green", "blue")}
        peak = {
            "dcs200": 0.25,
            "dcs420": 0.25,
            "nikon-d5100": 0.45,
            "sigma-sd-merrill": 0.4,
            "sony-a7r2": 0.5,
        }[name]
        dense = np.arange(grid[0], grid[-1])
        highest = max((np.interp(dense, grid, table[c]) / dense).max() for c in ("red", "green", "blue"))
        efficiency = peak * curves[column] / highest
    else:
        filters = np.genfromtxt(PACKAGED / "pxl1300l-filters.csv", delimiter=",", names=True)
        grid = table["wavelength_nm"]
        efficiency = np.interp(fine, grid, table["quantum_efficiency"] * table["lens"]) * np.interp(
            fine, filters["wavelength_nm"], filters[letter]
        )
    radiance = 1e-4 * planck(fine, 3000.0)
    photons = np.pi * radiance * fine * 1e-9 / (6.62607015e-34 * 299792458.0) / (1 + 4 * camera.f_number**2)
    area = (camera.pixel_pitch_um * 1e-6) ** 2
    per_second = np.trapezoid(photons * efficiency, fine) * area
    per_second *= (1 + 4 * camera.f_number**2) / (4 * camera.f_number**2)
    sampled = cube(np.broadcast_to(1e-4 * planck(WAVELENGTH, 3000.0), (2, 2, 31)))
    # a 10 nm cube through a 12 nm filter is not that light: the fine cube is
    if not energy:
        sampled = xr.Dataset(
            {"radiance": (("y", "x", "wavelength"), np.broadcast_to(radiance[::10], (2, 2, 301)))},
            coords={"wavelength": fine[::10]},
        )
    channel = letter if camera.pattern is None else None
    assert expected_electrons(sampled, camera, 1.0, channel)[0, 0] == pytest.approx(per_second, rel=1e-3)


# ---- bases ----


def test_components_give_the_cube_back_and_their_error_falls_to_rounding():
    field = chart_cube(2)
    errors = [spectral_error(field, to_basis(field, principal_components(field, count))) for count in (1, 3, 8, 31)]
    assert errors == sorted(errors, reverse=True)
    assert errors[1] < 0.1 and errors[2] < 0.01 and errors[3] < 1e-12
    basis = principal_components(field, 8)
    np.testing.assert_allclose(basis.vectors @ basis.vectors.T, np.eye(8), atol=1e-12)
    variance = field["radiance"].values.reshape(-1, 31).var(axis=0).sum()
    missed = (field["radiance"] - from_basis(to_basis(field, basis))["radiance"]).values
    assert 1 - (missed**2).sum(axis=-1).mean() / variance == pytest.approx(basis.explained, rel=1e-9)


@pytest.mark.parametrize("blur", [None, Blur(np.array([400.0, 700.0]), np.array([0.5, 1.0]), np.array([1.0, 2.0]))])
def test_simulation_from_coefficients_equals_the_full_path(tmp_path, blur):
    camera = dataclasses.replace(load_camera("dcs200"), blur=blur)
    coefficients = to_basis(chart_cube(20), principal_components(chart_cube(20), 8))
    full = from_basis(coefficients).clip(min=0)
    expected = expected_electrons(full, camera, 1.0)
    np.testing.assert_allclose(expected_electrons(coefficients, camera, 1.0), expected, rtol=1e-10)
    write_cube(tmp_path / "c.nc", coefficients)
    with open_cube(tmp_path / "c.nc") as opened:
        np.testing.assert_array_equal(
            simulate_frame(opened, camera, 0.1, 1), simulate_frame(coefficients, camera, 0.1, 1)
        )


def test_a_basis_of_other_wavelengths_is_reported():
    basis = principal_components(chart_cube(1), 3)
    with pytest.raises(InputError, match="400 to 600 nm in 21"):
        to_basis(chart_cube(1).sel(wavelength=slice(400, 600)), basis)
    with pytest.raises(InputError, match="1 to 31"):
        principal_components(chart_cube(1), 32)


# ---- after the sensor ----


def test_the_correction_is_the_lmmse_formula_and_exact_for_a_camera_that_sees_as_the_eye_does():
    reflectance, light = chart_reflectances(), TUNGSTEN.at(WAVELENGTH_NM)
    observer = colour_matching_functions()
    xyz = (reflectance * light) @ observer.T / (light @ observer[1])
    mixed = xyz @ np.array([[80.0, 10, 5], [30, 90, 20], [5, 20, 60]])
    np.testing.assert_allclose(fit_correction(mixed, reflectance, TUNGSTEN).xyz(mixed), xyz, rtol=1e-9)
    variance = np.array([1.0, 2.0, 4.0])
    formula = xyz.T @ mixed @ np.linalg.inv(mixed.T @ mixed + 24 * np.diag(variance))
    np.testing.assert_allclose(fit_correction(mixed, reflectance, TUNGSTEN, variance).matrix, formula, rtol=1e-9)


def test_a_flat_mosaic_frame_comes_out_of_demosaicing_as_it_was():
    camera = load_camera("dcs200")
    colour = np.array([100.0, 150.0, 50.0])
    frame = colour[channel_map(("RG", "GB"), ("R", "G", "B"), (12, 12))]
    np.testing.assert_allclose(
        demosaic(frame, camera, 255.0)[2:-2, 2:-2], np.broadcast_to(colour, (8, 8, 3)), atol=3e-3
    )
    assert linear_counts(13.54, camera, 1.0) == pytest.approx(0, abs=0.01)


# ---- output ----


@pytest.mark.parametrize("name", ["dcs200", "dcs420", "nikon-d5100", "sony-a7r2", "pxl1300l"])
def test_a_raw_converter_opens_the_dng(tmp_path, name):
    """LibRaw finds the counts, black, white and mosaic as they were, and develops white to neutral."""
    rawpy = pytest.importorskip("rawpy", reason="needs rawpy (LibRaw), a development extra")
    camera = load_camera(name)
    channel = None if camera.pattern else "f550"
    field = cube(np.broadcast_to(1e-4 * planck(WAVELENGTH, 3000.0), (64, 96, 31)))
    exposure = auto_exposure(field, camera, channel)
    counts = simulate_frame(field, camera, exposure, 1, channel)
    write_dng(tmp_path / "a.dng", counts, camera, exposure, TUNGSTEN)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        stored = counts.astype(float)
        detector = camera.detector
        scale = {"dcs200": 257, "dcs420": 65535 / 4095}.get(name, 1)  # by a linearisation table
        np.testing.assert_array_equal(raw.raw_image_visible, np.rint(detector.linearise(stored) * scale))
        assert raw.black_level_per_channel[0] == pytest.approx(detector.dark(exposure)[0] * scale, abs=1)
        assert raw.white_level == (65535 if scale != 1 else detector.full_scale_dn)
        if camera.pattern is None:
            return
        assert "".join(chr(raw.color_desc[i]) for i in raw.raw_pattern.ravel()) == "RGGB"
        rgb = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1))
        means = rgb[10:-10, 10:-10].reshape(-1, 3).mean(axis=0)
        assert np.ptp(means) < 0.01 * means.mean()


@pytest.mark.parametrize("name", ["pxl1300l", "sony-a7r2"])
def test_a_capture_of_a_cube_loads_and_shows_the_cameras_gain_and_noise(tmp_path, name):
    """Photon transfer of the frames returns what was put in, within five standard errors."""
    camera = load_camera(name)
    if name == "pxl1300l":
        camera = dataclasses.replace(camera, channels={k: camera.channels[k] for k in ("f500", "f600")})
    write_cube_capture(tmp_path / "c", chart_cube(16), camera, None, 3, "chart")
    capture = load_capture(tmp_path / "c")
    noise = measure_noise(capture, read_darks(capture))
    detector = camera.detector
    assert noise.gain_e_per_dn == pytest.approx(detector.gain_e_per_dn, abs=5 * noise.gain_sigma)
    shortest = min(table.exposure_s for table in capture.manifest.darks)
    expected = detector.dark(shortest)[1] * detector.gain_e_per_dn
    assert noise.read_noise_e == pytest.approx(expected, abs=5 * noise.read_noise_sigma)
    again = tmp_path / "again"
    write_cube_capture(again, chart_cube(16), camera, None, 3, "chart")
    for path in sorted((tmp_path / "c" / "frames").iterdir()):
        np.testing.assert_array_equal(read_raw(path)[0], read_raw(again / "frames" / path.name)[0])


def test_a_capture_holds_the_cubes_light_by_the_formats_own_equation(tmp_path):
    camera = load_camera("pxl1300l")
    camera = dataclasses.replace(camera, channels={k: camera.channels[k] for k in ("f500", "f600")})
    field = cube(np.broadcast_to(1e-4 * planck(WAVELENGTH, 3000.0), (64, 64, 31)))
    write_cube_capture(tmp_path / "c", field, camera, None, 3, "field")
    capture = load_capture(tmp_path / "c")
    dark = read_darks(capture)
    radiance = np.interp(WAVELENGTH_NM, WAVELENGTH, field["radiance"].values[0, 0])
    for band, response in zip(capture.manifest.band, band_responses(capture, nominal_constant(capture)), strict=True):
        counts = capture.frames(band).mean() - dark.at(band.exposure_s).mean()
        expected = response.signal(radiance)
        assert counts == pytest.approx(expected, rel=3e-4)


@pytest.mark.parametrize(
    ("pattern", "frames_as"),
    [
        (("RG", "GB"), "dng"),
        (("GB", "RG"), "tif"),
        (("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"), "tif"),
        (("RRGG", "RRGG", "GGBB", "GGBB"), "tif"),
    ],
)
def test_a_colour_cameras_frames_stand_in_a_band_for_each_channel(tmp_path, pattern, frames_as):
    """Every band's pixels hold the light of its channel; raw files state pattern, exposure and black level."""
    camera = dataclasses.replace(load_camera("sony-a7r2"), pattern=pattern)
    field = cube(np.broadcast_to(1e-4 * planck(WAVELENGTH, 3000.0), (66, 66, 31)))
    write_cube_capture(tmp_path / "c", field, camera, None, 3, "field", frames_as)
    capture = load_capture(tmp_path / "c")
    assert capture.band_ids == ("r", "g", "b")
    assert len({band.frames for band in capture.manifest.band}) == 1
    dark, channels = read_darks(capture), band_channels(capture)
    radiance = np.interp(WAVELENGTH_NM, WAVELENGTH, field["radiance"].values[0, 0])
    responses = band_responses(capture, nominal_constant(capture), channels)
    for band, response in zip(capture.manifest.band, responses, strict=True):
        mask = channel_mask(capture.manifest.mosaic.pattern, capture.shape, band.channel)
        counts = (capture.frames(band).mean(axis=0) - dark.at(band.exposure_s))[mask].mean()
        assert counts == pytest.approx(response.signal(radiance), rel=1e-3)
    assert not file_mosaic_notes(capture)
    if frames_as == "dng":
        facts = frame_header(tmp_path / "c" / capture.manifest.band[0].frames[0]).facts
        assert facts.pattern == "RGGB" and facts.black_level["G"] == pytest.approx(512, abs=0.1)
        assert facts.exposure_s == pytest.approx(capture.manifest.band[0].exposure_s, rel=1e-3)


def test_a_capture_of_a_nonlinear_camera_is_refused(tmp_path):
    with pytest.raises(InputError, match="static nonlinearity"):
        write_cube_capture(tmp_path / "c", chart_cube(4), load_camera("dcs420"), None, 1, "chart")
    assert not list(tmp_path.iterdir())


def run(*arguments) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return int(caught.value.code or 0)


def test_several_cubes_and_every_output_of_the_command(tmp_path, capsys):
    for name in ("one", "two"):
        write_cube(tmp_path / f"{name}.nc", chart_cube(4))
    cubes = tmp_path / "one.nc", tmp_path / "two.nc"
    assert run("simulate", *cubes, "--out", tmp_path / "raw" / "{name}.tif", "--exposure", "1/30") == 0
    frames = [read_raw(tmp_path / "raw" / f"{name}.tif")[0] for name in ("one", "two")]
    assert not np.array_equal(*frames)  # noise is drawn for each
    assert run("simulate", cubes[1], "--out", tmp_path / "b.tif", "--exposure", "1/30", "--seed", 1) == 0
    np.testing.assert_array_equal(read_raw(tmp_path / "b.tif")[0], frames[1])
    assert run("simulate", cubes[0], "--out", tmp_path / "a.dng", "--camera", "nikon-d5100") == 0
    assert (tmp_path / "a.dng").stat().st_size > 2 * 16 * 24
    assert run("simulate", cubes[0], "--out", tmp_path / "capture", "--f-number", "4") == 0
    assert load_capture(tmp_path / "capture").band_ids == ("r", "g", "b")
    capsys.readouterr()
    for arguments, phrase in (
        ((*cubes, "--out", tmp_path / "x.tif"), "{name}"),
        ((cubes[0], "--out", tmp_path / "x.jpg"), "x.jpg"),
        ((cubes[0], "--out", tmp_path / "x", "--channel", "R"), "--channel"),
        ((cubes[0], "--out", tmp_path / "x.tif", "--f-number", "-2"), "--f-number"),
        ((cubes[0], "--out", tmp_path / "x.dng", "--camera", "sigma-sd-merrill"), "top, middle, bottom"),
    ):
        assert run("simulate", *arguments) == 2
        assert phrase in capsys.readouterr().err
    assert not [path for path in tmp_path.iterdir() if path.name.startswith("x")]


def test_a_camera_of_ones_own_is_one_toml_and_one_csv(tmp_path):
    """Four classes of sensors, with their own letters, in a repeating 2 x 3 pattern."""
    rows = "".join(f"{w},0.1,0.2,0.3,0.4\n" for w in range(400, 701, 50))
    (tmp_path / "my.csv").write_text("wavelength_nm,a,b,c,d\n" + rows)
    (tmp_path / "my.toml").write_text(
        'name = "mine"\nsource = "a test"\n'
        "[detector]\nbit_depth = 12\ngain_e_per_dn = 10\n"
        "[dark]\nexposure_s = [1]\nmean_dn = [100]\nsigma_dn = [1]\n"
        "[optics]\npixel_pitch_um = 5\nworking_f_number = 4\n"
        '[sensitivity]\nkind = "quantum_efficiency"\n'
        '[channel]\nA = "my.csv:a"\nB = "my.csv:b"\nC = "my.csv:c"\nD = "my.csv:d"\n'
        '[mosaic]\npattern = ["ABC", "DCA"]\n'
    )
    write_cube(tmp_path / "one.nc", cube(np.full((70, 9, 31), 1e-3)))
    arguments = ("simulate", tmp_path / "one.nc", "--out", tmp_path / "raw.tif")
    assert run(*arguments, "--camera", tmp_path / "my.toml") == 0
    electrons = expected_electrons(cube(np.full((70, 9, 31), 1e-3)), load_camera(tmp_path / "my.toml"), 1.0)
    np.testing.assert_allclose(electrons[64:66, :3] / electrons[0, 0], [[1, 2, 3], [4, 3, 1]], rtol=1e-12)
