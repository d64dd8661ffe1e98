"""Spectra of instruments: each format with its numbers, and one line for what is uncertain."""

import os
from pathlib import Path

import colour
import numpy as np
import pytest
from cboxlab.scenes import read_spectra, read_spectrum
from cboxlab.scenes.spectrum_readers import (
    InstrumentText,
    read_instrument_file,
    recognised_reader,
    spectrum_reader_catalogue,
)
from cboxlab.utils.errors import InputError
from helpers.files.instrument_texts import INSTRUMENTS
from hypothesis import given
from hypothesis import strategies as st

#: Files that colour-science tests its readers with.
RESOURCES = Path(colour.__file__).parent / "io" / "tests" / "resources"


def write(folder, text, name="measured.txt"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("key", INSTRUMENTS)
def test_a_file_of_an_instrument_is_read_with_its_numbers(tmp_path, key):
    instrument = INSTRUMENTS[key]
    path = write(tmp_path, instrument.text)
    assert recognised_reader(InstrumentText(path, instrument.text)).id == instrument.reader
    first = read_instrument_file(path).spectra[0]
    assert (first.name, first.quantity, first.unit) == (instrument.name, instrument.quantity, instrument.unit)
    assert first.wavelength_nm == pytest.approx(instrument.wavelength_nm, rel=1e-12)
    assert first.values == pytest.approx(instrument.values, rel=1e-12)
    column = read_spectrum(tmp_path, f"measured.txt:{instrument.name}")
    assert np.array_equal(column.values, first.values)


@pytest.mark.parametrize("key", INSTRUMENTS)
def test_the_ending_and_windows_lines_change_nothing(tmp_path, key):
    text = INSTRUMENTS[key].text
    content = read_spectra(write(tmp_path, text))
    other = read_spectra(write(tmp_path, b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode(), "measured.csv"))
    assert list(content) == list(other)
    for name in content:
        assert np.array_equal(content[name].values, other[name].values)


def test_factors_of_jcamp_count_for_every_point(tmp_path):
    """XFACTOR of lines that begin with an abscissa, and both factors of pairs."""
    plain, points = INSTRUMENTS["jcamp"].text, INSTRUMENTS["jcamp_points"].text
    scaled = plain.replace("XFACTOR=1.0", "XFACTOR=10").replace("420 305", "42 305").replace("400 105", "40 105")
    pairs = points.replace("##NPOINTS", "##XFACTOR=0.5\n##YFACTOR=2\n##NPOINTS")
    for text, other, x, y in ((plain, scaled, 1.0, 1.0), (points, pairs, 0.5, 2.0)):
        first, second = (read_instrument_file(write(tmp_path, content)).spectra[0] for content in (text, other))
        assert second.wavelength_nm == pytest.approx(x * first.wavelength_nm, rel=1e-12)
        assert second.values == pytest.approx(y * first.values, rel=1e-12)


def test_every_format_has_a_file_here():
    assert {instrument.reader for instrument in INSTRUMENTS.values()} == set(spectrum_reader_catalogue())


def test_further_spectra_of_a_file():
    def names(key, folder=Path(os.devnull)):
        source = InstrumentText(folder, INSTRUMENTS[key].text)
        return [spectrum.name for spectrum in recognised_reader(source).read(source).spectra]

    assert names("xrite") == ["red", "green"]
    assert names("cxf") == ["white wall", "red wall"]
    assert names("cs2000") == ["lamp centre", "lamp edge"]
    assert names("cary") == ["paint A", "paint B"]
    assert names("european") == ["white tile", "grey tile"]


@pytest.mark.parametrize(
    ("name", "reader"),
    [
        ("ESPD2021_0104_231446.xls", colour.SpectralDistribution_UPRTek),
        ("RANDOM_001_02._3262K.csv", colour.SpectralDistribution_Sekonic),
        ("Fluorescent.spdx", colour.SpectralDistribution_IESTM2714),
    ],
)
def test_colour_science_reads_the_same(name, reader):
    if not (RESOURCES / name).is_file():
        pytest.skip("colour-science without its test files")
    expected = reader(str(RESOURCES / name)).read()
    (spectrum,) = read_instrument_file(RESOURCES / name).spectra
    assert np.array_equal(spectrum.wavelength_nm, expected.wavelengths)
    assert np.array_equal(spectrum.values, expected.values)


def test_colour_science_reads_the_same_samples_of_xrite():
    path = RESOURCES / "X-Rite_Digital_Colour_Checker.txt"
    if not path.is_file():
        pytest.skip("colour-science without its test files")
    expected = colour.read_sds_from_xrite_file(str(path))
    spectra = read_spectra(path)
    assert list(spectra) == list(expected)
    assert all(np.array_equal(spectra[name].values, expected[name].values) for name in spectra)


@pytest.mark.parametrize(("key", "once"), [("uprtek", 1), ("sekonic", 2)])
def test_the_last_of_repeated_spectra_is_read_and_counted(tmp_path, key, once):
    text = INSTRUMENTS[key].text.rstrip("\n") + "\n"
    for repeats in (1, 3):
        instrument_spectra = read_instrument_file(write(tmp_path, repeats * text))
        assert instrument_spectra.spectra[0].values == pytest.approx(INSTRUMENTS[key].values)
        counted = [note for note in instrument_spectra.notes if "spectra of the file" in note]
        assert counted == [f"The last of {repeats * once} spectra of the file."] * (repeats * once > 1)


# Of each format: what is changed, into what, and what the message names.
MALFORMED = [
    ("uprtek", "381nm\t0.5", "381nm\t", "line 8", "finite number"),
    ("uprtek", "381nm\t0.5", "381nm\t0.5\t0.6", "line 8", "2 values"),
    ("uprtek", "381nm\t0.5", "383nm\t0.5", "line 9", "382 nm after 383 nm"),
    ("uprtek", "0.75", "OVER", "line 9", "'OVER'"),
    ("uprtek", "381nm\t0.5\n382nm\t0.75\n", "", "line 7", "at least two"),
    ("sekonic", "0.0012", "---", "line 9", "'---'"),
    ("sekonic", "Ambient", "Flash", "line 4", "Ambient"),
    ("sekonic", "382[nm],0.0014", "381[nm],0.0014", "line 10", "381 nm after 381 nm"),
    ("sekonic", "0.0012", "nan", "line 9", "'nan'"),
    ("sekonic", "0.0012", "0,0012", "line 9", "decimal point"),
    ("xrite", "0.2\t0.3", "0.2", "line 10", "4 cells"),
    ("xrite", "NUMBER_OF_SETS\t2", "NUMBER_OF_SETS\t3", "line 8", "truncated"),
    ("xrite", "END_DATA\n", "", "line 9", "END_DATA"),
    ("xrite", "nm400\tnm410\tnm420", "LAB_L\tLAB_A\tLAB_B", "line 6", "no spectral fields"),
    ("xrite", "nm410", "nm400", "line 10", "400 nm after 400 nm"),
    ("ti3", "20.5", "x", "line 18", "'x'"),
    ("ti3", '"OUTPUT"', '"DISPLAY"\nSPECTRAL_NORM "100"', "line 6", "SPECTRAL_NORM"),
    ("sp", '"1.000000"', '"7.0"', "line 9", "SPECTRAL_NORM 7"),
    ("sp", '"EMISSION"', '"REFLECTIVE"', "line 18", "per cent"),
    ("sp", "0.5 1.25", '"0.5 1.25', "line 18", "quotation"),
    ("cxf", "0.85", "0,85", "line 8", "'0,85'"),
    ("cxf", 'Increment="10"', "", "line 8", "no Increment"),
    ("cxf", "0.80 0.85", "80 85", "line 8", "reflectance of 85"),
    ("cxf", "</cc:CxF>", "", "line 28", "damaged"),
    ("cxf", "<cc:CxF xmlns", '<!DOCTYPE x [<!ENTITY a "b">]>\n<cc:CxF xmlns', "line 2", "DOCTYPE"),
    ("tm27", "1.3e-2", "1.3e-2 W", "line 12", "'1.3e-2 W'"),
    ("tm27", "<SpectralQuantity>radiance", "<SpectralQuantity>brightness", "line 7", "one of"),
    ("tm27", '"405.5"', '"399"', "line 11", "399 nm after 400 nm"),
    ("tm27", "0.012", "0.0\n12", "line 11", r"'0.0\n12'"),
    ("tm27", "</Header>", "</Head>", "line 6", "damaged"),
    ("tm27", "<IESTM2714 xmlns", '<!DOCTYPE x [<!ENTITY a "b">]>\n<IESTM2714 xmlns', "line 2", "DOCTYPE"),
    ("pr650", "0000,1", "0018,1", "line 1", "quality code 18"),
    ("pr650", "0000,1", "0000,0", "line 1", "SI units"),
    ("pr650", "0384.,2.000e-05", "0384.", "line 4", "'0384.'"),
    ("pr650", "2.000e-05", "2.000e-0x", "line 4", "finite number"),
    ("pr650", "0384.", "0380.", "line 4", "380 nm after 380 nm"),
    ("cs2000", "120.5,", "", "line 4", "11 cells"),
    ("cs2000", "Unit,W/(sr m2 nm)", "Unit,", "line 3", "without a unit"),
    ("cs2000", "lamp edge", "lamp centre", "measured.txt", "a second time"),
    ("cs2000", "0.002,", "Error,", "line 4", "'Error'"),
    ("cs2000", "380,381,", "381,381,", "line 4", "381 nm after 381 nm"),
    ("ocean_optics", "339.46\t-1.5", "339.46\tsaturated", "line 10", "saturated"),
    ("ocean_optics", "Spectrum: 3", "Spectrum: 2048", "line 7", "truncated"),
    ("ocean_optics", "XAxis mode: Wavelengths", "XAxis mode: Pixels", "line 6", "'Pixels'"),
    ("ocean_optics", "339.46", "339.09", "line 10", "339.09 nm after 339.09 nm"),
    ("ocean_optics", "Data from", ">>>>>Begin Spectral Data<<<<<\nData from", "line 9", "2 marks"),
    ("cary", "40.25", "OVER", "line 4", "OVER"),
    ("cary", "Wavelength (nm),%R,Wavelength (nm),%R,", "Wavelength (x),%R,Wavelength,%R,", "without a unit", "nm"),
    (
        "cary",
        "Wavelength (nm),%R,Wavelength (nm),%R,",
        "Wavenumber (cm-1),Counts,Wavenumber (cm-1),Counts,",
        "Wavenumber",
        "nm",
    ),
    (
        "cary",
        "Wavelength (nm),%R,Wavelength (nm),%R,",
        "Wavelength (nm),Abs,Wavelength (nm),Abs,",
        "absorbance",
        "linear",
    ),
    (
        "cary",
        "Wavelength (nm),%R,Wavelength (nm),%R,",
        "Wavelength (nm),Reflectance,Wavelength (nm),%R,",
        "line 3",
        "per cent",
    ),
    ("cary", "410.00,40.25,410.00", "430.00,40.25,410.00", "line 4", "430 nm after 420 nm"),
    ("european", "20,25", "20.25", "line 5", "finite numbers"),
    ("european", "% Reflectance;% Reflectance", "%;%", "per cent", "without the quantity"),
    ("european", "nm;% R", "furlong;% R", "without a unit", "nm"),
    ("european", "grey tile", "white tile", "white tile", "a second time"),
    ("european", "Wellenlänge;white tile;grey tile\nnm;% Reflectance;% Reflectance\n", "", "header", "wavelength"),
    ("spreadsheet", "(um)", "(nm)", "line 2", "a wavelength of 0.4 nm"),
    ("spreadsheet", "0.41\t2.5", "0.41", "line 3", "0.41"),
]


@pytest.mark.parametrize(("key", "old", "new", "location", "fault"), MALFORMED)
def test_what_is_uncertain_is_refused_in_one_line(tmp_path, key, old, new, location, fault):
    text = INSTRUMENTS[key].text
    assert old in text
    at = text.rfind(old) if key == "sekonic" else text.find(old)
    path = write(tmp_path, text[:at] + new + text[at + len(old) :])
    with pytest.raises(InputError) as error:
        read_spectra(path)
    message = str(error.value)
    assert "measured.txt" in message and location in message and fault in message
    assert "\n" not in message and error.value.hint


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("nm\tR\n400\t1,234\n410\t2,345\n", "thousands"),
        ("<html><body>400 1</body></html>", "a web page"),
        ("Model Name\tx\n380nm\t1\n381nm\t1\nBEGIN_DATA_FORMAT\n", "the marks of"),
        ("nothing here", "no table of numbers"),
        (
            "CGATS.17\nBEGIN_DATA_FORMAT\nnm380 nm390\nEND_DATA_FORMAT\nEND_DATA\nBEGIN_DATA\n",
            "line 6: found 1 BEGIN_DATA",
        ),
        ("Wavelength\tRadiance [W/(sr m2 nm)]\n4000\t0.1\n4100\t0.2\n", "wavelengths without a unit"),
        ("wl (nm);a\n400;1\n410;2\nsecond\n420;3\n", "second"),
        (INSTRUMENTS["jcamp"].text.replace("NANOMETERS", "1/CM"), "XUNITS '1/CM'"),
        (INSTRUMENTS["jcamp"].text.replace("REFLECTANCE", "ABSORBANCE"), "YUNITS 'ABSORBANCE'"),
        (INSTRUMENTS["jcamp"].text.replace("420 305 205", "420 C05B05"), "without compression"),
        (INSTRUMENTS["jcamp"].text.replace("400 105\n", ""), "2 points; expected 3"),
        (INSTRUMENTS["jcamp"].text.replace("400 105", "390 105"), "the abscissa 390; expected 400"),
        (INSTRUMENTS["perkin_elmer"].text.replace("%R", "A"), "the ordinate 'A'"),
        (INSTRUMENTS["perkin_elmer"].text.replace("#DATA", "#END"), "0 sections #DATA"),
        ("nm;Absorbance\n400;0.3\n410;0.4\n", "absorbance"),
        (b"nm;R\n400;0.3\n410;0.4\n\x81", "not UTF-8 text"),
    ],
)
def test_other_files_are_refused(tmp_path, text, fault):
    with pytest.raises(InputError, match=fault):
        read_spectra(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "name", "values"),
    [
        ('"tile.spc - RawData"\n"Wavelength nm.","R%"\n400.00,12.5\n401.00,12.6\n', "R%", [0.125, 0.126]),
        ("nm,%R\n401.0,85.2\n400.0,85.1\n", "%R", [0.851, 0.852]),
        ("PE UV   SPECTRUM    ASCII\n#GR\nnm\n%R\n#DATA\n401\t85.2\n400\t85.1\n", "reflectance", [0.851, 0.852]),
        ("TITLE\tx\nXUNITS\tNANOMETERS\nYUNITS\t%T\nNPOINTS\t2\nXYDATA\n401\t85.2\n400\t85.1\n", "%T", [0.851, 0.852]),
        ("Wavelength (nm) %T\n400 85.1\n401 85.2\n", "%T", [0.851, 0.852]),
        ("lambda (Angstrom), flux\n4000, 1\n4010, 2\n", "flux", [1, 2]),
        ("Bench 3;humidity 50 %\nnm;Reflectance\n400;0.4\n401;0.5\n", "Reflectance", [0.4, 0.5]),
        ("nm,R,G\n400,0.1,0.2\n401,0.1,0.2\n", "R", [0.1, 0.1]),
        ("# wavelength_nm value\n400 1\n401 2\n", "value", [1, 2]),
        ("Wellenlänge (µm);Weiß %R\n0,400;85,1\n0,401;85,2\n".encode("cp1252"), "Weiß %R", [0.851, 0.852]),
        ("Wavelength (nm);% R\n400;85,1 %\n401;85,2 %\n", "% R", [0.851, 0.852]),
        ("Wavelength (nm),QE\n400,85.1%\n401,85.2%\n", "QE", [0.851, 0.852]),
        ("Wavelength (nm)\t%R\r\n400\t85.1\r\n401\t85.2\r\n".encode("utf-16"), "%R", [0.851, 0.852]),
        ("nm;radiance/W/(sr m² nm)\n400;1\n401;2\n", "radiance/W/(sr m² nm)", [1, 2]),
        ("Wave;Sample;Dark\n[nm];[counts];[counts]\n\n400;1;9\n401;2;9\n", "Sample", [1, 2]),
        ("Pixel,Wavelength[nm],Intensity[a.u.]\n1,400,1\n2,401,2\n", "Intensity[a.u.]", [1, 2]),
        ("#Time;0.1\n#XAxisUnit;nm_air\n#YAxisUnit;Intensity\n400;1\n401;2\n", "Intensity", [1, 2]),
        ("Ev;123,4 lx\n\nnm;W/(m2 nm)\n400;1,5\n401;2,5\n", "W/(m2 nm)", [1.5, 2.5]),
        ("Wavelength [nm];E(λ) [mW/m²/nm]\n400;1\n401;2\n", "E(λ) [mW/m²/nm]", [1, 2]),
    ],
)
def test_tables_of_spectrophotometers(tmp_path, text, name, values):
    spectrum = read_instrument_file(write(tmp_path, text)).spectra[0]
    assert spectrum.name == name
    assert spectrum.wavelength_nm == pytest.approx([400, 401], rel=1e-12)
    assert spectrum.values == pytest.approx(values, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("nm;QE %\n400;50\n410;60\n", "per cent in 'QE %'"),
        ("nm;R/T ratio %\n400;1\n410;2\n", "per cent"),
        ("nm;absorptance (%)\n400;1\n410;2\n", "per cent"),
        ("nm a\n400 1 000\n410 2 000\n", "without a header"),
        ("# Mode: %R\nnm;tile\n400;40\n410;45\n", "reflectance of 45"),
        ("nm,R,T\n400,25%,20\n410,35%,30\n", "behind every value, or behind none"),
        ("nm;R\n400%;25\n410%;35\n", "behind every value, or behind none"),
        ("nm;R\n400;25\n410;35%\n", "line 3: found '410;35%'"),
        ("nm;OD\n400;2.5\n410;3.5\n", "absorbance"),
        ('nm,counts\n400,"1,400"\n410,"1,500"\n', "thousands"),
        ("nm,r\n400,0.5\n410,-1.23e34\n", "line 3: found -1.23e"),
    ],
)
def test_uncertain_tables_are_refused(tmp_path, text, fault):
    with pytest.raises(InputError, match=fault):
        read_spectra(write(tmp_path, text))


