"""Names of the sets of a CGATS file."""

import pytest
from cboxlab.scenes.spectrum_readers.cgats import _names


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
