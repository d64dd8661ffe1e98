"""A slip in a TOML file is reported with its line and how it is mended; JSON without numbers beyond a float."""

import pytest
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_json_object, read_toml
from hypothesis import given
from hypothesis import strategies as st

SLIPS = {
    "exposure_s = 0,5": "decimal point, not a comma",
    "exposure_s = .5": "both sides of the decimal point",
    "exposure_s = 2.": "both sides of the decimal point",
    'file = "frames\\xa.tif"': "with / in place of \\",
    "file = frames/a.tif": "in quotes",
    "settled = True": "small letters",
    "bit depth = 12": "no spaces",
    '[flat]\nband = "a"\n[flat]\nband = "b"': "double brackets, [[flat]]",
    'flat = 3\n[[flat]]\nband = "a"': "flat",
}


@pytest.mark.parametrize("text", SLIPS)
def test_a_slip_is_reported_with_its_line_and_its_mending(tmp_path, text):
    path = tmp_path / "capture.toml"
    path.write_text(f'format = "capture/1"\n{text}\n')
    with pytest.raises(InputError) as refusal:
        read_toml(path, "a capture")
    assert SLIPS[text] in str(refusal.value) and "Line " in str(refusal.value)


def test_a_backslash_that_makes_a_control_character_is_reported(tmp_path):
    path = tmp_path / "capture.toml"
    path.write_text('[[dark]]\nfiles = ["dark\\frame.tif"]\n')
    with pytest.raises(InputError, match=r"dark\[0\]\.files\[0\].*write paths with /"):
        read_toml(path, "a capture")


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("toml") / "a.toml"
    path.write_text(text, encoding="utf-8")
    try:
        read_toml(path, "a file")
    except InputError as fault:
        assert "a.toml" in str(fault)


@pytest.mark.parametrize("digits", [300, 301, 5000])
def test_integers_of_json_fit_a_float(tmp_path, digits):
    """One of 5000 digits Python itself refuses."""
    path = tmp_path / "a.json"
    path.write_text('{"a": ' + "9" * digits + "}")
    if digits <= 300:
        assert float(read_json_object(path, "a file")["a"]) == pytest.approx(1e300)
    else:
        with pytest.raises(InputError, match="digits"):
            read_json_object(path, "a file")
