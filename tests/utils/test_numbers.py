"""Numbers in texts: what a table holds, and nothing that Python alone would read."""

import math
from pathlib import Path

import numpy as np
import pytest
from cboxlab.utils.numbers import json_value, number_of, whole_number_of
from hypothesis import given
from hypothesis import strategies as st

#: Python's ``float`` or ``int`` reads most of these.
REFUSED = ["4_00", "1_0.5", "nan", "inf", "-Infinity", "٤٠٠", "４00", "0x10", "1e", "", ".", "1,5", "1 2", "1" * 101]


@pytest.mark.parametrize("text", REFUSED)
def test_what_no_table_holds_is_no_number(text):
    assert math.isnan(number_of(text)) and whole_number_of(text) is None


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_is_read_to_the_bit(number):
    assert number_of(f" {number!r}\t") == number


@given(st.integers(-(10**60), 10**60))
def test_every_whole_number_is_read(number):
    assert whole_number_of(f" {number:+d} ") == number
    assert number_of(str(number)) == float(number)


def test_a_fraction_is_no_whole_number():
    assert whole_number_of("2.0") is None and number_of("2.") == 2.0 and number_of("+.5E-1") == 0.05


def test_values_for_json_hold_neither_nan_nor_infinity_at_any_depth():
    record = {"rows": ({1: math.nan}, [np.float32(0.5), -math.inf]), "sound": True, "count": 3, "file": Path("a.nc")}
    assert json_value(record) == {"rows": [{"1": None}, [0.5, None]], "sound": True, "count": 3, "file": "a.nc"}
    assert json_value(record)["sound"] is True
