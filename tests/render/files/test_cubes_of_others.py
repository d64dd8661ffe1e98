"""Pictures of other renderers: what a file leaves open is asked for, what it states is used, nothing is lost."""

import subprocess
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import xarray as xr
from cboxlab.rendering.files import (
    Declared,
    declared_for,
    open_cube,
    read_cube,
    read_picture,
    require_used,
    stated_in,
    write_cube,
)
from cboxlab.rendering.files.colour_pictures import COLOUR_SPACES, primaries_matrix
from cboxlab.rendering.files.cube_checks import as_cube
from cboxlab.rendering.files.declared import spectral_factor
from cboxlab.utils.errors import InputError

RADIANCE = "W m^-2 sr^-1 nm^-1"
GREY = np.random.default_rng(4).random((6, 9, 3)).astype(np.float32) + 0.1


def exr(path, planes, **header):
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, planes) as file:
        file.write(str(path))
    return path


def channels(names, values=GREY):
    return {name: np.ascontiguousarray(values[..., i]) for i, name in enumerate(names)}


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("W m^-2 sr^-1 nm^-1", 1),
        ("W.m^-2.sr^-1.nm^-1", 1),
        ("W/m^2/sr/um", 1e-3),
        ("W/(m^2 sr nm)", 1),
        ("W m⁻² sr⁻¹ µm⁻¹", 1e-3),
        ("uW cm-2 sr-1 nm-1", 1e-2),
        ("mW m**-2 sr**-1 nm**-1", 1e-3),
        ("W m^-3 sr^-1", 1e-9),
    ],
)
def test_units_are_recognised_by_their_dimensions(unit, factor):
    assert spectral_factor("a", unit, Declared()) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("unit", ["W m^-2 nm^-1", "W m^-2 sr^-1", "cd m^-2", "DN", "furlong", "", "W m^-2 sr^-1 nm^-"])
def test_other_units_are_refused(unit):
    with pytest.raises(InputError, match="the unit"):
        spectral_factor("a", unit, Declared())


def test_a_spectral_exr_without_units_asks_for_them(tmp_path):
    path = exr(tmp_path / "a.exr", channels(["S0.400nm", "S0.500nm", "S0.600nm"]))
    with pytest.raises(InputError, match="declare units"):
        read_cube(path)
    cube = read_cube(path, Declared(units="mW m^-2 sr^-1 nm^-1", scale=2.0))
    np.testing.assert_allclose(cube["radiance"], 2e-3 * GREY, rtol=1e-6)
    assert "units as declared: mW" in cube.attrs["reading_notes"]


@pytest.mark.parametrize(
    ("same", "other"),
    [
        (Declared("W/m^2/sr/nm"), Declared("mW m^-2 sr^-1 nm^-1")),
        (Declared(scale=1.0), Declared(scale=2.0)),
        (Declared(wavelengths_nm=(400.0, 500.0, 600.0)), Declared(wavelengths_nm=(400.0, 510.0, 600.0))),
    ],
)
@pytest.mark.parametrize("ending", ["nc", "exr", "hdr"])
def test_a_declaration_may_repeat_what_a_file_states(tmp_path, ending, same, other):
    """One that says another is refused, with both values."""
    path = tmp_path / f"a.{ending}"
    write_cube(path, as_cube(GREY, [400.0, 500.0, 600.0]))
    cube = read_cube(path, same)
    np.testing.assert_allclose(cube["radiance"], GREY, rtol=1e-6)
    require_used(same, declared_for(cube), stated_in(cube))
    cube = read_cube(path, other)
    with pytest.raises(InputError, match="the file states it itself") as error:
        require_used(other, declared_for(cube), stated_in(cube))
    assert any(value in error.value.expected for value in ("W", "1.0", "3 from 400 to 600 nm"))


