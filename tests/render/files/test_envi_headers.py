"""ENVI headers as programs write them: read where they are complete, refused in one line where they are not."""

import numpy as np
import pytest
from cboxlab.rendering.files import Declared, declared_for, files_of, read_cube, require_used, stated_in
from cboxlab.rendering.files.headers import in_nanometres, nanometres_per_unit, states_no_unit
from cboxlab.utils.errors import InputError
from helpers.faults import fault_folder
from helpers.files.envi_files import LIGHT, NM, RADIANCE, header_text, write


def read(tmp_path, *arguments, declared=None, **keywords):
    tmp_path.mkdir(exist_ok=True)
    return read_cube(write(tmp_path / "cube", *arguments, **keywords), declared or Declared())


# ---- the fault's own inputs


@pytest.mark.parametrize("case", ["ext.bil", "ext.bip", "ext.bsq", "type-3", "units-Nanometer", "units-micron-latin1"])
def test_the_faults_own_headers_are_read(tmp_path, case):
    path = fault_folder("envi-common-headers", tmp_path) / case / "x.hdr"
    cube = read_cube(path)
    np.testing.assert_allclose(cube["wavelength"], NM)
    values = np.fromfile(files_of(path)[1], "<i4" if case == "type-3" else "<f4").reshape(6, 4, 5)
    np.testing.assert_array_equal(cube["radiance"].transpose("wavelength", "y", "x"), values)


@pytest.mark.parametrize("case", ["units-micron-utf8", "wl-brace-next-line", "wl-comment-inside", "wl-trailing-comma"])
def test_the_faults_own_lists_are_read(tmp_path, case):
    cube = read_cube(fault_folder("envi-common-headers", tmp_path) / case / "x.hdr")
    np.testing.assert_allclose(cube["wavelength"], NM)


def test_the_faults_header_without_an_order_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"interleave: found nothing; expected one of bsq, bil, bip"):
        read_cube(fault_folder("envi-no-interleave", tmp_path) / "x.hdr")


def test_a_key_with_two_values_is_refused(tmp_path):
    """The same value twice, or two descriptions, do no harm."""
    twice = header_text() + "interleave = BSQ\ndescription = {one}\ndescription = {another}\n"
    np.testing.assert_array_equal(read(tmp_path / "same", twice)["radiance"], LIGHT)
    with pytest.raises(InputError, match=r"interleave: found 'bsq' and 'bil'; expected one value"):
        read(tmp_path / "other", header_text() + "interleave = bil\n")


def test_the_faults_bad_bands_are_left_out(tmp_path):
    cube = read_cube(fault_folder("envi-bad-bands", tmp_path) / "x.hdr")
    np.testing.assert_array_equal(cube["wavelength"], [450, 500, 550, 600])
    assert cube["radiance"].max() < 10
    assert "bad (bbl) are left out: 400, 650 nm" in cube.attrs["reading_notes"]


# ---- the file of samples


@pytest.mark.parametrize(
    "data", ["x.bsq", "x.bil", "x.bip", "x.dat", "x.img", "x.raw", "x.IMG", "x.bin", "x", "x.envi"]
)
def test_samples_lie_in_a_file_of_any_usual_ending(tmp_path, data):
    path = write(tmp_path / "cube", header_text(), data=data)
    np.testing.assert_array_equal(read_cube(path)["radiance"], LIGHT)
    assert [file.name for file in files_of(path)] == ["x.hdr", data]


@pytest.mark.parametrize(("header", "data"), [("x.img.hdr", "x.img"), ("x.bil.hdr", "x.bil"), ("a.b.hdr", "a.b.bip")])
def test_a_header_may_be_named_after_its_samples(tmp_path, header, data):
    np.testing.assert_array_equal(read(tmp_path, header_text(), data=data, header=header)["radiance"], LIGHT)


