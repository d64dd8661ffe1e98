"""Spectral cubes and raw frames come back from disk as they were written; faulty files are refused."""

import numpy as np
import OpenEXR
import pytest
import tifffile
import xarray as xr
from cboxlab.rendering.files import cube_files
from cboxlab.rendering.files.cube_files import read_cube, write_cube
from cboxlab.rendering.files.previews import cube_to_linear_srgb
from cboxlab.rendering.files.raw_files import write_raw
from cboxlab.rendering.image.image import LAMP
from cboxlab.utils.errors import InputError
from helpers.files.raw_frames import read_raw
from PIL import Image

WAVELENGTH = np.array([400.0, 450.5, 500.0, 550.0, 625.25, 700.0])


@pytest.fixture
def cube() -> xr.Dataset:
    generator = np.random.default_rng(1)
    unit = {"units": "W m^-2 sr^-1 nm^-1"}
    shape = (5, 7, WAVELENGTH.size)
    surface = np.zeros((5, 7), np.int16)
    surface[0, 0] = LAMP
    dims = ("y", "x", "wavelength")
    return xr.Dataset(
        {
            "radiance": (dims, generator.random(shape, np.float32) * 1e-3, unit),
            "standard_error": (dims, generator.random(shape, np.float32) * 1e-6, unit),
            "surface": (("y", "x"), surface, {"names": "floor, ceiling", "lamp": LAMP}),
        },
        coords={"wavelength": ("wavelength", WAVELENGTH, {"units": "nm"})},
    )


def test_netcdf_keeps_everything(cube, tmp_path):
    write_cube(tmp_path / "cube.nc", cube)
    xr.testing.assert_identical(read_cube(tmp_path / "cube.nc"), cube)


@pytest.mark.parametrize("ending", [".exr", ".hdr"])
def test_radiance_and_wavelengths_survive_bit_for_bit(cube, tmp_path, ending):
    write_cube(tmp_path / f"cube{ending}", cube)
    back = read_cube(tmp_path / f"cube{ending}")
    xr.testing.assert_identical(back["radiance"], cube["radiance"])


def test_the_exr_names_its_channels_as_the_layout_says(cube, tmp_path):
    """Fichet, Pacanowski and Wilkie 2021: wavelengths with a decimal comma, version, units, RGB."""
    write_cube(tmp_path / "cube.exr", cube)
    with OpenEXR.File(str(tmp_path / "cube.exr"), separate_channels=True) as file:
        names, header = set(file.channels()), dict(file.header())
    spectral = {f"S0.{w:.6f}".replace(".", ",").replace("S0,", "S0.") + "nm" for w in WAVELENGTH}
    assert "S0.450,500000nm" in spectral
    assert names == spectral | {"R", "G", "B"}
    assert header["spectralLayoutVersion"] == "1.0"
    assert header["emissiveUnits"] == "W.m^-2.sr^-1.nm^-1"