WIDE = ",".join(f"{w}nm" for w in range(400, 480, 10))
PERCENT = ",".join(str(p) for p in range(10, 90, 10))


@pytest.mark.parametrize(
    ("text", "spectra"),
    [
        # wavelengths with their unit, and no header
        ("CS-2000A\nSpeed mode,Normal\nLv,5.2E+01\n400nm,1.5\n410nm,2.5\n", {"value": [1.5, 2.5]}),
        ("E [lx]\t521\n\n400 [nm]\t1,5\n410 [nm]\t2,5\n", {"value": [1.5, 2.5]}),
        ("Model Name,MK350\nLUX,521\n400[nm],1.5\n410[nm],2.5\n", {"irradiance": [1.5, 2.5]}),
        # empty columns in front, and a first column that names its unit alone
        ("Typical data,,\n,,Wavelength (nm),% Transmission\n,,400,50\n,,410,60\n", {"% Transmission": [0.5, 0.6]}),
        ("Reference,,\nWvlgth nm,Etr W*m-2*nm-1\n400,1.5\n410,2.5\n", {"Etr W*m-2*nm-1": [1.5, 2.5]}),
        # decimal commas between quotation marks
        ('nm,tile\n"400","0,25"\n"410","0,35"\n', {"tile": [0.25, 0.35]}),
        # Jaz
        (
            ">>>>>Begin Processed Spectral Data<<<<<\nW\tD\tS\tP\n400\t10\t50\t1.5\n410\t11\t60\t2.5\n",
            {"D": [10, 11], "S": [50, 60], "P": [1.5, 2.5]},
        ),
        # samples in rows, the same sample with and without gloss
        (
            f"Reflectance (%)\nData Name,Mode,{WIDE}\nred,SCI,{PERCENT}\nred,SCE,{PERCENT}\n",
            {"red SCI": np.arange(1, 9) / 10, "red SCE": np.arange(1, 9) / 10},
        ),
        (f"ID,{WIDE.replace('nm', '')}\nred,{PERCENT.replace('0', '')}\n".replace("1,2", "0.1,0.2"), None),
    ],
)
def test_files_as_instruments_write_them(tmp_path, text, spectra):
    path = write(tmp_path, text)
    if spectra is None:
        with pytest.raises(InputError, match="values up to 8 of no stated quantity"):
            read_instrument_file(path)
        return
    got = {spectrum.name: spectrum for spectrum in read_instrument_file(path).spectra}
    assert list(got) == list(spectra)
    for name, values in spectra.items():
        assert got[name].values == pytest.approx(values, rel=1e-12)
        assert got[name].wavelength_nm[:2] == pytest.approx([400, 410])