def test_of_two_data_files_the_one_of_the_headers_size_is_read(tmp_path):
    path = write(tmp_path / "cube", header_text(), data="x.bil")
    (tmp_path / "cube" / "x.img").write_bytes(b"a quick look")
    np.testing.assert_array_equal(read_cube(path)["radiance"], LIGHT)
    assert [file.name for file in files_of(path)] == ["x.hdr", "x.bil"]
    (tmp_path / "cube" / "x.dat").write_bytes((tmp_path / "cube" / "x.bil").read_bytes())
    with pytest.raises(InputError, match=r"data files x.dat, x.bil of the same size"):
        read_cube(path)


def test_an_ending_that_contradicts_the_header_is_noted(tmp_path):
    cube = read(tmp_path, header_text(interleave="bil"), order="bil", data="x.bsq")
    np.testing.assert_array_equal(cube["radiance"], LIGHT)
    assert "read as bil, as the header states, although the data file is x.bsq" in cube.attrs["reading_notes"]
    cube = read(tmp_path / "other", header_text(interleave="bil"), order="bil", data="x.BIL")
    assert "reading_notes" not in cube.attrs


def test_samples_named_in_place_of_their_header(tmp_path):
    write(tmp_path / "cube", header_text(), data="x.bil")
    assert np.array_equal(
        read_cube(tmp_path / "cube" / "x.bil")["radiance"], read_cube(tmp_path / "cube" / "x.hdr")["radiance"]
    )


# ---- order and type of the samples


@pytest.mark.parametrize("without", ["interleave", "data type", "byte order", "samples", "lines", "bands"])
def test_what_the_samples_need_is_not_guessed(tmp_path, without):
    with pytest.raises(InputError, match=rf"x\.hdr: {without}: found nothing"):
        read(tmp_path, header_text([without]))


@pytest.mark.parametrize("text", ["bsqq", "BIP BIL", "", "{}", "rgb"])
def test_other_orders_are_refused(tmp_path, text):
    with pytest.raises(InputError, match=r"interleave: .*one of bsq, bil, bip"):
        read(tmp_path, header_text(interleave=text))


@pytest.mark.parametrize("order", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("text", ["{}", "{} ", "{} ; as recorded"])
def test_the_order_is_read_in_any_case(tmp_path, order, text):
    header = header_text(interleave=text.format(order.upper()))
    np.testing.assert_array_equal(read(tmp_path, header, order=order)["radiance"], LIGHT)


@pytest.mark.parametrize(
    ("code", "kind"),
    [(1, "u1"), (2, "<i2"), (3, "<i4"), (4, "<f4"), (5, "<f8"), (12, "<u2"), (13, "<u4"), (14, "<i8"), (15, "<u8")],
)
def test_all_real_types_are_read(tmp_path, code, kind):
    values = np.arange(1, 121).reshape(4, 5, 6)
    cube = read(tmp_path, header_text(data_type=code), values, kind=kind)
    np.testing.assert_array_equal(cube["radiance"], values)


def test_whole_numbers_of_32_bits_keep_their_digits(tmp_path):
    values = np.full((4, 5, 6), 2**30 + 1)
    assert (read(tmp_path, header_text(data_type=3, byte_order=1), values, kind=">i4")["radiance"] == 2**30 + 1).all()


def test_bytes_need_no_order(tmp_path):
    values = np.arange(120).reshape(4, 5, 6)
    np.testing.assert_array_equal(
        read(tmp_path, header_text(["byte order"], data_type=1), values, kind="u1")["radiance"], values
    )


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"data_type": 6}, "complex"),
        ({"data_type": 99}, "data type: found 99"),
        ({"file_type": "ENVI Spectral Library"}, "a picture"),
        ({"file_type": "ENVI Classification"}, "a picture"),
        ({"file_compression": 1}, "Decompress"),
        ({"major_frame_offsets": "{0, 512}"}, "major frame offsets"),
        ({"header_offset": "-1"}, "negative"),
        ({"bands": "0"}, "no samples"),
        ({"byte_order": "2"}, "0 .little endian. or 1"),
        ({"samples": "5.0"}, "a whole number"),
    ],
)
def test_files_of_another_kind_are_refused(tmp_path, entry, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, header_text(**entry))