def test_channels_of_other_programs_are_read_in_any_unit_of_length(tmp_path):
    values = {"S0.6e-7m": 3.0, "S0.0,5um": 2.0, "S0.400nm": 1.0, "T.400nm": 9.0, "Z": 9.0}
    planes = {name: np.full((2, 3), value, np.float32) for name, value in values.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File({**header, "emissiveUnits": "W.m^-2.sr^-1"}, planes) as file:
        file.write(str(tmp_path / "other.exr"))
    cube = read_cube(tmp_path / "other.exr")
    assert "T.400nm, Z" in cube.attrs["reading_notes"]
    np.testing.assert_allclose(cube["wavelength"], [400, 500, 600])
    np.testing.assert_array_equal(cube["radiance"][1, 2], [1, 2, 3])


@pytest.mark.parametrize("order", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("kind", [(">f8", 5, 1), ("<u2", 12, 0)])
def test_envi_of_other_programs_is_read(tmp_path, order, kind):
    dtype, code, byte_order = kind
    values = np.arange(2 * 3 * 4).reshape(2, 3, 4)  # y, x, wavelength
    turned = {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}[order]
    raw = b"head" + np.ascontiguousarray(values.transpose(turned), dtype).tobytes()
    (tmp_path / "a.raw").write_bytes(raw)
    (tmp_path / "a.hdr").write_text(
        f"ENVI\nsamples = 3\nlines=2\nbands = 4\nheader offset = 4\ndata type = {code}\n"
        f"interleave = {order.upper()}\n"
        f"byte order = {byte_order}\ndata units = W/m^2/sr/um\n"
        "wavelength units = Micrometers\nwavelength = {{0.4, 0.5,\n 0.6, 0.7}}\n"
    )
    cube = read_cube(tmp_path / "a.hdr")
    np.testing.assert_allclose(cube["radiance"], 1e-3 * values, rtol=1e-6)
    np.testing.assert_allclose(cube["wavelength"], [400, 500, 600, 700])


def test_the_picture_has_the_cubes_size(cube, tmp_path):
    write_cube(tmp_path / "cube.png", cube)
    with Image.open(tmp_path / "cube.png") as image:
        assert (image.size, image.mode) == ((7, 5), "RGB")
        assert np.asarray(image).max() == 255


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_pixel_without_a_finite_radiance_is_black_in_the_picture(cube, value):
    """As if its light were 0, without any effect on what is white: the others keep their colours."""
    dark = cube.isel(y=slice(1, 5)).copy(deep=True)
    dark["radiance"][2, 3] = 0.0
    lacking = dark.copy(deep=True)
    lacking["radiance"][2, 3, 1] = value
    expected, picture = cube_to_linear_srgb(dark), cube_to_linear_srgb(lacking)
    assert np.all(picture[2, 3] == 0)
    others = np.ones((4, 7), bool)
    others[2, 3] = False
    factor = expected[others] / picture[others]
    assert factor == pytest.approx(factor[0, 0]) and factor[0, 0] == pytest.approx(1, abs=0.01)
    lacking["radiance"][:] = value
    assert not cube_to_linear_srgb(lacking).any()


@pytest.mark.parametrize("ending", cube_files.WRITABLE)
def test_a_failed_write_leaves_what_was_there(cube, tmp_path, ending, monkeypatch):
    path = tmp_path / f"cube{ending}"
    write_cube(path, cube)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    monkeypatch.setattr("cboxlab.rendering.files.previews.cube_to_srgb", fail)
    monkeypatch.setattr("cboxlab.rendering.files.previews.cube_to_linear_srgb", fail)
    monkeypatch.setattr(cube_files.Path, "write_bytes", fail)
    with pytest.raises(InputError, match="No space left"):
        write_cube(path, cube * 2)
    monkeypatch.undo()
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_mistakes_of_a_cube_are_reported(cube, tmp_path):
    for changed, message in (
        (cube.rename(radiance="light"), "radiance with dimensions"),
        (cube.drop_vars("wavelength"), "wavelengths in nm"),
        (cube.isel(wavelength=slice(None, None, -1)), "ascending"),
        (cube.assign(radiance=cube["radiance"].assign_attrs(units="W")), "the unit 'W'"),
    ):
        with pytest.raises(InputError, match=message):
            write_cube(tmp_path / "cube.nc", changed)
    with pytest.raises(InputError, match=r"ending '\.tif'"):
        write_cube(tmp_path / "cube.tif", cube)
    assert not list(tmp_path.iterdir())


def test_faulty_files_are_reported(cube, tmp_path):
    for ending in cube_files.READABLE:
        path = tmp_path / f"bad{ending}"
        with pytest.raises(InputError, match="no such file"):
            read_cube(path)
        path.write_bytes(b"nothing of the kind")
        with pytest.raises(InputError, match="bad"):
            read_cube(path)
    (tmp_path / "old.nc").write_bytes(b"CDF\x01" + bytes(100))
    with pytest.raises(InputError, match=r"radiance: found nothing"):
        read_cube(tmp_path / "old.nc")
    write_cube(tmp_path / "short.hdr", cube)
    data = (tmp_path / "short.img").read_bytes()
    (tmp_path / "short.img").write_bytes(data[:-4])
    with pytest.raises(InputError, match=f"{len(data) - 4} bytes"):
        read_cube(tmp_path / "short.hdr")
    (tmp_path / "short.img").unlink()
    with pytest.raises(InputError, match="no data file"):
        read_cube(tmp_path / "short.hdr")
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": np.zeros((2, 2), np.float32)}) as file:
        file.write(str(tmp_path / "grey.exr"))
    with pytest.raises(InputError, match="channels Y"):
        read_cube(tmp_path / "grey.exr")


def test_raw_frames_come_back_with_their_metadata(tmp_path):
    counts = np.random.default_rng(2).integers(0, 65536, (9, 4), np.uint16)
    metadata = {"camera": "dcs200", "exposure_s": 0.25, "seed": 3, "note": "µ-lens \U0001f4f7"}
    write_raw(tmp_path / "raw.tif", counts, metadata)
    back, metadata_read = read_raw(tmp_path / "raw.tif")
    np.testing.assert_array_equal(back, counts)
    assert metadata_read == metadata
    with tifffile.TiffFile(tmp_path / "raw.tif") as file:
        assert (file.pages.first.bitspersample, file.pages.first.samplesperpixel) == (16, 1)


def test_faulty_raw_frames_are_reported(tmp_path):
    with pytest.raises(InputError, match="uint16 counts"):
        write_raw(tmp_path / "a.tif", np.zeros((2, 2)))
