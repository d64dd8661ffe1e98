"""The manual: it builds, its commands are commands, its notebooks run, its example of an effect is one.

``benchmarks/speed/manual_trial.py`` runs every command of the README and the tutorial as it is written.
"""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import cboxlab
import matplotlib
import pytest
from cboxlab.calibration.capture.whole_manifest import Manifest
from cboxlab.rendering.effects import catalogue
from cboxlab.rendering.model import load_model
from cboxlab.validation.app.commands.app import app
from cboxlab.validation.diagnose import stepwise
from helpers.captures.glare_capture import GLARE, glare_capture
from helpers.places import ROOT
from helpers.programs.manual_commands import NEW_USER, commands, pages
from typer.main import get_command

DOCS = ROOT / "docs"

pytestmark = pytest.mark.usefixtures("large_patches")

#: Options and commands whose value is a path that is written.
WRITTEN = ("--out", "--json", "--to")


def test_the_manual_builds_without_a_warning(tmp_path):
    build = [sys.executable, "-m", "sphinx", "-q", "-n", "-W", "--keep-going", DOCS, tmp_path / "manual"]
    done = subprocess.run(build, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # -W: a warning is an error; other libraries may log to the same stream
    assert (tmp_path / "manual" / "tutorial.html").exists()


def test_every_public_name_is_on_the_page_of_the_python_interface():
    directives = re.findall(
        r"^\.\. auto\w+:: cboxlab\.(?:[\w.]+\.)?(\w+)$", (DOCS / "reference/python.md").read_text(), re.M
    )
    assert {*cboxlab.__all__} - {*directives} == {"__version__"}


@pytest.mark.parametrize("page", [page for page in pages() if commands(page)])
def test_every_command_of_the_manual_can_be_parsed(page):
    group = get_command(app)
    for command_line in commands(page):
        context = group.make_context("cbox", list(command_line))
        name, command, rest = group.resolve_command(context, list(command_line))
        parsed = command.make_context(name, rest)  # ends the process where an option or argument is not known
        assert parsed.command is command


@pytest.mark.parametrize("page", NEW_USER)
def test_every_file_in_a_new_users_commands_is_there_or_was_written_before(page):
    written, checked = [], 0
    for command in commands(page, "shell"):
        new = {command[i + 1] for i, word in enumerate(command[:-1]) if word in WRITTEN}
        if command[0] == "add":
            new.add(command[1])
        for word in command[1:]:
            if word in new or not re.search(r"[/.]|^blind$", word) or "=" in word or re.match(r"[\d.]+%?$", word):
                continue
            checked += 1
            assert (ROOT / word).exists() or any(Path(word).is_relative_to(folder) for folder in written), command
        written += new
    assert checked >= 4


def test_the_cheap_commands_of_the_tutorial_run(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    ran = []
    for command in commands("docs/tutorial.md", "shell"):
        if command[0] == "effects" or (command[0] == "add" and "--fit" not in command):
            with pytest.raises(SystemExit) as ended:
                get_command(app)(command, prog_name="cbox")
            assert not ended.value.code
            ran.append(command[0])
    assert ran == ["effects", "effects", "add"] and "veiling-glare" in capsys.readouterr().out
    assert load_model(tmp_path / "by-hand.toml").effects[0].values == {"fraction": 0.002}


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder for notebooks, next to a small capture in the place of the bundled one."""
    matplotlib.use("Agg")
    root = tmp_path_factory.mktemp("manual")
    (root / "validate" / "data").mkdir(parents=True)
    glare_capture(root / "validate" / "data" / "demo-capture")
    path = root / "docs" / "notebooks"
    path.mkdir(parents=True)
    return path


def run_notebook(name, monkeypatch, folder):
    """The names that the notebook's cells leave behind."""
    monkeypatch.chdir(folder)
    cells = json.loads((DOCS / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    names: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    return names


def test_the_notebook_from_cube_to_raw_runs(monkeypatch, desk):
    run_notebook("cube_to_raw", monkeypatch, desk)
    assert (desk / "cube.exr").exists() and (desk / "raw" / "raw.tif").exists()


def test_the_notebook_of_a_validation_runs(monkeypatch, desk):
    names = run_notebook("validate", monkeypatch, desk)
    assert names["metrics"]["chi2_per_dof"] > 1.2 and (desk / "validation" / "report.html").exists()
    assert "CBoxViewer" in names["validation"]._repr_html_()


def test_the_notebook_that_finds_an_effect_runs(monkeypatch, desk):
    hypotheses = stepwise.hypotheses  # two of them: each costs seconds
    monkeypatch.setattr(
        stepwise,
        "hypotheses",
        lambda *a: [h for h in hypotheses(*a) if h.effect.id in ("veiling-glare", "ghost")],
    )
    names = run_notebook("find_an_effect", monkeypatch, desk)
    assert names["fitted"].effects[0].values["fraction"] == pytest.approx(GLARE, abs=0.003)
    assert names["fitted"].chi2 < min(names["found"])
    assert names["record"]["selected"][0] == "veiling-glare"
    assert load_model(desk / "found" / "model.toml").effects[0].id == "veiling-glare"


@pytest.mark.parametrize("page", ["capture-format", "model-format"])
def test_the_example_of_a_format_is_one(page, tmp_path):
    text = (DOCS / "reference" / f"{page}.md").read_text(encoding="utf-8")
    example = re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1]
    if page == "capture-format":
        assert Manifest.model_validate(tomllib.loads(example)).band[0].id == "f550"
        return
    (tmp_path / "model.toml").write_text(example, encoding="utf-8")
    assert [effect.id for effect in load_model(tmp_path / "model.toml").effects] == [
        "veiling-glare",
        "wall-reflectance",
    ]


def test_the_example_of_an_effect_is_one():
    """The page's code makes an effect that is not in the catalogue and does nothing at 0."""
    page = (DOCS / "how-to" / "write-an-effect.md").read_text(encoding="utf-8")
    names: dict = {}
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    effect = names["EFFECT"]
    assert effect.id not in catalogue() and effect.numbers[0].null == 0
