"""A family is one file: no other module names it, other packages add theirs, the order is stated."""

import ast
import importlib
import re
import sys
import tomllib
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from cboxlab.rendering.fitted_fields import field_effect
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose.explain import explain, explain_masked_families
from cboxlab.validation.diagnose.families import families
from cboxlab.validation.report.explanation import explanation_record, explanation_sections, explanation_sentence
from helpers.captures.small_excess import COLUMNS, SIGNAL, SIZE, small_excess
from helpers.places import ROOT

GUIDE = ROOT / "docs" / "how-to" / "write-an-explanation-family.md"

#: From the first to the last: of equal scores the first wins.
ORDER = [
    "sensor-offset",
    "sensor-gain",
    "displacement",
    "blur",
    "time-order",
    "lamp-spectrum",
    "filter-curve",
    "paint-spectrum",
    "reflectance-map",
    "extra-light",
    "reflection-lobe",
    "object",
]

#: Catalogues of other things: of effects, and of changes between two renderings.
OTHER_CATALOGUES = (ROOT / "render" / "effects", ROOT / "validate" / "compare_renders" / "regress")

#: Words that are not the family: the operator of a fitted field, functions of the image, a column of a camera's file,
#: a type of JSON, and layers of a picture.
OTHER_MEANINGS = {
    ("render/fitted_fields/acting.py", "displacement"),
    ("render/fitted_fields/fitted_field.py", "displacement"),
    ("render/image/__init__.py", "blur"),
    ("render/image/blur.py", "blur"),
    ("render/model/__init__.py", "displacement"),
    ("validate/diagnose/explain/motion.py", "displacement"),
    ("render/model/stages.py", "displacement"),
    ("render/sensor/cameras.py", "blur"),
    ("validate/app/commands/calibrate.py", "object"),
    ("validate/compare_renders/scene_pictures/guides.py", "object"),
    ("validate/compare_renders/scene_pictures/layers.py", "object"),
}


def _families_named(source):
    """Identifiers of families among a module's strings: as a whole, or within where they have a hyphen."""
    texts = [n.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return {name for name in ORDER for text in texts if text == name or ("-" in name and name in text)}


def test_no_module_but_its_own_names_a_family():
    members = {
        (path.relative_to(ROOT).as_posix(), name)
        for room in ("render", "validate")
        for path in (ROOT / room).rglob("*.py")
        if not any(folder in path.parents for folder in OTHER_CATALOGUES)
        for name in _families_named(path.read_text(encoding="utf-8"))
    }
    modules = {family.id: sys.modules[family.generate.__module__].__file__ for family in families().values()}
    named_in = {(file.removeprefix(f"{ROOT}/"), name) for name, file in modules.items()}
    assert members == named_in | OTHER_MEANINGS


@pytest.mark.parametrize("line", ['x = "blur"', 'if y == "sensor-gain": pass', 'x = ["a sensor-gain of rows"]'])
def test_a_name_in_a_module_is_found(line):
    assert _families_named(line)


def test_the_order_is_stated():
    assert list(families()) == ORDER
    orders = [family.order for family in families().values()]
    assert sorted(set(orders)) == orders


def test_masked_patterns_come_by_their_rank():
    """A smear, an uneven blur, a displacement of one band: the first one that is significant is reported."""
    explained = explain_masked_families(small_excess(0.01 * SIGNAL * np.cos(COLUMNS / 7)))
    assert [explanation.rivals[-1].family for explanation in explained] == ["blur", "blur", "displacement"]
    forms = [explanation.rivals[-1].form for explanation in explained]
    assert forms[0].startswith("along the") and forms[1] == "unevenly over the picture"


def test_the_manual_lists_every_family():
    page = (ROOT / "docs" / "explanation" / "how-diagnosis-decides.md").read_text(encoding="utf-8")
    table = page.split("## Explanation")[1].split("\n\n")[2]
    assert set(re.findall(r"`([a-z-]+)`", "\n".join(line.split("|")[1] for line in table.splitlines()))) == set(ORDER)


@pytest.fixture
def _two_amplifiers(tmp_path):
    """The guide's package, installed as pip would do it, without a network."""
    code, project = (re.search(rf"```{kind}\n(.*?)```", GUIDE.read_text(), re.DOTALL)[1] for kind in ("python", "toml"))
    project = tomllib.loads(project)["project"]
    module = tmp_path / "my_families"
    module.mkdir()
    (module / "__init__.py").touch()
    (module / "two_amplifiers.py").write_text(code)
    record = tmp_path / f"my_families-{project['version']}.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [f"{name} = {value}" for name, value in project["entry-points"]["cboxlab.families"].items()]
    (record / "entry_points.txt").write_text("\n".join(["[cboxlab.families]", *lines, ""]))
    sys.path.insert(0, str(tmp_path))
    importlib.invalidate_caches()
    families.cache_clear()
    yield
    sys.path.remove(str(tmp_path))
    for name in [name for name in sys.modules if name.split(".")[0] == "my_families"]:
        del sys.modules[name]
    families.cache_clear()


@pytest.mark.usefixtures("_two_amplifiers")
def test_a_family_of_another_package_is_fitted_and_reported():
    gain = np.where(COLUMNS < SIZE / 2, -0.01, 0.01)
    explanation = explain(small_excess(gain * SIGNAL))
    assert list(families()) == [*ORDER, "two-amplifiers"]
    assert (explanation.family, explanation.told_apart) == ("two-amplifiers", True)
    assert explanation.share > 0.9 and explanation.runner_up == "sensor-gain"
    sentence = explanation_sentence(explanation)
    assert "looks like two amplifiers of different gain (two-amplifiers: one half against the other)" in sentence
    assert explanation_record(explanation)["family"] == "two-amplifiers"
    (section,) = explanation_sections(explanation)
    assert section.title == "What no effect explains"
    effect = field_effect("two-amplifiers", explanation.field, "", "")
    assert effect.stage == "counts"
    np.testing.assert_allclose(explanation.field.coefficients, np.tile(gain[0], (4, 1)), rtol=0.2)


@pytest.mark.usefixtures("_two_amplifiers")
def test_a_family_of_another_package_can_be_a_rival():
    stain = -0.1 * SIGNAL * np.exp(-((COLUMNS - 30) ** 2) / 20)
    explanation = explain(small_excess(stain))
    assert explanation.family != "two-amplifiers"
    assert "two-amplifiers" in {rival.family for rival in explanation.rivals}
    assert "two-amplifiers" in {rival["family"] for rival in explanation_record(explanation)["families"]}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:FAMILY", "nowhere"),
        ("math:pi", "a float"),
        ("cboxlab.validation.diagnose.families.blur:FAMILY", "'blur'"),
    ],
)
def test_an_entry_point_that_is_no_new_family_is_named(monkeypatch, value, message):
    entry = EntryPoint("smear", value, "cboxlab.families")
    monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
    families.cache_clear()
    try:
        with pytest.raises(InputError, match=f"smear = {value}.*{message}"):
            families()
    finally:
        families.cache_clear()
