"""Text of pages: numbers stay with their units."""

import re

import pytest
from cboxlab.utils.page_text import UNITS, escaped, unbroken
from cboxlab.utils.table import Table
from cboxlab.validation.report.viewer import viewer_part
from markupsafe import Markup


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_stays_with_its_number(unit):
    assert unbroken(f"from 1.5 to 2 {unit}, and 3 {unit}.") == f"from 1.5 to 2\xa0{unit}, and 3\xa0{unit}."


@pytest.mark.parametrize("text", ["in 3 measurements", "5 samples", "407 nmol", "nine nm", "100 and 5", "4 K_1"])
def test_other_words_may_begin_a_line(text):
    assert unbroken(text) == text


def test_scripts_and_pictures_are_left_alone():
    assert unbroken(Markup("<text>5 nm</text>")) == "<text>5 nm</text>" and unbroken(3) == 3


def test_a_table_of_a_notebook_keeps_units_with_numbers():
    table = Table("shares < 5 %", ("surface", "407 nm"), (("floor", "1 %"),))
    assert "<caption>shares &lt; 5\xa0%</caption>" in table._repr_html_()
    assert "<th>407\xa0nm</th>" in table._repr_html_() and "<td>1\xa0%</td>" in table._repr_html_()
    assert escaped("a < 5 px") == "a &lt; 5\xa0px"


def test_scripts_of_pages_have_the_same_units():
    units = re.search(r"\(\?=\(\?:(.*?)\)\(\?!", viewer_part("text.js"))
    assert units is not None and tuple(units[1].split("|")) == UNITS
