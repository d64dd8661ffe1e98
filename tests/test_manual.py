"""The manual's notebook from cube to raw runs, and its example of an effect is one."""

import json
import re

import matplotlib
from cboxlab.validate.effects import catalogue
from places import ROOT

DOCS = ROOT / "docs"


def test_the_notebook_from_cube_to_raw_runs(monkeypatch, tmp_path):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    cells = json.loads((DOCS / "notebooks" / "cube_to_raw.ipynb").read_text(encoding="utf-8"))["cells"]
    names: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert (tmp_path / "cube.exr").exists() and (tmp_path / "raw" / "raw.tif").exists()


def test_the_example_of_an_effect_is_one():
    """The page's code makes an effect that is not in the catalogue and does nothing at 0."""
    page = (DOCS / "how-to" / "write-an-effect.md").read_text(encoding="utf-8")
    names: dict = {}
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    effect = names["EFFECT"]
    assert effect.id not in catalogue() and effect.numbers[0].null == 0
