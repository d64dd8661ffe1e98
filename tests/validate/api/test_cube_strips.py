"""A cube rendered by strips of rows is the cube rendered at once, within noise, in every format and at the seams."""

import re
import tempfile
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.files import RADIANCE_UNIT, read_cube
from cboxlab.rendering.files.cube_strips import strip_cameras
from cboxlab.rendering.integrators import passes, precision
from cboxlab.rendering.integrators.passes import render_pass
from cboxlab.rendering.integrators.precision import BATCHES
from cboxlab.rendering.photometry import tristimulus_weights
from cboxlab.scenes import cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.api import CubeSettings, cube, render, render_file
from cboxlab.validation.api.strip_files import load_strip, store_strip
from helpers.scenes.boxes import BANDS

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators"),
    pytest.mark.usefixtures("large_patches"),
]

#: Rows of a strip in place of 64.
ROWS = 32
SIZE = ROWS + 24
SETTINGS = CubeSettings(np.asarray(BANDS), samples=32, seed=3)
small_strips = partial(strip_cameras, rows=ROWS)


@pytest.fixture(autouse=True, scope="module")
def every_cube_in_small_strips():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cube, "LARGEST_IN_MEMORY", 0)
        patch.setattr(cube, "strip_cameras", small_strips)
        yield


@pytest.fixture(scope="module")
def by_strips(tmp_path_factory):
    path = tmp_path_factory.mktemp("strips") / "a.nc"
    notes = render_file(path, None, cornell_camera(SIZE), SETTINGS).notes
    return read_cube(path), notes


def test_strips_agree_with_the_whole_picture(by_strips):
    """Rows from the same patches, with other random numbers below the first strip: the first strip is the whole
    picture's to the rounding of its camera; below it differences are as large as the errors say (a variance of
    8 batches each: F(1, 14), of mean 14/12)."""
    strips, notes = by_strips
    cube = render(None, wavelengths=BANDS, camera=cornell_camera(SIZE), samples=32, seed=3).cube
    difference = (strips["radiance"] - cube["radiance"]).values
    variance = (strips["standard_error"] ** 2 + cube["standard_error"] ** 2).values
    assert np.abs(difference[:ROWS]).max() < 1e-3 * float(cube["radiance"].max())
    below = variance > 0
    below[:ROWS] = False
    assert np.any(difference[below] != 0)
    assert np.mean(difference[below] ** 2 / variance[below]) == pytest.approx(14 / 12, rel=0.15)
    across = difference[ROWS].sum(axis=0) / np.sqrt(variance[ROWS].sum(axis=0))
    assert np.abs(across).max() < 4
    alone = [
        render(None, wavelengths=BANDS, camera=part, samples=32, seed=3) for part in small_strips(cornell_camera(SIZE))
    ]
    expected = np.median([a.standard_error for a in alone]), max(a.standard_error_99 for a in alone)
    assert [float(n) / 100 for n in re.findall(r"([\d.]+)%", notes[0])] == pytest.approx(expected, rel=0.1)


def test_an_interrupted_cube_goes_on_after_its_last_strip(by_strips, tmp_path, monkeypatch):
    """Stopped in the second strip: the first is rendered again only if damaged; the cube is the same to the bit."""
    rendered = []

    def watched(job, report=None):
        rendered.append(job.camera.height_px)
        if stop and job.camera.height_px < ROWS:
            raise KeyboardInterrupt
        return render_pass(job, report)

    monkeypatch.setattr(precision, "render_pass", watched)
    out, stop = tmp_path / "b.nc", True
    strips = tmp_path / "b.nc.strips"
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            render_file(out, None, cornell_camera(SIZE), SETTINGS)
        assert rendered.count(ROWS) == BATCHES and not out.exists()
    (strips / "0").write_bytes(b"broken" + (strips / "0").read_bytes())
    stop = False
    render_file(tmp_path / "c.nc", None, cornell_camera(SIZE), replace(SETTINGS, seed=4))
    (tmp_path / "d.nc.strips").mkdir()
    (tmp_path / "d.nc.strips" / "0").write_bytes((strips / "0").read_bytes().removeprefix(b"broken"))
    render_file(tmp_path / "d.nc", None, cornell_camera(SIZE), replace(SETTINGS, seed=4))
    assert read_cube(tmp_path / "d.nc").identical(read_cube(tmp_path / "c.nc"))  # not another picture's strip
    rendered.clear()
    notes = render_file(out, None, cornell_camera(SIZE), SETTINGS).notes
    assert rendered.count(ROWS) == BATCHES
    assert read_cube(out).identical(by_strips[0]) and notes == by_strips[1]
    assert not strips.exists()