def test_colours_of_a_header_may_be_repeated(tmp_path):
    corners = tuple(float(np.float32(v)) for v in COLOUR_SPACES["rec2020"])
    path = exr(tmp_path / "a.exr", channels("RGB"), chromaticities=corners, whiteLuminance=50.0)
    same, other = (Declared("cd m^-2", 50.0, colour_space=name) for name in ("rec2020", "rec709"))
    picture = read_picture(path, same)
    require_used(same, declared_for(picture), stated_in(picture))
    picture = read_picture(path, other)
    with pytest.raises(InputError, match=r"colour-space: found rec709; expected rec2020"):
        require_used(other, declared_for(picture), stated_in(picture))


def test_what_every_file_states_may_not_be_declared(tmp_path):
    write_cube(tmp_path / "a.nc", as_cube(GREY, [400.0, 500.0, 600.0]))
    declared = Declared(scale=2.0)
    cube = read_cube(tmp_path / "a.nc", declared)
    np.testing.assert_array_equal(cube["radiance"], GREY)
    with pytest.raises(InputError, match=r"declared scale: found 2\.0"):
        require_used(declared, declared_for(cube))


def test_bands_without_wavelengths_ask_for_a_list(tmp_path):
    """As Mitsuba's specfilm writes them: names of the user, values integrated over each response of 20 nm."""
    path = exr(tmp_path / "a.exr", channels(["band10", "band2", "band1"]), generatedBy="Mitsuba version 3.9.1")
    with pytest.raises(InputError, match=r"band1, band2, band10.*declare wavelengths"):
        read_cube(path)
    with pytest.raises(InputError, match="integrates over each response"):
        read_cube(path, Declared(wavelengths_nm=(400, 500, 600)))
    with pytest.raises(InputError, match="2 wavelengths"):
        read_cube(path, Declared(RADIANCE, wavelengths_nm=(400, 500)))
    cube = read_cube(path, Declared(RADIANCE, 1 / 20, (600, 500, 400)))
    np.testing.assert_array_equal(cube["wavelength"], [400, 500, 600])
    np.testing.assert_allclose(cube["radiance"], GREY / 20, rtol=1e-6)  # band10 is 400 nm
    assert "channel band1 is 600 nm" in cube.attrs["reading_notes"]


def test_names_that_are_wavelengths_are_read(tmp_path):
    """The unit of the values is asked for all the same; a declared list comes before the names."""
    path = exr(tmp_path / "a.exr", channels(["600nm", "448.5nm", "1000 nm"]))
    with pytest.raises(InputError, match="declare units"):
        read_cube(path)
    cube = read_cube(path, Declared(RADIANCE))
    np.testing.assert_array_equal(cube["wavelength"], [448.5, 600, 1000])
    np.testing.assert_array_equal(cube["radiance"], GREY[..., [1, 0, 2]])
    np.testing.assert_array_equal(
        read_cube(path, Declared(RADIANCE, wavelengths_nm=(400, 500, 600)))["wavelength"], [400, 500, 600]
    )
    path = exr(tmp_path / "b.exr", channels(["600nm", "450nm", "mask"]))
    with pytest.raises(InputError, match="name no wavelength"):
        read_cube(path, Declared(RADIANCE))


def test_a_wavelength_twice_is_reported(tmp_path):
    path = exr(tmp_path / "a.exr", channels(["S0.500nm", "S0.500,0nm", "S0.600nm"]), emissiveUnits=RADIANCE)
    with pytest.raises(InputError, match="500 nm twice"):
        read_cube(path)
    write_cube(tmp_path / "a.hdr", as_cube(GREY, [400.0, 500.0, 600.0]))
    header = (tmp_path / "a.hdr").read_text()
    (tmp_path / "a.hdr").write_text(header.replace("{400, 500", "{500, 500"))
    with pytest.raises(InputError, match="500 nm twice"):
        read_cube(tmp_path / "a.hdr")


