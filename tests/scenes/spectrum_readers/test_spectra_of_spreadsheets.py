"""Tables with traces of unequal length, wavenumbers, separators of thousands, and values that look wrong."""

import pytest
from cboxlab.scenes.spectrum_readers import read_instrument_file
from cboxlab.utils.errors import InputError

PAIRS = "A,,B,\nWavelength (nm),%T,Wavelength (nm),%T\n"


def content(folder, text):
    path = folder / "measured.csv"
    path.write_text(text, encoding="utf-8")
    return read_instrument_file(path)


@pytest.mark.parametrize("ended", ["420,12,,\n", ",,520,12\n"])
def test_a_trace_that_ends_first_cuts_no_other(tmp_path, ended):
    traces = content(tmp_path, f"{PAIRS}400,10,500,20\n410,11,510,21\n{ended}").spectra
    assert sorted(len(trace.values) for trace in traces) == [2, 3]
    longest = max(traces, key=lambda trace: len(trace.values))
    assert longest.wavelength_nm[-1] % 100 == 20 and longest.values[-1] == pytest.approx(0.12)


@pytest.mark.parametrize("faulty", [f"{PAIRS}400,10,500,20\n410,11,510,\n", "nm,a,b,c\n400,1,2,3\n420,1,,\n"])
def test_an_empty_cell_is_no_end_of_a_trace(tmp_path, faulty):
    with pytest.raises(InputError, match="cell"):
        content(tmp_path, faulty)


def test_wavenumbers_of_fractions_become_wavelengths(tmp_path):
    first = content(tmp_path, "wavenumber (cm^-1),transmittance\n12500,0.3\n20000,0.2\n25000,0.1\n").spectra[0]
    assert first.wavelength_nm == pytest.approx([400, 500, 800]) and first.values == pytest.approx([0.1, 0.2, 0.3])
    with pytest.raises(InputError, match="wavenumber"):
        content(tmp_path, "wavenumber (cm^-1),radiance\n12500,0.3\n25000,0.1\n")


@pytest.mark.parametrize("text", ["nm;Counts\n400;1.102,41\n410;999,50\n", "nm;Counts\n400;1,102.41\n410;999.50\n"])
def test_thousands_next_to_a_decimal_mark_are_certain(tmp_path, text):
    assert content(tmp_path, text).spectra[0].values == pytest.approx([1102.41, 999.5])


def test_values_that_look_wrong_are_named(tmp_path):
    rows = [(400 + k, min(9 * (400 + k), 4095)) for k in range(70)]
    for text, note in (
        ("nm,%R\n400,0.1\n410,0.78\n", "its largest number is 0.78"),
        ("nm,counts\n" + "".join(f"{x},{y}\n" for x, y in rows), "4095 in all 15 samples from 455 to 469 nm"),
    ):
        assert any(note in sentence for sentence in content(tmp_path, text).notes)
    sound = content(tmp_path, "nm,%R\n400,0.1\n410,1.78\n").notes + content(tmp_path, "nm,lux\n400,300\n410,9\n").notes
    assert not any("number is" in note or "saturated" in note for note in sound)


def test_the_mode_of_ocean_optics_states_quantity_and_unit(tmp_path):
    begin = ">>>>>Begin Processed Spectral Data<<<<<\n400\t1\n401\t2\n"
    first = content(tmp_path, f"Processing: Absolute Irradiance, µW/cm^2/nm\n{begin}").spectra[0]
    assert (first.quantity, first.unit) == ("irradiance", "µW/cm^2/nm")


@pytest.mark.parametrize(
    ("start", "kind"),
    [(b"\x89PNG\0", "a picture"), (b"PK\x03\x04\0", "workbook"), (b"", "empty"), (b"nm\n4\n5\n", "one column")],
)
def test_a_file_that_is_no_table_is_named_for_what_it_is(tmp_path, start, kind):
    (tmp_path / "measured.csv").write_bytes(start)
    with pytest.raises(InputError, match=kind):
        read_instrument_file(tmp_path / "measured.csv")


@pytest.mark.parametrize(
    ("text", "name", "quantity", "first"),
    [
        # the unit of the values names the quantity
        ("nm,lamp [mW/nm]\n400,1\n410,2\n", "lamp [mW/nm]", "radiant flux", (400, 1)),
        ("nm;E [W/(sqm*nm)]\n400;1.5E-0003\n410;2\n", "E [W/(sqm*nm)]", "irradiance", (400, 1.5e-3)),
        ("nm\tI [W/sr/nm]\n400\t1\n410\t2\n", "I [W/sr/nm]", "radiant intensity", (400, 1)),
        ("nm\tL (uW cm-2 sr-1 nm-1)\n400\t1\n410\t2\n", "L (uW cm-2 sr-1 nm-1)", "radiance", (400, 1)),
        # the numbers leave one unit of wavelengths
        ("wavelength,a\n0.4,1\n0.41,2\n", "a", "", (400, 1)),
        ("Wavelength\ta\n380\t1\n410\t2\n", "a", "", (380, 1)),
        # columns that are blank, and a second axis of the same samples
        ("Pixel;Wavelength;Wavenumber;Raman;raw;\n0;400;25000; ;7;\n1;410;24390; ;8;\n", "raw", "", (400, 7)),
        ("nm,,a\n400,,1\n410,,2\n", "a", "", (400, 1)),
        # axes stated above the table
        (
            "X Units: Wavelength (micrometers)\nY Units: Reflectance (percent)\n\n0.4\t36\n0.5\t40\n",
            None,
            "reflectance",
            (400, 0.36),
        ),
        ('"File: a"\n"Watts/m^2/nm"\n 380.0  1.5E-05\n 382.0  2E-05\n', "Watts/m^2/nm", "irradiance", (380, 1.5e-5)),
        # percent of a maker
        (
            "HunterLab EasyMatch\tRSIN\nID\t400 nm\t410 nm\t420 nm\t430 nm\t440 nm\t450 nm\t460 nm\t470 nm\n"
            "paper\t88\t1\t1\t1\t1\t1\t1\t1\n",
            "paper",
            "reflectance",
            (400, 0.88),
        ),
    ],
)
def test_what_a_file_states_otherwise_is_read(tmp_path, text, name, quantity, first):
    path = tmp_path / "file.txt"
    path.write_text(text)
    spectrum = read_instrument_file(path).spectra[0]
    assert (spectrum.name, spectrum.quantity) == (name or spectrum.name, quantity)
    assert (spectrum.wavelength_nm[0], spectrum.values[0]) == pytest.approx(first, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("nm,A\n400,2.5\n410,0.1\n", "symbol of absorbance"),
        ("wl,n\n0.4,1.47\n0.5,1.46\n", "symbol of a refractive index"),
        ("XAxisUnit;nm_vac\nYAxisUnit;dBm\n640;-62\n641;-60\n", "level in decibel"),
        ("wl,n\n0.4,1.4\n0.5,1.4\nwl,k\n0.4,1\n0.5,1\n", "a second table below it"),
        ("nm,R\n400,5,0,12\n405,5,0,13\n", "comma is separator and decimal mark"),
        ("IESNA:LM-63-2002\nTILT=NONE\n1 2 3\n4 5 6\n", "photometric file"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12\n", "git lfs pull"),
        ("wavelength_nm,a\n0.4,1\n0.7,2\n", "wavelengths in um"),
        ("nm;a\n400;1\n\n410;;2\n", "line 4"),
    ],
)
def test_what_is_no_spectrum_of_light_is_named(tmp_path, text, fault):
    path = tmp_path / "file.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=fault):
        read_instrument_file(path)
