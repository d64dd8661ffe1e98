"""``cbox import``: what was understood of an instrument's file, and the plain CSV."""

import json

import numpy as np
import pytest
from cboxlab.scenes import read_spectra
from helpers.files.instrument_texts import INSTRUMENTS


@pytest.mark.parametrize("key", INSTRUMENTS)
def test_the_plain_table_has_the_same_spectra(tmp_path, cbox, key):
    file, out = tmp_path / "measured.txt", tmp_path / "table.csv"
    file.write_text(INSTRUMENTS[key].text)
    code, output, _ = cbox("import", file, "--out", out)
    assert code == 0 and "Format: " in output and str(out) in output.replace("\n", "")
    assert out.read_text().startswith("wavelength_nm,")
    measured, plain = read_spectra(file), read_spectra(out)
    assert list(measured) == list(plain)
    for name in measured:
        assert np.array_equal(measured[name].wavelength_nm, plain[name].wavelength_nm)
        assert np.array_equal(measured[name].values, plain[name].values)
    again = tmp_path / "again.csv"
    assert cbox("import", out, "--out", again)[0] == 0
    assert again.read_text() == out.read_text()


def test_the_summary(tmp_path, cbox):
    file, record = tmp_path / "measured.csv", tmp_path / "spectra.json"
    file.write_text(INSTRUMENTS["european"].text)
    code, output, _ = cbox("import", file, "--column", "grey tile", "--json", record)
    assert code == 0
    for word in ("table with a header", "reflectance", "per cent", "400 to 420", "0.1975", "0.2025", "divided by 100"):
        assert word in " ".join(output.split())
    (spectrum,) = json.loads(record.read_text())["spectra"]
    assert spectrum["factor"] == 0.01 and spectrum["values"] == pytest.approx([0.1975, 0.2, 0.2025])


def test_a_plain_table_keeps_its_numbers(tmp_path, cbox):
    """The header of a plain CSV was never read for units."""
    file, out = tmp_path / "plain.csv", tmp_path / "out.csv"
    file.write_text("wavelength_nm,Reflectance (%)\n400.0,50.0\n410.0,60.0\n")
    assert cbox("import", file, "--out", out)[0] == 0
    assert out.read_text() == file.read_text()


@pytest.mark.parametrize(
    ("arguments", "phrases"),
    [
        (["{t}/none.csv"], ["none.csv", "no such file"]),
        (["{t}/a.csv", "--out", "{t}/a.csv"], ["a.csv", "another file"]),
        (["{t}/a.csv", "--column", "paint"], ["--column", "paint A"]),
        (["{t}/a.csv", "--out", "{t}/b.csv"], ["--column", "other wavelengths"]),
    ],
)
def test_mistakes_are_one_line(tmp_path, cbox, arguments, phrases):
    text = INSTRUMENTS["cary"].text.replace("420.00,12.5", "425.00,12.5")
    (tmp_path / "a.csv").write_text(text)
    code, _, err = cbox("import", *(argument.format(t=tmp_path) for argument in arguments))
    assert code == 2 and err.count("\n") == 1
    assert all(word in err for word in phrases)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