def test_an_envi_header_asks_for_units_and_wavelengths(tmp_path):
    write_cube(tmp_path / "a.hdr", as_cube(GREY, [400.0, 500.0, 600.0]))
    header_lines = (tmp_path / "a.hdr").read_text().splitlines()

    def header(*without, **changed):
        lines = [line for line in header_lines if not line.startswith(without)]
        (tmp_path / "a.hdr").write_text(
            "\n".join([*lines, *(f"{k.replace('_', ' ')} = {v}" for k, v in changed.items())])
        )
        return tmp_path / "a.hdr"

    with pytest.raises(InputError, match=r"data units.*declare units"):
        read_cube(header("data units"))
    with pytest.raises(InputError, match=r"wavelength units.*declare wavelengths"):
        read_cube(header("wavelength units"))
    with pytest.raises(InputError, match=r"wavelength: .*declare wavelengths"):
        read_cube(header("wavelength ="))
    cube = read_cube(header("wavelength ="), Declared(wavelengths_nm=(600, 500, 400)))
    np.testing.assert_array_equal(cube["radiance"], GREY[..., ::-1])
    cube = read_cube(header(data_ignore_value=repr(float(GREY[2, 3, 1]))))
    assert np.isnan(cube["radiance"].values[2, 3, 1])
    assert np.isnan(cube["radiance"].values).sum() == 1


def test_a_netcdf_file_asks_for_units_and_wavelengths(tmp_path):
    path = tmp_path / "a.nc"
    plain = as_cube(GREY, [0.6, 0.5, 0.4]).drop_attrs()
    plain.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match=r"radiance.*declare units"):
        read_cube(path)
    with pytest.raises(InputError, match=r"wavelength.*declare wavelengths"):
        read_cube(path, Declared(RADIANCE))
    plain["wavelength"].attrs["units"], plain["radiance"].attrs["units"] = "um", "W m-2 sr-1 um-1"
    plain.to_netcdf(path, engine="h5netcdf")
    cube = read_cube(path)
    np.testing.assert_allclose(cube["wavelength"], [400, 500, 600])
    np.testing.assert_allclose(cube["radiance"], 1e-3 * GREY[..., ::-1], rtol=1e-6)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("um", 1e-3), ("micrometers", 1e-3), ("µm", 1e-3), ("Nanometre", 1.0), ("m", 1e-9), ("angstrom", 10.0)],
)
def test_units_of_wavelength_of_a_netcdf_file(tmp_path, unit, factor):
    cube = as_cube(GREY, np.array([400.0, 500.0, 600.0]) * factor)
    cube["wavelength"].attrs["units"] = unit
    cube.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    back = read_cube(tmp_path / "a.nc")
    np.testing.assert_allclose(back["wavelength"], [400, 500, 600])
    assert back["wavelength"].attrs["units"] == "nm"


def test_a_netcdf_files_wavelengths_are_kept_and_their_unit_asked_for(tmp_path):
    cube = as_cube(GREY, [0.4, 0.5, 0.6])
    del cube["wavelength"].attrs["units"]
    cube.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="declare wavelength-unit=nm"):
        read_cube(tmp_path / "a.nc")
    declared = Declared(wavelength_unit="um")
    back = read_cube(tmp_path / "a.nc", declared)
    np.testing.assert_allclose(back["wavelength"], [400, 500, 600])
    require_used(declared, declared_for(back), stated_in(back))
    with pytest.raises(InputError, match="declared wavelength-unit: found 'ft'"):
        read_cube(tmp_path / "a.nc", Declared(wavelength_unit="ft"))
    cube["wavelength"].attrs["units"] = "ft"
    cube.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="the unit 'ft'"):
        read_cube(tmp_path / "a.nc")


@pytest.mark.parametrize("nm", [[0.4, 0.5, 0.6], [4e5, 5e5, 6e5], [4e-7, 5e-7, 6e-7]])
@pytest.mark.parametrize("ending", [".nc", ".exr", ".hdr"])
def test_wavelengths_that_are_none_of_light_are_refused(tmp_path, ending, nm):
    path = tmp_path / f"a{ending}"
    if ending == ".exr":
        exr(
            path,
            channels([f"S0.{w:g}nm".replace("0.", "0,").replace("S0,", "S0.") for w in nm]),
            emissiveUnits=RADIANCE,
        )
    else:
        write_cube(path, as_cube(GREY, nm))
    with pytest.raises(InputError, match=r"wavelength: .*wavelengths of light.*another unit"):
        read_cube(path)
    if ending != ".exr":
        with pytest.raises(InputError, match="wavelengths of light"), open_cube(path):
            pass