def test_luminances_by_strips_are_those_of_the_strips_pixels(tmp_path, monkeypatch):
    """Also where the first strip was kept; illuminances are those of the whole picture's patches."""
    grid = np.linspace(400, 700, 10)
    settings = CubeSettings(grid, samples=1, seed=3)
    passes = tmp_path / "kept.nc"
    photometry = render_file(tmp_path / "a.nc", None, cornell_camera(SIZE), settings).photometry

    def stopped(job, report=None):
        if job.camera.height_px < ROWS:
            raise KeyboardInterrupt
        return render_pass(job, report)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(precision, "render_pass", stopped)
        render_file(passes, None, cornell_camera(SIZE), settings)
    again = render_file(passes, None, cornell_camera(SIZE), settings).photometry
    assert again.to_dict() == photometry.to_dict()
    radiance = read_cube(tmp_path / "a.nc")["radiance"].values
    mean = radiance.mean(axis=(0, 1)) @ tristimulus_weights(grid)
    assert photometry.picture.pixels == SIZE**2 and photometry.picture.xyz == pytest.approx(mean, rel=1e-5)
    assert photometry.illuminance("back") > photometry.illuminance("ceiling") > 0


def test_strips_share_one_radiosity_solution_but_no_random_numbers(tmp_path, monkeypatch):
    solutions, numbers = [], []
    solve = passes.solve_light
    monkeypatch.setattr(
        passes, "solve_light", lambda *arguments, **more: solutions.append(1) or solve(*arguments, **more)
    )
    monkeypatch.setattr(
        precision, "render_pass", lambda job, report: numbers.append(job.first_batch) or render_pass(job, report)
    )
    render_file(tmp_path / "a.nc", None, cornell_camera(SIZE), replace(SETTINGS, seed=8))
    assert len(solutions) == 1
    assert len(set(numbers)) == len(numbers) == 2 * BATCHES


def test_other_formats_hold_the_same_strips(by_strips, tmp_path):
    render_file(tmp_path / "a.exr", None, cornell_camera(SIZE), SETTINGS)
    exr, strips = read_cube(tmp_path / "a.exr"), by_strips[0]
    assert exr["radiance"].values == pytest.approx(strips["radiance"].values, rel=1e-6)


def test_strips_take_room_next_to_the_cube_only(tmp_path, monkeypatch):
    """The folder for temporary files may be small, and what a killed process leaves there is never removed."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    strip = xr.Dataset(
        {"radiance": (("y", "x", "wavelength"), np.ones((2, 3, 1), np.float32), {"units": RADIANCE_UNIT})},
        {"wavelength": ("wavelength", [500.0], {"units": "nm"})},
    )
    strip_folder = tmp_path / "cube.nc.strips" / "0"
    store_strip(strip_folder, "made from this", strip)
    back = load_strip(strip_folder, "made from this")
    assert back is not None and np.array_equal(back["radiance"], strip["radiance"])
    assert [path.name for path in strip_folder.parent.iterdir()] == ["0"]


def test_a_camera_that_looks_away_gives_a_black_picture_and_says_so(tmp_path):
    away = replace(cornell_camera(16), position_mm=np.array([278.0, 273.0, 5000.0]))
    image = render(wavelengths=BANDS, camera=away, samples=4)
    assert not image.cube["radiance"].values.any() and "sees no lit surface" in image.notes()[0]
    assert "sees no lit surface" in render_file(tmp_path / "a.nc", None, away, SETTINGS).notes[0]


@pytest.mark.parametrize("noise", [-1.0, 0.0, np.nan])
def test_noise_is_above_0(noise):
    with pytest.raises(InputError, match="noise"):
        render(wavelengths=[550], size=16, noise=noise)