# ---- wavelengths and their unit


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        *((text, 1.0) for text in ("Nanometers", "nanometer", "NANOMETRES", "nm", "nanometre", "[nm]", '"nm"', "nm.")),
        *((text, 1e3) for text in ("Micrometers", "micrometre", "um", "µm", "μm", "Microns", "micron", "Âµm", "µ m")),
        *((text, 0.1) for text in ("Angstroms", "angstrom", "Å")),
        *((text, 1e6) for text in ("Millimeters", "mm")),
        *((text, 1e7) for text in ("Centimetres", "cm")),
        *((text, 1e9) for text in ("Meters", "m")),
    ],
)
def test_units_of_length_are_read_as_they_are_spelled(tmp_path, unit, size):
    assert nanometres_per_unit(unit) == size
    wavelength_text = ", ".join(f"{w / size:.9g}" for w in NM)
    cube = read(tmp_path, header_text(wavelength_units=unit, wavelength=f"{{{wavelength_text}}}"))
    np.testing.assert_allclose(cube["wavelength"], NM, rtol=1e-7)


@pytest.mark.parametrize("unit", ["Wavenumber", "cm-1", "1/cm"])
def test_wavenumbers_are_turned_into_wavelengths(tmp_path, unit):
    wavenumber_text = ", ".join(f"{1e7 / w:.9g}" for w in NM)
    cube = read(tmp_path, header_text(wavelength_units=unit, wavelength=f"{{{wavenumber_text}}}"))
    np.testing.assert_allclose(cube["wavelength"], NM, rtol=1e-7)


@pytest.mark.parametrize("unit", ["GHz", "furlongs", "nmm", "?m", "pixels", "mW"])
def test_other_units_are_refused(tmp_path, unit):
    assert in_nanometres(NM, unit) is None
    with pytest.raises(InputError, match=r"wavelength units.*another unit of length"):
        read(tmp_path, header_text(wavelength_units=unit))


@pytest.mark.parametrize(
    ("unit", "values"),
    [
        ("Nanometers", "0.40, 0.45, 0.50, 0.55, 0.60, 0.65"),
        ("nm", "0.4, 0.5, 0.6, 0.7, 0.8, 0.9"),
        ("Nanometers", "4.5e-7, 5e-7, 5.5e-7, 6e-7, 6.5e-7, 7e-7"),
        ("Micrometers", "400, 450, 500, 550, 600, 650"),
        ("Meters", "400, 450, 500, 550, 600, 650"),
        ("Nanometers", "-400, 450, 500, 550, 600, 650"),
        ("Nanometers", "0, 450, 500, 550, 600, 650"),
    ],
)
def test_wavelengths_that_are_none_of_light_are_refused(tmp_path, unit, values):
    with pytest.raises(InputError, match=r"wavelengths of light.*in another unit"):
        read(tmp_path, header_text(wavelength_units=unit, wavelength=f"{{{values}}}"))


@pytest.mark.parametrize("unit", [None, "Unknown", "Index", "", "unknown", "None"])
def test_a_list_without_its_unit_is_kept_and_the_unit_asked_for(tmp_path, unit):
    assert states_no_unit(unit)
    text = header_text(["wavelength units"]) if unit is None else header_text(wavelength_units=unit)
    with pytest.raises(InputError, match=r"6 wavelengths, 400 to 650.*declare wavelength-unit=nm"):
        read(tmp_path, text)
    declared = Declared(wavelength_unit="nm")
    cube = read(tmp_path, text, declared=declared)
    np.testing.assert_array_equal(cube["wavelength"], NM)
    assert "wavelength-unit as declared: nm" in cube.attrs["reading_notes"]
    require_used(declared, declared_for(cube), stated_in(cube))
    other = Declared(wavelengths_nm=(700, 650, 600, 550, 500, 450))
    np.testing.assert_array_equal(read(tmp_path, text, declared=other)["radiance"], LIGHT[..., ::-1])