def test_negative_radiance_is_reported(tmp_path):
    values = GREY.copy()
    values[1, 1] = -1
    write_cube(tmp_path / "a.exr", as_cube(values, [400.0, 500.0, 600.0]))
    assert "pixels of negative radiance: 1" in read_cube(tmp_path / "a.exr").attrs["reading_notes"]


@pytest.mark.parametrize("values", [-GREY, GREY - GREY.mean()], ids=["opposite sign", "a difference"])
def test_what_is_no_light_is_refused(tmp_path, values):
    write_cube(tmp_path / "a.exr", as_cube(values, [400.0, 500.0, 600.0]))
    with pytest.raises(InputError, match=r"a\.exr.*values below 0.*light"):
        read_cube(tmp_path / "a.exr")


def test_rgb_asks_for_its_colour_space_and_its_unit(tmp_path):
    path = exr(tmp_path / "a.exr", channels("RGB"))
    with pytest.raises(InputError, match=r"rec709.*declare colour-space"):
        read_picture(path)
    with pytest.raises(InputError, match="declare units"):
        read_picture(path, Declared(colour_space="rec709"))
    picture = read_picture(path, Declared("cd m^-2", 100.0, colour_space="rec709"))
    luminance = GREY @ [0.2126, 0.7152, 0.0722]  # ITU-R BT.709
    np.testing.assert_allclose(picture["xyz"][..., 1], 100 * luminance, rtol=2e-4)
    with pytest.raises(InputError, match="in colour"):
        read_cube(path, Declared("cd m^-2", colour_space="rec709"))


def test_a_header_states_primaries_and_luminance_of_white(tmp_path):
    bt2020 = np.array(COLOUR_SPACES["rec2020"], np.float32)
    path = exr(tmp_path / "a.exr", channels("RGB"), chromaticities=tuple(map(float, bt2020)), whiteLuminance=50.0)
    picture = read_picture(path)
    np.testing.assert_allclose(picture["xyz"][..., 1], 50 * GREY @ [0.2627, 0.6780, 0.0593], rtol=2e-4)


def test_x_y_z_are_read_as_they_are(tmp_path):
    picture = read_picture(exr(tmp_path / "a.exr", channels("XYZ")), Declared("kcd m^-2"))
    np.testing.assert_allclose(picture["xyz"], 1000 * GREY, rtol=1e-6)


def test_white_of_every_colour_space_has_luminance_1():
    """And its stated chromaticity; BT.709 agrees with IEC 61966-2-1."""
    for space in COLOUR_SPACES.values():
        white = primaries_matrix(space) @ np.ones(3)
        assert white[1] == pytest.approx(1)
        np.testing.assert_allclose(white[:2] / white.sum(), space[6:])
    expected = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    np.testing.assert_allclose(primaries_matrix(COLOUR_SPACES["rec709"]), expected, atol=1e-4)


def test_a_radiance_picture_is_distinguished_from_an_envi_header(tmp_path):
    """Written by OpenCV; 8 bits of mantissa, read in the middle of each step."""
    wide = np.repeat(GREY, 3, axis=1)
    cv2.imwrite(str(tmp_path / "a.hdr"), wide[..., ::-1])
    with pytest.raises(InputError, match=r"declare colour-space.*179"):
        read_picture(tmp_path / "a.hdr")
    declared = Declared("cd m^-2", 179.0, colour_space="radiance")
    picture = read_picture(tmp_path / "a.hdr", declared)["xyz"].values
    expected = 179 * wide @ primaries_matrix(COLOUR_SPACES["radiance"]).T
    largest = 179 * wide.max(axis=-1, keepdims=True)
    assert np.abs(picture - expected).max() < (largest / 128).max()
    assert abs((picture - expected).mean()) < 2e-3 * expected.mean()


