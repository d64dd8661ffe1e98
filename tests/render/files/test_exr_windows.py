"""Windows and layers of OpenEXR files: parts of a picture keep their place, one layer of several is asked for."""

import numpy as np
import OpenEXR
import pytest
from cboxlab.rendering.files import Declared, Window, common_pixels, read_cube, read_picture, window_of, write_cube
from cboxlab.rendering.files.cube_checks import as_cube
from cboxlab.rendering.files.headers import layers_of, with_window
from cboxlab.utils.errors import InputError
from helpers.faults import fault_folder

PICTURE = np.random.default_rng(3).random((12, 20, 3)).astype(np.float32) + 0.1
SPECTRAL = ["S0.400,0nm", "S0.500,0nm", "S0.600,0nm"]


def exr(path, x_offset=0, top=0, width=20, height=12, display=(0, 0, 19, 11), names=SPECTRAL, **header):
    """Part of the picture; beyond its borders it is 99."""
    wide = np.pad(PICTURE, ((9, 9), (9, 9), (0, 0)), constant_values=99)
    part = wide[9 + top : 9 + top + height, 9 + x_offset : 9 + x_offset + width]
    planes = {name: np.ascontiguousarray(part[..., k % 3]) for k, name in enumerate(names)}
    windows = {
        "dataWindow": (
            np.array([x_offset, top], np.int32),
            np.array([x_offset + width - 1, top + height - 1], np.int32),
        ),
        "displayWindow": (np.array(display[:2], np.int32), np.array(display[2:], np.int32)),
    }
    unit = {"emissiveUnits": "W.m^-2.sr^-1.nm^-1"} if names is SPECTRAL else {}
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **windows, **unit, **header}, planes) as file:
        file.write(str(path))
    return path


def test_the_faults_own_files_know_their_place(tmp_path):
    folder = fault_folder("exr-data-window", tmp_path)
    first, second = (window_of(read_cube(folder / name)) for name in ("dw0.exr", "dw20.exr"))
    assert (first.left, first.width, first.display) == (0, 40, (0, 0, 64, 32))
    assert (second.left, second.width) == (20, 40)
    assert common_pixels(first, second, ("a", "b")) == Window(20, 0, 20, 32, (0, 0, 64, 32))


def test_a_complete_picture_has_no_window(tmp_path):
    cube = read_cube(exr(tmp_path / "a.exr"))
    np.testing.assert_array_equal(cube["radiance"], PICTURE)
    assert window_of(cube) is None
    assert "window" not in cube.attrs.get("reading_notes", "")


@pytest.mark.parametrize(
    ("x_offset", "top", "width", "height"), [(3, 2, 9, 7), (0, 0, 19, 12), (0, 1, 20, 11), (19, 11, 1, 1)]
)
def test_a_part_is_read_with_its_place(tmp_path, x_offset, top, width, height):
    cube = read_cube(exr(tmp_path / "a.exr", x_offset, top, width, height))
    np.testing.assert_array_equal(cube["radiance"], PICTURE[top : top + height, x_offset : x_offset + width])
    assert window_of(cube) == Window(x_offset, top, width, height, (0, 0, 20, 12))
    assert f"part of the display window: x {x_offset} to" in cube.attrs["reading_notes"]


@pytest.mark.parametrize(("x_offset", "top", "width", "height"), [(-4, -2, 28, 16), (0, 0, 22, 12), (-1, 0, 21, 12)])
def test_what_lies_outside_the_picture_is_left_out(tmp_path, x_offset, top, width, height):
    cube = read_cube(exr(tmp_path / "a.exr", x_offset, top, width, height))
    np.testing.assert_array_equal(cube["radiance"], PICTURE)
    assert window_of(cube) is None
    assert "overscan" in cube.attrs["reading_notes"]


def test_a_part_that_reaches_out_is_cut_and_placed(tmp_path):
    cube = read_cube(exr(tmp_path / "a.exr", -5, 4, 10, 12))
    np.testing.assert_array_equal(cube["radiance"], PICTURE[4:, :5])
    assert window_of(cube) == Window(0, 4, 5, 8, (0, 0, 20, 12))


def test_a_part_outside_the_picture_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"data window: found x 0 to 19, y 0 to 11; expected pixels of its display"):
        read_cube(exr(tmp_path / "a.exr", display=(40, 0, 59, 11)))


@pytest.mark.parametrize("names", ["RGB", "XYZ", ["b1", "b2", "b3"]])
def test_every_kind_of_picture_keeps_its_place(tmp_path, names):
    declared = Declared("cd m^-2", colour_space="rec709")
    if names == ["b1", "b2", "b3"]:
        declared = Declared("W m^-2 sr^-1 nm^-1", wavelengths_nm=(400, 500, 600))
    picture = read_picture(exr(tmp_path / "a.exr", 3, 2, 9, 7, names=list(names)), declared)
    assert window_of(picture) == Window(3, 2, 9, 7, (0, 0, 20, 12))


