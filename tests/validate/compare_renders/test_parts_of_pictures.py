"""Cubes of few pixels, and parts of pictures: compared where both have pixels, or refused in one line."""

import numpy as np
import OpenEXR
import pytest
from cboxlab.rendering.files import Window, write_cube
from cboxlab.rendering.files.cube_checks import as_cube
from cboxlab.rendering.files.headers import with_window
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders import compare_stacks, read_stack
from cboxlab.validation.compare_renders.regress import regress_inputs
from cboxlab.validation.predict.external_picture import external_picture
from helpers.faults import fault_folder

NM = [400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0]
LIGHT = np.random.default_rng(2).random((32, 64, 7)).astype(np.float32) * 0.05 + 1.0


def compared(a, b):
    return compare_stacks(read_stack(a), read_stack(b))


def stored(path, values, window=None):
    write_cube(path, with_window(as_cube(values, NM), window))
    return path


@pytest.mark.parametrize("size", ["1x1", "1x40", "40x1"])
def test_the_faults_own_small_cubes(tmp_path, size):
    a, b = (fault_folder("one-row-cube", tmp_path / name) / f"s_{size}_{name}.nc" for name in "ab")
    assert all(np.isfinite(row.relative_mean) for row in compared(a, b).rows)
    with pytest.raises(InputError, match="3 x 3 px or more"):
        regress_inputs(str(a), str(b))


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (1, 40), (40, 1), (2, 2), (2, 40), (40, 2), (3, 3), (3, 1)])
@pytest.mark.parametrize("error", [False, True])
def test_cubes_of_few_pixels_are_compared(tmp_path, shape, error):
    cubes = []
    for seed in (1, 2):
        noise = np.random.default_rng(seed).standard_normal((*shape, 7))
        cube = as_cube(1 + 0.01 * noise, NM)
        if error:
            sigma = np.full((*shape, 7), 0.01)
            cube["standard_error"] = (("y", "x", "wavelength"), sigma, {"units": "W m^-2 sr^-1 nm^-1", "batches": 8})
        write_cube(tmp_path / f"{seed}.nc", cube)
        cubes.append(tmp_path / f"{seed}.nc")
    rows = compared(*cubes).rows
    assert len(rows) == 7
    assert all(abs(row.relative_mean) < 0.1 and row.pixels == shape[0] * shape[1] for row in rows)
    try:
        regress_inputs(str(cubes[0]), str(cubes[1]))
    except InputError as fault:
        assert min(shape) < 3 or shape == (3, 3)
        assert "\n" not in str(fault) and ("3 x 3 px" in str(fault) or "12 pixels" in str(fault))
    else:
        assert shape not in ((1, 1), (1, 40), (40, 1))


def test_a_single_pixel_in_colour(tmp_path):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {n: np.ones((1, 1), np.float32) for n in "XYZ"}) as file:
        file.write(str(tmp_path / "a.exr"))
    assert len(compared(tmp_path / "a.exr", tmp_path / "a.exr").rows) == 3


def test_the_faults_own_crops_are_compared_where_both_have_pixels(tmp_path):
    folder = fault_folder("exr-data-window", tmp_path)
    comparison = compared(folder / "dw0.exr", folder / "dw20.exr")
    assert comparison.first.values.shape[1:] == (32, 20)
    assert any("20 x 32 pixels that both have: x 20 to 39, y 0 to 31" in note for note in comparison.notes)
    assert max(abs(row.relative_mean) for row in comparison.rows) > 0.01  # the same numbers lie 20 px apart
    assert not regress_inputs(str(folder / "dw0.exr"), str(folder / "dw20.exr")).same


