"""Tables of a CGATS file, and names of its sets."""

from pathlib import Path

import pytest
from cboxlab.scenes.spectrum_readers._spectrum_reader import InstrumentText
from cboxlab.scenes.spectrum_readers.cgats import _block, _names
from cboxlab.utils.errors import InputError


@pytest.mark.parametrize(
    ("fields", "rows", "names"),
    [
        (["SampleID", "nm400"], [["A1", "0.1"], ["A2", "0.1"]], ["A1", "A2"]),
        (["SampleID", "nm400"], [["A1", "0.1"], ["A1", "0.1"], ["", "0.2"]], ["1", "2", "3"]),
        (["nm400"], [["0.1"], ["0.2"]], ["1", "2"]),
        (["nm400"], [["0.1"]], ["value"]),
    ],
)
def test_sets_without_distinct_names_are_counted_from_1(fields, rows, names):
    assert _names(fields, rows) == names


@pytest.mark.parametrize(
    ("lines", "line"),
    [
        (["x", "BEGIN_DATA", "END_DATA", "BEGIN_DATA"], 4),
        (["x", "END_DATA"], 2),
        (["x"], 1),
        (["END_DATA", "BEGIN_DATA"], 2),
    ],
)
def test_a_table_that_is_not_there_once_is_named_by_its_last_mark(lines, line):
    with pytest.raises(InputError, match=f"line {line}: "):
        _block(InstrumentText(Path("a.txt"), "\n".join(lines)), "DATA")