def test_a_declared_unit_is_held_against_the_list(tmp_path):
    text = header_text(["wavelength units"])
    with pytest.raises(InputError, match="wavelengths of light"):
        read(tmp_path, text, declared=Declared(wavelength_unit="um"))
    with pytest.raises(InputError, match="declared wavelength-unit: found 'ft'"):
        read(tmp_path, text, declared=Declared(wavelength_unit="ft"))


def test_a_declared_unit_may_repeat_the_headers(tmp_path):
    same, other = Declared(wavelength_unit="nm"), Declared(wavelength_unit="um")
    cube = read(tmp_path, header_text(), declared=same)
    require_used(same, declared_for(cube), stated_in(cube))
    cube = read(tmp_path, header_text(), declared=other)
    with pytest.raises(InputError, match=r"wavelength-unit: found um; expected Nanometers, or none"):
        require_used(other, declared_for(cube), stated_in(cube))


@pytest.mark.parametrize(
    "text",
    [
        "{400, 450, 500, 550, 600, 650,}",
        "{\n400,\n450,\n500,\n550,\n600,\n650,\n}",
        "\n{400, 450, 500, 550, 600, 650}",
        "\n\n  {\n400, 450, 500,\n550, 600, 650\n}",
        "{400, 450, 500,\n; sensor 2, {all of it}\n550, 600, 650}",
        "{400, 450, ; first\n500, 550, ; second\n600, 650} ; third",
        "{ 400 450 500\n550 600 650 }",
        "{400.0,450.0,500.0,550.0,600.0,6.5e2}",
        "{\t400,\t450,\t500,\t550,\t600,\t650}",
        "{{400, 450, 500, 550, 600, 650}}",
    ],
)
def test_lists_are_read_as_they_are_written(tmp_path, text):
    for end in ("\n", "\r\n", "\r"):
        header = header_text(wavelength=text).replace("\n", end)
        np.testing.assert_array_equal(read(tmp_path, header)["wavelength"], NM)


@pytest.mark.parametrize(
    "text", ["{400,,450,500,550,600}", "{a, b}", "{400, nan}", "{400; 450; 500}", "{400,5, 450,5}"]
)
def test_lists_without_meaning_are_refused(tmp_path, text):
    with pytest.raises(InputError, match="wavelength"):
        read(tmp_path, header_text(wavelength=text))


def test_an_entry_without_a_value_leaves_the_next_one(tmp_path):
    text = header_text(after="sensor type =\ndata ignore value =\n").replace(
        "interleave", "acquisition date =\ninterleave"
    )
    np.testing.assert_array_equal(read(tmp_path, text)["radiance"], LIGHT)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "cp1252"])
def test_text_of_several_encodings_is_read(tmp_path, encoding):
    header = header_text(
        wavelength_units="µm", wavelength="{0.4, 0.45, 0.5, 0.55, 0.6, 0.65}", sensor_type="Grüße, 25 °C"
    )
    np.testing.assert_allclose(read(tmp_path, header, encoding=encoding)["wavelength"], NM)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    with pytest.raises(InputError, match="not text"):
        read(tmp_path, header_text().replace("a test", "a\0test"))


# ---- scales


@pytest.mark.parametrize(
    ("entries", "expected", "phrase"),
    [
        ({"data_gain_values": "{2}"}, 2 * LIGHT, "data gain values"),
        ({"data_gain_values": "{1, 2, 3, 4, 5, 6}"}, LIGHT * np.arange(1, 7), "data gain values"),
        ({"data_offset_values": "{0.5, 0, 0, 0, 0, 1}"}, LIGHT + np.array([0.5, 0, 0, 0, 0, 1]), "data offset values"),
        (
            {"data_gain_values": "{.01}", "data_offset_values": "{3}"},
            0.01 * LIGHT + 3,
            "data gain values and data offset values",
        ),
        ({"reflectance_scale_factor": "10000"}, LIGHT / 1e4, "reflectance scale factor"),
        ({"reflectance_scale_factor": "10000.0 ; as integers"}, LIGHT / 1e4, "reflectance scale factor"),
    ],
)
def test_scales_are_applied_and_noted(tmp_path, entries, expected, phrase):
    cube = read(tmp_path, header_text(**entries))
    np.testing.assert_allclose(cube["radiance"], expected, rtol=1e-6)
    assert cube["radiance"].dtype == np.float32
    assert f"applied to the stored numbers: {phrase}" in cube.attrs["reading_notes"]


