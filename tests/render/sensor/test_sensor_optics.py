"""Blur, vignetting, leakage, blooming, fixed pattern, and frames computed block by block."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.files.cube_files import open_cube, write_cube
from cboxlab.rendering.sensor import light as sensor_light
from cboxlab.rendering.sensor.cameras import PACKAGED, load_camera
from cboxlab.rendering.sensor.charge import leak, spill_columns
from cboxlab.rendering.sensor.optics import Blur, Vignetting
from cboxlab.rendering.sensor.simulation import expected_electrons, noiseless_frame, simulate_frame
from cboxlab.utils.errors import InputError

WAVELENGTH = np.arange(400.0, 701.0, 10.0)
BLUR = Blur(np.array([400.0, 700.0]), np.array([0.8, 1.2]), np.array([1.5, 3.0]))


def cube(radiance) -> xr.Dataset:
    return xr.Dataset(
        {"radiance": (("y", "x", "wavelength"), radiance, {"units": "W m^-2 sr^-1 nm^-1"})},
        coords={"wavelength": ("wavelength", WAVELENGTH, {"units": "nm"})},
    )


def random_cube(shape, seed=1) -> xr.Dataset:
    return cube(1e-4 * np.random.default_rng(seed).random((*shape, 31)).astype(np.float32))


def mono(**changes):
    return dataclasses.replace(load_camera("pxl1300l"), **changes)


def point(shape, position) -> xr.Dataset:
    radiance = np.zeros((*shape, 31))
    radiance[position] = 1e-3
    return cube(radiance)


def moments(image) -> tuple[float, float, float]:
    """Sum, and variance in px^2 along y and x."""
    y, x = np.indices(image.shape)
    total = image.sum()
    centre = (y * image).sum() / total, (x * image).sum() / total
    return total, ((y - centre[0]) ** 2 * image).sum() / total, ((x - centre[1]) ** 2 * image).sum() / total


@pytest.mark.parametrize(("channel", "wavelength"), [("f450", 450), ("f650", 650)])
@pytest.mark.parametrize("position", [(40, 60), (20, 90), (12, 108)])
def test_a_point_spreads_by_its_wavelength_and_field_height_and_keeps_its_light(channel, wavelength, position):
    """Variance linear in the square of the field height, sigma linear in wavelength; the sum is conserved.

    2%: the filter's width mixes wavelengths, and sampled Gaussians are cut at four sigma.
    """
    shape = (81, 121)
    camera, sharp = mono(blur=BLUR), mono()
    height = np.hypot(position[0] - 40, position[1] - 60) / np.hypot(40, 60)
    centre, corner = (np.interp(wavelength, BLUR.wavelength_nm, t) for t in (BLUR.centre_px, BLUR.corner_px))
    expected = centre**2 + (corner**2 - centre**2) * height**2
    total, along_y, along_x = moments(expected_electrons(point(shape, position), camera, 1.0, channel))
    assert total == pytest.approx(expected_electrons(point(shape, position), sharp, 1.0, channel).sum(), rel=1e-12)
    assert along_y == pytest.approx(expected, rel=0.02)
    assert along_x == pytest.approx(expected, rel=0.02)


def test_a_uniform_field_stays_uniform_behind_a_blur_that_does_not_vary_over_the_field():
    field = cube(np.full((40, 50, 31), 1e-4))
    even = Blur(np.array([400.0, 700.0]), np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    blurred = expected_electrons(field, mono(blur=even), 1.0, "f550")
    np.testing.assert_allclose(blurred, expected_electrons(field, mono(), 1.0, "f550"), rtol=1e-12)


def test_no_blur_no_fall_off_no_leak_is_the_identity():
    field = random_cube((20, 30))
    nothing = Blur(np.array([550.0]), np.zeros(1), np.zeros(1))
    flat = Vignetting(np.array([0.0, 1.0]), np.ones(2))
    plain = expected_electrons(field, mono(), 1.0, "f550")
    electrons = expected_electrons(field, mono(blur=nothing, vignetting=flat), 1.0, "f550")
    np.testing.assert_allclose(electrons, plain, rtol=1e-6)  # the blurred way is in double precision
    np.testing.assert_array_equal(leak(plain, 0.0, 0.0), plain)


def test_vignetting_is_its_table_by_field_height():
    field = cube(np.full((41, 61, 31), 1e-4))
    fall = Vignetting(np.array([0.0, 0.5, 1.0]), np.array([1.0, 0.9, 0.5]))
    ratio = expected_electrons(field, mono(vignetting=fall), 1.0, "f550") / expected_electrons(
        field, mono(), 1.0, "f550"
    )
    assert ratio[20, 30] == pytest.approx(1.0)
    np.testing.assert_allclose(ratio[[0, 0, -1, -1], [0, -1, 0, -1]], 0.5)
    assert ratio[20, 60] == pytest.approx(np.interp(30 / np.hypot(20, 30), [0, 0.5, 1], [1, 0.9, 0.5]))


def test_leakage_moves_charge_and_loses_none():
    field = np.random.default_rng(2).random((30, 40)) * 1000
    assert leak(field, 0.02, 0.05).sum() == pytest.approx(field.sum(), rel=1e-13)
    spot = np.zeros((5, 5))
    spot[2, 2] = 1.0
    expected = np.zeros((5, 5))
    expected[2, 1:4] = (0.02, 0.86, 0.02)
    expected[1, 2] = expected[3, 2] = 0.05
    np.testing.assert_allclose(leak(spot, 0.02, 0.05), expected, atol=1e-15)


def test_blooming_keeps_every_electron_and_no_pixel_over_its_well():
    generator = np.random.default_rng(3)
    for scale in (500, 1500, 4000):
        charge = generator.random((50, 20)) * scale
        charge_after, lost = spill_columns(charge, 1000.0)
        assert charge_after.max() <= 1000
        assert charge_after.sum() + lost == pytest.approx(charge.sum(), rel=1e-12)
        if scale == 500:
            np.testing.assert_array_equal(charge_after, charge)
    streak = np.zeros((9, 3))
    streak[4, 1] = 5000
    charge_after, lost = spill_columns(streak, 1000.0)
    assert lost == 0
    np.testing.assert_array_equal(charge_after[:, 1], [0, 0, 1000, 1000, 1000, 1000, 1000, 0, 0])
    assert charge_after[:, [0, 2]].sum() == 0


def test_a_blooming_camera_draws_a_streak_where_a_drain_clips():
    bright = cube(np.zeros((21, 5, 31)))
    bright["radiance"][10, 2] = 1.0
    camera = mono()
    drain = dataclasses.replace(camera.detector, full_well_e=40_000.0)
    electrons = expected_electrons(bright, camera, 1.0, "f550")[10, 2]
    exposure = 5 * 40_000 / electrons
    for blooms, saturated in ((False, 1), (True, 5)):
        changed = dataclasses.replace(camera, detector=dataclasses.replace(drain, blooms=blooms))
        for frame in (
            simulate_frame(bright, changed, exposure, 1, "f550"),
            noiseless_frame(bright, changed, exposure, "f550"),
        ):
            assert (frame[:, 2] > 3000).sum() == saturated
            assert (frame[:, [0, 1, 3, 4]] < 300).all()


def test_the_fixed_pattern_is_in_every_frame_and_as_large_as_stated():
    """Mean of two frames minus what noise leaves; spreads within five standard errors."""
    field = cube(np.full((128, 128, 31), 2e-5))
    camera = mono()
    detector = dataclasses.replace(camera.detector, sensitivity_spread=0.05, offset_spread_dn=3.0, pattern_seed=4)
    camera = dataclasses.replace(camera, detector=detector)
    frames = [simulate_frame(field, camera, 2.0, seed, "f550").astype(float) for seed in (1, 2)]
    common = np.cov(frames[0].ravel(), frames[1].ravel())
    signal = noiseless_frame(field, camera, 2.0, "f550")[0, 0] - camera.detector.dark(2.0)[0]
    expected = (0.05 * signal) ** 2 + 3.0**2
    # the covariance of two frames with this common part has about sqrt((c^2 + v^2) / n) of error
    assert common[0, 1] == pytest.approx(expected, abs=5 * np.hypot(expected, common[0, 0]) / 128)


def everything():
    camera = load_camera("dcs200")
    detector = dataclasses.replace(
        camera.detector,
        leakage=(0.02, 0.03),
        sensitivity_spread=0.02,
        offset_spread_dn=0.5,
        full_well_e=60_000.0,
        blooms=True,
    )
    fall = Vignetting(np.array([0.0, 1.0]), np.array([1.0, 0.6]))
    return dataclasses.replace(camera, detector=detector, blur=BLUR, vignetting=fall)


@pytest.mark.parametrize("rows", [7, 32])
def test_blocks_of_any_height_give_the_same_electrons(monkeypatch, rows):
    field = random_cube((75, 33))
    monkeypatch.setattr(sensor_light, "BLOCK_ROWS", 1000)
    complete = expected_electrons(field, everything(), 1.0)
    monkeypatch.setattr(sensor_light, "BLOCK_ROWS", rows)
    np.testing.assert_allclose(expected_electrons(field, everything(), 1.0), complete, rtol=1e-12)


def test_a_cube_on_disk_is_read_block_by_block(tmp_path):
    """A frame from the file equals that from memory, and takes a fraction of the cube's memory."""
    field = random_cube((1024, 96))
    camera = load_camera("dcs200")
    expected = simulate_frame(field, camera, 5.0, seed=3)
    size = field["radiance"].nbytes
    for ending in (".nc", ".hdr"):
        write_cube(tmp_path / f"cube{ending}", field)
        with open_cube(tmp_path / f"cube{ending}") as opened:
            simulate_frame(opened.isel(y=slice(0, 64)), camera, 5.0, seed=3)  # imports and caches of the libraries
            tracemalloc.start()
            frame = simulate_frame(opened, camera, 5.0, seed=3)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        np.testing.assert_array_equal(frame, expected)
        assert peak < 0.4 * size, f"{ending}: {peak / 2**20:.1f} of {size / 2**20:.1f} MiB"


