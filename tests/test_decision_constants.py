"""Constants that decide verdicts: each one has a reason, and the manual's page holds them all."""

import importlib
import sys

import pytest
from helpers.places import ROOT

sys.path.insert(0, str(ROOT / "docs"))
decision_constants = importlib.import_module("decision_constants")

FOLDER = "validate/diagnose"


@pytest.fixture(scope="module")
def constants():
    return decision_constants.decision_constants()


def test_every_constant_has_a_reason(constants):
    assert len(constants) > 300
    assert [c.key for c in constants if not c.reason] == []


def test_every_constant_has_the_value_of_its_module(constants):
    """The page reads syntax; here the imported modules are asked."""
    for constant in constants:
        module = importlib.import_module(constant.module)
        value = getattr(module, constant.name)
        assert repr(eval(constant.value, vars(module))) == repr(value) or "lambda" in constant.value


def test_the_page_holds_all_constants(constants):
    page = decision_constants.table()
    sections = dict(part.split("`\n", 1) for part in page.replace("\n## `", "\n### `").split("### `")[1:])
    for constant in constants:
        assert f"| `{constant.name}` |" in sections[constant.path], constant.key
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) == len(constants)
    assert all(line.replace("\\|", "").count("|") == 4 for line in rows)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("#: A reason\n#: in two lines.\n_A = 0.5", [("_A", "0.5", "A reason in two lines.")]),
        ("# a remark\nA: float = 1e-3", [("A", "1e-3", "")]),
        ("#: Both.\nA, B = 1, -2.0", [("A", "1", "Both."), ("B", "-2.0", "Both.")]),
        ("#: Numerics: rounds of a fit.\nA = 4", []),
        ("#: Far.\n\nA = {'x': (1, 2)}", [("A", "{'x': (1, 2)}", "")]),
        ("A = NAMES[0]\nB = 'text'\nC = True\nd = 1\nE = lambda x: x + 1\nF = Family(share=0.1)", []),
        ("def f():\n    A = 1", []),
    ],
)
def test_constants_are_read_from_syntax(tmp_path, source, expected):
    """Numbers at the top level, in capitals; not indices, texts or numbers inside functions."""
    folder = tmp_path / FOLDER
    folder.mkdir(parents=True)
    (folder / "module.py").write_text(source, encoding="utf-8")
    constants = decision_constants.decision_constants(tmp_path)
    assert [(c.name, c.value, c.reason) for c in constants] == expected
    assert {c.module for c in constants} <= {"cboxlab.validation.diagnose.module"}


def test_a_reason_keeps_its_signs_in_markdown(tmp_path):
    folder = tmp_path / FOLDER
    folder.mkdir(parents=True)
    (folder / "module.py").write_text("#: |a*b| < 1, see `x_y|z`.\nA = 1 | 2\n", encoding="utf-8")
    page = decision_constants.table(tmp_path)
    assert "| `A` | `1 \\| 2` | \\|a\\*b\\| \\< 1, see `x_y\\|z`. |" in page