def test_a_scale_that_may_multiply_or_divide_is_refused(tmp_path):
    header = header_text(radiance_scale_factor="10000")
    with pytest.raises(InputError, match="radiance scale factor: found 10000, a scale of unknown direction"):
        read(tmp_path, header)
    np.testing.assert_array_equal(read(tmp_path, header_text(radiance_scale_factor="1.0"))["radiance"], LIGHT)


@pytest.mark.parametrize("key", ["radiance_units", "measurement_units", "units"])
def test_the_unit_stands_under_the_keys_of_several_programs(tmp_path, key):
    cube = read(tmp_path, header_text(data_units="", **{key: "uW/nm/cm2/sr"}))
    np.testing.assert_allclose(cube["radiance"], 0.01 * LIGHT, rtol=1e-6)


def test_scales_that_change_nothing_are_not_noted(tmp_path):
    header = header_text(data_gain_values="{1,1,1,1,1,1}", data_offset_values="{0}", reflectance_scale_factor="1.0")
    cube = read(tmp_path, header)
    np.testing.assert_array_equal(cube["radiance"], LIGHT)
    assert "reading_notes" not in cube.attrs


def test_scales_come_before_the_unit_and_after_missing_samples(tmp_path):
    values = np.arange(120).reshape(4, 5, 6)
    header = header_text(
        data_type=12, data_units="W/m^2/sr/um", data_ignore_value="7", data_gain_values="{2}", data_offset_values="{7}"
    )
    cube = read(tmp_path, header, values, kind="<u2")
    expected = np.where(values == 7, np.nan, 1e-3 * (2.0 * values + 7))
    np.testing.assert_allclose(cube["radiance"], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"data_gain_values": "{1, 2}"}, "data gain values: found 2 values"),
        ({"data_gain_values": "{0}"}, "numbers above 0"),
        ({"data_gain_values": "{many}"}, "finite numbers"),
        ({"data_offset_values": "{1, 2, 3}"}, "data offset values: found 3 values"),
        ({"reflectance_scale_factor": "-1"}, "numbers above 0"),
        ({"reflectance_scale_factor": "100", "data_gain_values": "{2}"}, "one of the two"),
    ],
)
def test_scales_without_meaning_are_refused(tmp_path, entries, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, header_text(**entries))


@pytest.mark.parametrize("ignored", ["-9999", "0", "65536", "-1.5"])
def test_ignored_values_of_any_range(tmp_path, ignored):
    values = np.arange(120).reshape(4, 5, 6)
    cube = read(tmp_path, header_text(data_type=12, data_ignore_value=ignored), values, kind="<u2")
    assert np.isnan(cube["radiance"]).sum() == (1 if ignored == "0" else 0)


def test_an_ignored_number_of_64_bits_in_samples_of_32(tmp_path):
    values = LIGHT.copy()
    values[1, 2, 3] = np.inf
    cube = read(tmp_path, header_text(data_ignore_value="1.7976931348623157e308"), values)
    assert np.isnan(cube["radiance"].values[1, 2, 3])
    assert np.isnan(cube["radiance"]).sum() == 1


def test_units_of_radiance_are_asked_for(tmp_path):
    with pytest.raises(InputError, match=r"data units: found no unit.*declare units"):
        read(tmp_path, header_text(["data units"]))
    cube = read(tmp_path, header_text(["data units"]), declared=Declared(RADIANCE, 2.0))
    np.testing.assert_allclose(cube["radiance"], 2 * LIGHT)
