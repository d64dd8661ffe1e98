"""Packages that import their names when they are first used."""

import sys
from importlib import import_module

import pytest
from architecture import INSTALLED, MODULES
from cboxlab.utils.lazy import lazy_names
from helpers.places import ROOT

FACES = [p for p in [*MODULES, ROOT / "cboxlab" / "__init__.py"] if "= lazy_names(__name__)" in p.read_text()]


def name_of(path):
    room, *others = path.parent.relative_to(ROOT).parts
    return ".".join([] if room == "cboxlab" else ["cboxlab", INSTALLED.get(room, room), *others]) or "cboxlab"


@pytest.mark.parametrize("path", FACES, ids=lambda path: path.parent.relative_to(ROOT).as_posix())
def test_every_name_is_there_and_no_module_hides_it(path):
    package = import_module(name_of(path))
    assert all(hasattr(package, name) for name in package.__all__)
    assert {*package.__all__} <= {*dir(package)}
    assert not {*package.__all__} & {each.stem for each in path.parent.iterdir()}


def test_a_name_is_imported_when_it_is_used(tmp_path, monkeypatch):
    folder = tmp_path / "late"
    folder.mkdir()
    (folder / "__init__.py").write_text(
        "from typing import TYPE_CHECKING\nfrom cboxlab.utils.lazy import lazy_names\n"
        "if TYPE_CHECKING:\n    from .work import done\n"
        "__all__ = ['done']\n__getattr__, __dir__ = lazy_names(__name__)\n"
    )
    (folder / "work.py").write_text("done = 7\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    late = import_module("late")
    assert "late.work" not in sys.modules and "done" in dir(late)
    assert late.done == 7 and "late.work" in sys.modules
    with pytest.raises(AttributeError, match="module 'late' has no attribute 'undone'"):
        late.undone  # noqa: B018
    assert lazy_names("late")[0]("done") == 7
