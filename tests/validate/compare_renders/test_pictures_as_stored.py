"""Pictures without a unit, planes without names, layers, and files next to a header."""

import numpy as np
import pytest
import tifffile
import xarray as xr
from cboxlab.rendering.files import AS_STATED, RADIANCE_UNIT, Declared, DeclaredPair, read_cube, write_cube
from cboxlab.rendering.files.exr_channels import write_channels
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders import compare_stacks, read_compared

PAIR = DeclaredPair(("A", "B"))
VALUES = np.random.default_rng(1).uniform(0.1, 1, (6, 8, 3)).astype(np.float32)


def cube(path, values=VALUES, unit=None):
    wavelength = ("wavelength", [450.0, 550.0, 650.0], {"units": "nm"})
    write_cube(path, xr.Dataset({"radiance": (("y", "x", "wavelength"), values)}, coords={"wavelength": wavelength}))
    text = path.read_text().replace(f"data units = {RADIANCE_UNIT}\n", f"data units = {unit}\n" if unit else "")
    path.write_text(text)
    return path


def difference(a, b, pair=PAIR):
    return [row.relative_mean for row in compare_stacks(*read_compared((a, b), pair)).rows]


def test_numbers_without_a_unit_are_compared_as_stored(tmp_path):
    a, b = cube(tmp_path / "a.hdr", 1.25 * VALUES), cube(tmp_path / "b.hdr")
    np.save(tmp_path / "b.npy", VALUES.astype(">f8"))
    tifffile.imwrite(tmp_path / "b.tif", np.moveaxis(VALUES, -1, 0), photometric="minisblack")
    for other in (b, tmp_path / "b.img", tmp_path / "b.npy", tmp_path / "b.tif"):
        assert difference(a, other) == pytest.approx([0.25] * 3, rel=1e-5)


def test_a_unit_on_one_side_alone_is_asked_for(tmp_path):
    a, b = cube(tmp_path / "a.hdr"), cube(tmp_path / "b.hdr", unit="mW m^-2 sr^-1 nm^-1")
    with pytest.raises(InputError, match="no unit"):
        difference(a, b)
    pair = DeclaredPair(("A", "B"), AS_STATED, (Declared(units="mW m^-2 sr^-1 nm^-1"), AS_STATED))
    assert difference(a, b, pair) == pytest.approx([0] * 3, abs=1e-6)
    with pytest.raises(InputError, match="no unit"):
        read_cube(a)


def test_one_layer_has_the_names_of_the_other_picture(tmp_path):
    planes = dict(zip("RGB", np.moveaxis(VALUES, -1, 0).copy(), strict=True))
    write_channels(
        tmp_path / "a.exr", {}, {f"View.Combined.{k}": 2 * v for k, v in planes.items()} | {"View.Z.Z": planes["R"]}
    )
    write_channels(tmp_path / "b.exr", {}, planes)
    assert difference(tmp_path / "a.exr", tmp_path / "b.exr") == pytest.approx([1] * 3)


@pytest.mark.parametrize(
    ("name", "write", "fault"),
    [
        ("a.npy", lambda p: np.save(p, np.array([{}, 1], object), allow_pickle=True), "pickle"),
        ("a.npy", lambda p: p.write_bytes(b"\x93NUMPY"), "cannot be read"),
        ("a.tif", lambda p: tifffile.imwrite(p, np.zeros((6, 8, 3), np.uint8), photometric="rgb"), "8 bits"),
        (
            "a.tif",
            lambda p: tifffile.imwrite(p, np.zeros((6, 8, 3), np.uint16), photometric="rgb"),
            "16 bits in R, G, B",
        ),
        ("a.sif", lambda p: p.write_bytes(b"Andor"), "Andor Solis"),
    ],
)
def test_other_pictures_are_refused(tmp_path, name, write, fault):
    write(tmp_path / name)
    with pytest.raises(InputError, match=fault):
        difference(tmp_path / name, cube(tmp_path / "b.hdr"))


def test_what_is_not_finite_is_left_out_and_counted(tmp_path):
    plane = VALUES[..., 0].copy()
    tifffile.imwrite(tmp_path / "a.tif", plane)
    plane[1, 2] = np.nan
    tifffile.imwrite(tmp_path / "b.tif", plane)
    comparison = compare_stacks(*read_compared((tmp_path / "a.tif", tmp_path / "b.tif"), PAIR))
    assert (comparison.rows[0].pixels, comparison.rows[0].relative_mean) == (47, 0)
    assert any("1 of 48" in note for note in comparison.notes)


def test_a_classic_netcdf_is_the_same_cube(tmp_path):
    write_cube(tmp_path / "a.nc", read_cube(cube(tmp_path / "a.hdr"), Declared(units=RADIANCE_UNIT)))
    with xr.open_dataset(tmp_path / "a.nc") as file:
        file.load().to_netcdf(tmp_path / "b.nc", engine="scipy")
    assert np.array_equal(read_cube(tmp_path / "b.nc")["radiance"], read_cube(tmp_path / "a.nc")["radiance"])
