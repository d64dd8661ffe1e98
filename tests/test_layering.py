"""The walls of the house: which room may import which, and how long a module may be."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "scenes": set(),
    "calibration": {"scenes"},
    "render": {"scenes", "calibration"},
    "validate": {"scenes", "calibration", "render"},
}
MODULES = [path for room in MAY_IMPORT for path in sorted((ROOT / room).rglob("*.py"))]


def rooms_imported(source: str, room: str, depth: int = 0) -> set[str]:
    """The other rooms that a module imports; ``depth`` folders below its room."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ["cboxlab", room, *["?"] * depth][: 2 + depth + 1 - node.level] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            names = [f"{stem}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == "cboxlab":
                found.add(parts[1] if len(parts) > 1 else "*")
    return found - {room}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_imports_only_the_rooms_below_it(path):
    room, *inner = path.relative_to(ROOT).parts
    assert rooms_imported(path.read_text(encoding="utf-8"), room, len(inner) - 1) <= MAY_IMPORT[room]


@pytest.mark.parametrize(
    ("source", "rooms"),
    [
        ("from cboxlab.render import tracer", {"render"}),
        ("import cboxlab.validate.cli as cli", {"validate"}),
        ("def f():\n    from ..render.tracer import trace", {"render"}),
        ("from .. import render", {"render"}),
        ("from cboxlab import render", {"render"}),
        ("from . import spectra\nfrom .spectra import Spectrum\nimport numpy", set()),
    ],
)
def test_every_way_to_import_a_room_is_seen(source, rooms):
    assert rooms_imported(source, "scenes") == rooms


def test_imports_of_a_module_in_a_subfolder_are_seen():
    assert rooms_imported("from ...render import tracer\nfrom ..cli import main", "validate", 1) == {"render"}


def test_modules_are_short():
    modules = [*MODULES, *(ROOT / "tests").glob("*.py"), *(ROOT / "benchmarks").glob("*.py")]
    lines = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in modules}
    assert {name: count for name, count in lines.items() if count > 400} == {}
