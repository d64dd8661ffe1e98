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