def run(program, *arguments, stdin=None):
    pyradiance = pytest.importorskip("pyradiance", reason="Radiance's own programs as an oracle")
    folder = Path(pyradiance.__file__).parent
    return subprocess.run([folder / "bin" / program, *arguments], input=stdin, capture_output=True, check=True).stdout


@pytest.mark.parametrize("flat", [[], ["-u"]])
def test_pictures_of_radiances_own_programs(tmp_path, flat):
    """pvalue packs the values, ra_xyze turns them into XYZE, with an exposure of 2 that is divided out again."""
    wide = np.repeat(GREY, 3, axis=1)
    text = "\n".join(" ".join(f"{v:.6g}" for v in pixel) for pixel in wide.reshape(-1, 3))
    rgbe = run("pvalue", "-r", "-h", "-H", "-d", "-y", "6", "+x", "27", stdin=text.encode())
    (tmp_path / "rgbe.hdr").write_bytes(rgbe)
    (tmp_path / "xyze.hdr").write_bytes(run("ra_xyze", *flat, "-e", "2", str(tmp_path / "rgbe.hdr")))
    assert b"32-bit_rle_xyze" in (tmp_path / "xyze.hdr").read_bytes()
    xyz = read_picture(tmp_path / "xyze.hdr", Declared("cd m^-2"))["xyz"].values
    rgb = read_picture(tmp_path / "rgbe.hdr", Declared("cd m^-2", 179.0, colour_space="radiance"))["xyz"].values
    assert xyz.mean() == pytest.approx(rgb.mean(), rel=3e-3)
    np.testing.assert_allclose(xyz, rgb, atol=0.02 * rgb.max())
    expected = 179 * wide @ primaries_matrix(COLOUR_SPACES["radiance"]).T
    assert rgb.mean() == pytest.approx(expected.mean(), rel=1e-3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 2\n\x01", "1 bytes|bytes"),
        (b"#?RADIANCE\nFORMAT=ascii\n\n-Y 2 +X 2\n", "FORMAT"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\nsize 2\n", "size"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=-1\n\n-Y 1 +X 1\n\x01\x02\x03\x80", "EXPOSURE"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 9\n\x02\x02\x00\x09\x89\x00\x89", "complete"),
        (b"neither", "ENVI"),
    ],
)
def test_malformed_pictures_are_one_clear_message(tmp_path, content, message):
    (tmp_path / "a.hdr").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_picture(tmp_path / "a.hdr", Declared("cd m^-2", colour_space="radiance"))


def test_a_picture_keeps_its_sides(tmp_path):
    """Rows from below and columns from the right are turned."""
    pixels = bytes(range(8)) + bytes(range(100, 108)) + bytes(range(8, 16))
    values = {}
    for order in (b"-Y 2 +X 3", b"+Y 2 -X 3"):
        head = b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n" + order + b"\n"
        (tmp_path / "a.hdr").write_bytes(head + pixels)
        values[order] = read_picture(tmp_path / "a.hdr", Declared("cd m^-2"))["xyz"].values
    np.testing.assert_array_equal(values[b"+Y 2 -X 3"], values[b"-Y 2 +X 3"][::-1, ::-1])


def test_nan_is_reported(tmp_path):
    values = GREY.copy()
    values[2, 4, 0] = np.nan
    path = exr(tmp_path / "a.exr", channels("XYZ", values))
    with pytest.raises(InputError, match="not finite"):
        read_picture(path, Declared("cd m^-2"))


def test_a_dataset_in_memory_is_written_with_its_units(tmp_path):
    plain = as_cube(GREY, [400.0, 500.0, 600.0]).drop_attrs()
    write_cube(tmp_path / "a.nc", plain)
    assert xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf")["radiance"].attrs["units"] == RADIANCE