def test_a_seed_gives_the_same_frame_whatever_the_camera_does():
    field = random_cube((130, 20))
    frames = [simulate_frame(field, everything(), 5.0, seed) for seed in (1, 1, 2)]
    assert np.array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


def test_a_smaller_aperture_takes_light_by_the_square():
    field, camera = random_cube((8, 8)), load_camera("dcs200")
    stopped = expected_electrons(field, camera.at_f_number(16.0), 1.0)
    np.testing.assert_allclose(stopped, expected_electrons(field, camera, 1.0) / 4, rtol=1e-12)


def test_a_camera_file_states_optics_and_charge(tmp_path):
    text = (PACKAGED / "dcs200.toml").read_text()
    (tmp_path / "dcs200.csv").write_text((PACKAGED / "dcs200.csv").read_text())
    more = (
        "[blur]\nwavelength_nm = [400, 700]\ncentre_px = [0.8, 1.2]\ncorner_px = [1.5, 3.0]\n"
        "[vignetting]\nfield = [0, 1]\nillumination = [1.0, 0.6]\n"
        "[leakage]\nrow = 0.02\ncolumn = 0.03\n"
        "[fixed_pattern]\nsensitivity_spread = 0.02\noffset_spread_dn = 0.5\n"
    )
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("[dark]", 'full_well_e = 6e4\noverflow = "column"\n[dark]') + more)
    field = random_cube((70, 30))
    np.testing.assert_array_equal(
        simulate_frame(field, load_camera(path), 5.0, 1), simulate_frame(field, everything(), 5.0, 1)
    )
    path.write_text(text.replace("[dark]", 'overflow = "column"\n[dark]'))
    with pytest.raises(InputError, match=r"detector\.full_well_e"):
        load_camera(path)
    path.write_text(text + "[blur]\nwavelength_nm = [400, 700]\ncentre_px = [0.8]\ncorner_px = [1.5, 3.0]\n")
    with pytest.raises(InputError, match="columns of equal length"):
        load_camera(path)
