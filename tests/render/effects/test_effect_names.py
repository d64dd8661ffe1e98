"""What is special about an effect stands in its own file: no module elsewhere names an effect or its parameters."""

import ast

import pytest
from cboxlab.rendering.effects import catalogue
from helpers.places import ROOT

ROOMS = ("scenes", "calibration", "render", "validate")

#: Keys of camera files, which have these words for a camera's own properties.
CAMERA_KEYS = {("render/sensor/cameras.py", "nonlinearity"), ("render/sensor/cameras.py", "vignetting")}

#: A key of the render's settings.
SETTINGS_KEYS = {("validate/study/study_file.py", "max_bounces")}

#: A block's turn and a lamp's fall-off, of boxes that are drawn.
BOX_KEYS = {("validate/dataset/sheet.py", "yaw_deg"), ("validate/dataset/checks.py", "edge_ratio")}

#: Folders about the effects themselves, or about changes of renderers and families of explanations: these are other
#: catalogues, where some names are the same.
EXEMPT = (
    ROOT / "render/effects",
    ROOT / "validate/compare_renders/regress",
    ROOT / "validate/diagnose/families",
)

#: Identifiers of two words are no ordinary words, nor are such names of parameters.
IDENTIFIERS = sorted(catalogue())
PARAMETERS = sorted({p.name for e in catalogue().values() for p in e.parameters if "_" in p.name})


def strings(source: str) -> list[str]:
    """String constants of a module; docstrings, whose examples may name an effect, are none."""
    tree = ast.parse(source)
    statements = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
    constants = [n for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in statements]
    return [n.value for n in constants if isinstance(n.value, str)]


def named_in(source: str) -> set[str]:
    """Effects and parameters that a module's strings name: as a whole, or within where the word is no other's."""
    return {
        name
        for text in strings(source)
        for name in (*IDENTIFIERS, *PARAMETERS)
        if text == name or (name in IDENTIFIERS and "-" in name and name in text)
    }


def test_no_module_outside_the_catalogue_names_an_effect_or_its_parameters():
    members = {
        (path.relative_to(ROOT).as_posix(), name)
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        if not any(folder in path.parents for folder in EXEMPT)
        for name in named_in(path.read_text(encoding="utf-8"))
        if room == "validate" or name in IDENTIFIERS
    }
    assert members == CAMERA_KEYS | SETTINGS_KEYS | BOX_KEYS


@pytest.mark.parametrize("line", ['x = "gloss"', 'x = ["lamp-power is bright"]', 'x = {"peak_nm": 1}'])
def test_a_name_in_a_module_is_found(line):
    assert named_in(line)