@pytest.mark.parametrize("ending", [".exr", ".nc"])
@pytest.mark.parametrize("crop", [(0, 0, 40, 32), (20, 0, 40, 32), (10, 5, 20, 20), (63, 31, 1, 1)])
def test_a_crop_equals_its_pixels_of_the_complete_picture(tmp_path, ending, crop):
    x_px, top, width, height = crop
    part = Window(*crop, (0, 0, 64, 32))
    a = stored(tmp_path / f"a{ending}", LIGHT[top : top + height, x_px : x_px + width], part)
    b = stored(tmp_path / "b.nc", LIGHT)
    for first, second in ((a, b), (b, a)):
        comparison = compared(first, second)
        assert all(row.pixels == width * height and row.relative_rms == 0 for row in comparison.rows)
    if width > 3:
        assert regress_inputs(str(a), str(b)).same


def test_two_crops_of_one_picture_are_the_same_where_they_meet(tmp_path):
    a = stored(tmp_path / "a.exr", LIGHT[:, :40], Window(0, 0, 40, 32, (0, 0, 64, 32)))
    b = stored(tmp_path / "b.exr", LIGHT[:, 20:60], Window(20, 0, 40, 32, (0, 0, 64, 32)))
    assert all(row.relative_rms == 0 and row.pixels == 640 for row in compared(a, b).rows)
    assert regress_inputs(str(a), str(b)).same


def test_envi_files_that_begin_at_other_pixels(tmp_path):
    a = stored(tmp_path / "a.hdr", LIGHT[:, :40])
    b = stored(tmp_path / "b.hdr", LIGHT[:, 20:60], Window(20, 0, 40, 32))
    assert "x start = 21" in b.read_text()
    comparison = compared(a, b)
    assert all(row.relative_rms == 0 and row.pixels == 640 for row in comparison.rows)


def test_maps_of_other_windows(tmp_path):
    """Channels that are no spectra, such as AOVs, are compared as they are, at the same pixels."""
    for name, x_px in (("a", 0), ("b", 20)):
        windows = {
            "dataWindow": (np.array([x_px, 0], np.int32), np.array([x_px + 39, 31], np.int32)),
            "displayWindow": (np.array([0, 0], np.int32), np.array([63, 31], np.int32)),
        }
        planes = {"depth.Z": np.ascontiguousarray(LIGHT[:, x_px : x_px + 40, 0])}
        with OpenEXR.File({"type": OpenEXR.scanlineimage, **windows}, planes) as file:
            file.write(str(tmp_path / f"{name}.exr"))
    comparison = compared(tmp_path / "a.exr", tmp_path / "b.exr")
    assert comparison.rows[0].pixels == 640
    assert comparison.rows[0].relative_rms == 0


def test_crops_apart_and_crops_of_other_pictures_are_refused(tmp_path):
    a = stored(tmp_path / "a.exr", LIGHT[:, :20], Window(0, 0, 20, 32, (0, 0, 64, 32)))
    b = stored(tmp_path / "b.exr", LIGHT[:, 20:40], Window(20, 0, 20, 32, (0, 0, 64, 32)))
    c = stored(tmp_path / "c.exr", LIGHT[:, :20], Window(0, 0, 20, 32, (0, 0, 65, 32)))
    for other, message in ((b, "some of x 0 to 19"), (c, "display window")):
        with pytest.raises(InputError, match=message):
            compared(a, other)
        with pytest.raises(InputError, match=message):
            regress_inputs(str(a), str(other))


def test_cubes_of_one_side_have_the_same_pixels(tmp_path):
    a = stored(tmp_path / "a.exr", LIGHT[:, :40], Window(0, 0, 40, 32, (0, 0, 64, 32)))
    b = stored(tmp_path / "b.exr", LIGHT[:, 20:60], Window(20, 0, 40, 32, (0, 0, 64, 32)))
    with pytest.raises(InputError, match=r"the pixels x 20 to 59"):
        regress_inputs(str(a), f"{a},{b}")


def test_a_part_is_not_validated_as_the_complete_picture(tmp_path):
    """Of the capture's size or not: its pixels are others."""
    a = stored(tmp_path / "a.exr", LIGHT[:, :32], Window(20, 0, 32, 32, (0, 0, 64, 32)))
    with pytest.raises(InputError, match=r"a part of a picture, x 20 to 51.*the complete picture"):
        external_picture(a, cornell_box(), cornell_camera(32), None)