def test_three_decimals_with_commas_are_read_where_thousands_make_no_wavelength(tmp_path):
    path = write(tmp_path, "nm;tile\n400,000;95,123\n410,000;96,125\n")
    assert read_spectra(path)["tile"].values == pytest.approx([95.123, 96.125])


def test_a_large_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="at most 8388608 bytes"):
        read_instrument_file(write(tmp_path, "#" + "x" * 2**23))


def test_a_file_of_many_lines_is_refused(tmp_path):
    with pytest.raises(InputError, match="at most 100000"):
        read_instrument_file(write(tmp_path, "nm;a\n" + "400;1\n" * 100_001))


def test_elements_without_end_are_refused(tmp_path):
    text = '<IESTM2714 version="1">' + "<a>" * 100_000
    with pytest.raises(InputError, match="nested too deeply"):
        read_instrument_file(write(tmp_path, text))


SAMPLES = st.lists(
    st.tuples(st.integers(3000, 9000), st.integers(-(10**6), 10**6)),
    min_size=3,
    max_size=20,
    unique_by=lambda row: row[0],
).map(sorted)


@given(
    samples=SAMPLES,
    style=st.sampled_from([(";", ","), ("\t", ","), (";", "."), ("\t", "."), (",", "."), ("  ", "."), ("  ", ",")]),
    descending=st.booleans(),
    comments=st.lists(st.sampled_from(["# made by hand", "// 12 3", "", "! 400"]), max_size=3),
    units=st.booleans(),
    unit=st.sampled_from([("nm", 1), ("um", 1000)]),
)
def test_one_spectrum_in_any_spelling(tmp_path_factory, samples, style, descending, comments, units, unit):
    """Wavelengths in tenths of nm and values in 1e-4, so that each spelling holds the same decimal number."""
    (separator, mark), (name, factor) = style, unit
    rows = samples[::-1] if descending else samples
    header = (
        [f"wavelength{separator}lamp", f"{name}{separator}W/m2/nm"] if units else [f"Wavelength({name}){separator}lamp"]
    )
    lines = [*comments, *header]
    lines += [f"{at / 10 / factor:.5f}{separator}{value / 1e4:.4f}".replace(".", mark) for at, value in rows]
    path = write(tmp_path_factory.mktemp("styles"), "\n".join(lines))
    spectrum = read_spectra(path)["lamp"]
    assert spectrum.wavelength_nm == pytest.approx([at / 10 for at, _ in samples], rel=1e-12)
    assert spectrum.values == pytest.approx([value / 1e4 for _, value in samples], rel=1e-12)


@given(
    key=st.sampled_from(sorted(INSTRUMENTS)),
    start=st.floats(0, 1),
    size=st.integers(0, 30),
    junk=st.text("0123456789.,;\t\n<>\"'nm% ea-", max_size=10),
)
def test_a_damaged_file_is_an_input_error_or_a_sound_table(tmp_path_factory, key, start, size, junk):
    text = INSTRUMENTS[key].text
    at = int(start * len(text))
    path = write(tmp_path_factory.mktemp("damaged"), text[:at] + junk + text[at + size :])
    try:
        spectra = read_spectra(path)
    except InputError as error:
        assert str(path) in str(error) and "\n" not in str(error)
    else:
        assert all(np.all(np.diff(s.wavelength_nm) > 0) and np.all(np.isfinite(s.values)) for s in spectra.values())
