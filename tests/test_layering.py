"""Which room and which package may import which, and how long a module may be."""

import ast
import itertools
from graphlib import TopologicalSorter

import pytest
from architecture import (
    DRAWING,
    MODULES,
    ROOMS,
    drawing,
    imported,
    imports_of,
    package_imports,
    package_in,
    package_of,
)
from helpers.places import ROOT

MAY_IMPORT = {room: set(ROOMS[:index]) for index, room in enumerate(ROOMS)}

DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)

#: Catalogues: one file for each effect, named cause of a difference, or command.
CATALOGUES = {
    "render.effects",
    "validate.compare_renders.regress.causes",
    "validate.app.commands",
}

#: Modules of any other package.
MOST_MODULES = 16


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_imports_only_the_rooms_below_it(path):
    room = package_of(path).split(".")[0]
    rooms = {name.split(".")[0] for name in imports_of(path)}
    assert rooms - {room} <= MAY_IMPORT[room]


def test_packages_import_each_other_in_one_direction():
    imports = package_imports()
    assert {*imports} <= {*TopologicalSorter(imports).static_order()}  # a circle has no order


def test_the_drawing_shows_the_imports_as_they_are():
    """After a change of imports: python tests/architecture.py"""
    assert DRAWING.read_text(encoding="utf-8") == drawing(package_imports())


def test_other_packages_import_from_a_packages_face():
    """``from ..capture import Capture``, not ``from ..capture.capture import Capture``."""
    packages = {package_of(p) for p in MODULES}
    modules = {f"{package_of(p)}.{p.stem}" for p in MODULES if p.name != "__init__.py"}
    deep = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in MODULES
        for name in imports_of(path)
        if (_package := package_in(name, packages)) not in (*ROOMS, package_of(path))
        and name.rpartition(".")[0] in modules
        and not name.startswith("render.device.variant.")
    ]
    assert deep == []


@pytest.mark.parametrize(
    ("source", "rooms"),
    [
        ("from cboxlab.rendering import tracer", {"render.tracer"}),
        ("import cboxlab.validation.cli as cli", {"validate.cli"}),
        ("def f():\n    from ..render.tracer import trace", {"render.tracer.trace"}),
        ("from .. import render", {"render"}),
        ("from cboxlab import render", {"render"}),
        ("from . import spectra\nimport numpy", {"scenes.spectra"}),
    ],
)
def test_every_way_to_import_is_seen(source, rooms):
    assert imported(source, "scenes") == rooms


def test_imports_of_a_module_in_a_subfolder_are_seen():
    source = "from ...render import tracer\nfrom ..cli import main"
    assert imported(source, "validate.effects") == {"render.tracer", "validate.cli.main"}


#: Lines of a module without its docstrings.
MOST_LINES = 400


def lines_without_docstrings(source: str) -> int:
    """Lines of a module that are not part of a docstring."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, DOCUMENTED) and node.body]
    first = [node.body[0] for node in nodes if ast.get_docstring(node, clean=False) is not None]
    return len(source.splitlines()) - sum(node.end_lineno - node.lineno + 1 for node in first)


def test_modules_are_short():
    modules = [*MODULES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]
    sources = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in modules}
    long = {name: source for name, source in sources.items() if source.count("\n") > MOST_LINES}
    lines = {name: lines_without_docstrings(source) for name, source in long.items()}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}


def test_packages_are_small():
    by_package = itertools.groupby(sorted(MODULES, key=package_of), key=package_of)
    sizes = {name: len(list(modules)) for name, modules in by_package if name not in CATALOGUES}
    assert {name: size for name, size in sizes.items() if size > MOST_MODULES} == {}