@pytest.mark.parametrize("ending", [".exr", ".nc", ".hdr"])
def test_a_place_survives_writing(tmp_path, ending):
    window = Window(3, 2, 20, 12, (0, 0, 40, 30))
    write_cube(tmp_path / f"a{ending}", with_window(as_cube(PICTURE, [400.0, 500.0, 600.0]), window))
    back = window_of(read_cube(tmp_path / f"a{ending}"))
    assert (back.left, back.top, back.width, back.height) == (3, 2, 20, 12)
    assert back.display == (None if ending == ".hdr" else (0, 0, 40, 30))


def test_a_place_that_does_not_fit_the_size_is_none():
    cube = with_window(as_cube(PICTURE, [400.0, 500.0, 600.0]), Window(3, 2, 20, 12, (0, 0, 40, 30)))
    assert window_of(cube) is not None
    assert window_of(cube.isel(x=slice(4))) is None
    assert window_of(cube.assign_attrs(window="[1, 2]")) is None
    assert window_of(cube.assign_attrs(window='{"left": null}')) is None


WHOLE = Window(0, 0, 20, 12, (0, 0, 20, 12))


@pytest.mark.parametrize(
    ("first", "second", "common"),
    [
        (WHOLE, WHOLE, None),
        (WHOLE, Window(0, 0, 7, 5, (0, 0, 7, 5)), None),  # of other sizes: refused by whoever compares
        (Window(3, 2, 9, 7, (0, 0, 20, 12)), Window(3, 2, 9, 7, (0, 0, 20, 12)), None),
        (WHOLE, Window(3, 2, 9, 7, (0, 0, 20, 12)), Window(3, 2, 9, 7, (0, 0, 20, 12))),
        (Window(3, 2, 9, 7, (0, 0, 20, 12)), Window(8, 0, 9, 7), Window(8, 2, 4, 5, (0, 0, 20, 12))),
        (Window(3, 2, 9, 7), Window(3, 2, 9, 6), Window(3, 2, 9, 6)),
    ],
)
def test_pixels_in_common(first, second, common):
    assert common_pixels(first, second, ("a", "b")) == common


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (WHOLE, Window(3, 2, 9, 7, (0, 0, 21, 12)), "display window"),
        (WHOLE, Window(20, 0, 20, 12, (20, 0, 20, 12)), "display window"),
        (Window(0, 0, 5, 5, (0, 0, 20, 12)), Window(5, 0, 5, 5, (0, 0, 20, 12)), "some of x 0 to 4"),
    ],
)
def test_pictures_without_common_pixels_are_refused(first, second, message):
    with pytest.raises(InputError, match=message):
        common_pixels(first, second, ("a", "b"))


AOVS = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "dd.T", "nn.X", "nn.Y", "nn.Z"]
PASSES = [*(f"ViewLayer.Combined.{c}" for c in "RGBA"), "ViewLayer.Depth.Z", *(f"ViewLayer.Normal.{c}" for c in "XYZ")]


@pytest.mark.parametrize(
    ("names", "header", "message"),
    [
        (
            AOVS,
            {"generatedBy": "Mitsuba version 3.9.1"},
            r"layers \(without a name, albedo, dd, nn\).*such as R, G, B as R, G, B",
        ),
        (AOVS, {"generatedBy": "Mitsuba version 3.9.1"}, "without the integrator 'aov'"),
        (PASSES, {}, r"such as ViewLayer\.Combined\.R, ViewLayer\.Combined\.G.*OpenEXR in place of OpenEXR MultiLayer"),
        ([f"Composite.Combined.{c}" for c in "RGBA"], {}, r"such as Composite\.Combined\.R"),
        ([*"RGBA", "Z"], {}, "one picture: spectra, R, G, B, or X, Y, Z alone"),
        ([f"diffuse.{c}" for c in "RGB"] + [f"specular.{c}" for c in "RGB"], {}, r"layers \(diffuse, specular\)"),
        (["ch1", "ch2", "depth.Z"], {}, r"layers \(without a name, depth\)"),
    ],
)
def test_one_layer_of_several_is_asked_for(tmp_path, names, header, message):
    path = exr(tmp_path / "a.exr", names=names, **header)
    for declared in (Declared(), Declared("W m^-2 sr^-1 nm^-1", wavelengths_nm=(400, 500))):
        with pytest.raises(InputError, match=message) as fault:
            read_picture(path, declared)
        assert "\n" not in str(fault.value)


def test_names_with_numbers_are_bands():
    assert layers_of(["band.1", "band.2", "400.5", "410.2"]) == {"": {"band.1", "band.2", "400.5", "410.2"}}
    assert layers_of(["a.b.R"]) == {"a.b": {"R"}}


def test_parts_of_a_file_are_named(tmp_path):
    plane = np.ones((4, 5), np.float32)
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Y": plane.copy()}, name) for name in ("beauty", "depth")]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    with pytest.raises(InputError, match=r"2 parts \(beauty, depth\).*Save one layer"):
        read_picture(tmp_path / "a.exr")
