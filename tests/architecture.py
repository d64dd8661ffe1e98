"""Reads the imports of the rooms and draws them: ``python tests/architecture.py`` writes the drawing in docs/."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import TopologicalSorter
from html import escape
from pathlib import Path

from helpers.places import ROOT

#: From the lowest room to the highest.
ROOMS = ("utils", "scenes", "calibration", "render", "validate")
FOLDERS = {room: ROOT / ("cboxlab/utils" if room == "utils" else room) for room in ROOMS}
#: Names of packages inside cboxlab that are not the name of their folder.
INSTALLED = {"render": "rendering", "validate": "validation"}
MODULES = [path for folder in FOLDERS.values() for path in sorted(folder.rglob("*.py"))]
DRAWING = ROOT / "docs" / "figures" / "architecture.svg"

_BOX, _GAP, _MARGIN = (232, 30), (34, 12), 16
_COLOURS = {
    "utils": "#555555",
    "scenes": "#7a6a00",
    "calibration": "#00607a",
    "render": "#7a2e00",
    "validate": "#3d2e7a",
}


def imported(source: str, package: str) -> set[str]:
    """The modules and names of cboxlab, as ``room.package.module``, that a module of ``package`` imports."""
    members = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = ["cboxlab", *package.split(".")]
            base = parts[: len(parts) + 1 - node.level] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            names = [f"{stem}.{alias.name}" for alias in node.names]
        else:
            continue
        members |= {_by_folder(name.removeprefix("cboxlab.")) for name in names if name.split(".")[0] == "cboxlab"}
    return members


def _by_folder(name: str) -> str:
    """``rendering.chain`` as ``render.chain``."""
    first, *others = name.split(".")
    folders = {package: folder for folder, package in INSTALLED.items()}
    return ".".join([folders.get(first, first), *others])


def package_of(path: Path) -> str:
    """``room.package`` of a module, ``room.package.package`` of a nested one, or the room alone."""
    parts = path.relative_to(ROOT).parent.parts
    return ".".join(parts[1:] if parts[0] == "cboxlab" else parts)


def package_in(name: str, packages: set[str]) -> str:
    """The innermost of ``packages`` that holds an imported name."""
    parts = name.split(".")
    prefixes = [".".join(parts[:count]) for count in range(len(parts), 0, -1)]
    return next((prefix for prefix in prefixes if prefix in packages), parts[0])


@cache
def imports_of(path: Path) -> set[str]:
    """What a module imports from cboxlab."""
    return imported(path.read_text(encoding="utf-8"), package_of(path))


def package_imports() -> dict[str, set[str]]:
    """By package, the packages it imports from; a room's own ``__init__`` is left out."""
    packages = {package_of(path) for path in MODULES}
    dependencies: dict[str, set[str]] = {}
    for path in MODULES:
        package = package_of(path)
        if path.name == "__init__.py" and package in ROOMS and package != "scenes":
            continue
        targets = {package_in(name, packages) for name in imports_of(path)}
        dependencies.setdefault(package, set()).update(targets - {package})
    return dependencies


def _levels(edges: dict[str, set[str]]) -> dict[str, int]:
    """How many packages stand below each on its longest way down."""
    levels: dict[str, int] = {}
    for package in TopologicalSorter(edges).static_order():
        levels[package] = 1 + max((levels[below] for below in edges[package]), default=-1)
    return levels


def _reduced(edges: dict[str, set[str]]) -> list[tuple[str, str]]:
    """The imports that do not follow from others."""

    def below(package: str) -> set[str]:
        return edges[package].union(*(below(other) for other in edges[package]))

    return [
        (package, other)
        for package in sorted(edges)
        for other in sorted(edges[package])
        if not any(other in below(third) for third in edges[package] - {other})
    ]


def _room(room: str, edges: dict[str, set[str]], top: int) -> tuple[list[str], int]:
    """SVG of one room below ``top``, and its height. Packages stand to the right of what they import."""
    levels = _levels(edges)
    columns: dict[int, list[str]] = {}
    for package in sorted(edges):
        columns.setdefault(levels[package], []).append(package)
    rows = max(len(column) for column in columns.values())
    height = rows * (_BOX[1] + _GAP[1]) + 44
    box = {}
    for level, column in columns.items():
        first = top + 34 + (rows - len(column)) * (_BOX[1] + _GAP[1]) / 2
        for row, package in enumerate(column):
            box[package] = (_MARGIN + 12 + level * (_BOX[0] + _GAP[0]), first + row * (_BOX[1] + _GAP[1]))
    colour = _COLOURS[room]
    width = _MARGIN + 12 + (max(levels.values()) + 1) * (_BOX[0] + _GAP[0])
    lines = [
        f'<rect x="{_MARGIN}" y="{top}" width="{width}" height="{height}" rx="6" fill="none" stroke="{colour}"/>',
        f'<text x="{_MARGIN + 12}" y="{top + 21}" fill="{colour}" font-weight="bold">{room}/</text>',
    ]
    for package, other in _reduced(edges):
        (x, y), (u, v) = box[package], box[other]
        start, end = (x, y + _BOX[1] / 2), (u + _BOX[0], v + _BOX[1] / 2)
        lines.append(
            f'<path d="M{start[0]:g} {start[1]:g} C{start[0] - 22:g} {start[1]:g} {end[0] + 22:g} {end[1]:g} '
            f'{end[0] + 4:g} {end[1]:g}" fill="none" stroke="{colour}" opacity="0.7" marker-end="url(#arrow)"/>'
        )
    for package, (x, y) in box.items():
        name = package.removeprefix(f"{room}.") if "." in package else "(no packages)"
        lines.append(f'<rect x="{x:g}" y="{y:g}" width="{_BOX[0]}" height="{_BOX[1]}" rx="4" fill="{colour}"/>')
        centre = f'x="{x + _BOX[0] / 2:g}" y="{y + 20:g}"'
        lines.append(f'<text {centre} fill="#ffffff" text-anchor="middle">{escape(name)}</text>')
    return lines, height


def drawing(edges: dict[str, set[str]]) -> str:
    """The SVG: rooms from the highest to the lowest, in each its packages with arrows to what they import."""
    body: list[str] = []
    top, width = _MARGIN, 0
    for room in reversed(ROOMS):
        columns = {
            package: {other for other in below if other.split(".")[0] == room}
            for package, below in edges.items()
            if package.split(".")[0] == room
        }
        lines, height = _room(room, columns, top)
        body += lines
        top += height + 14
        width = max(width, max(_levels(columns).values()) + 1)
    size = f'width="{2 * _MARGIN + 12 + width * (_BOX[0] + _GAP[0])}" height="{top}"'
    head = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="13">',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        '<defs><marker id="arrow" markerWidth="8" markerHeight="8" refX="6" refY="3" orient="auto">'
        '<path d="M0 0 L6 3 L0 6 z" fill="#555555"/></marker></defs>',
    ]
    return "\n".join([*head, *body, "</svg>", ""])


if __name__ == "__main__":
    DRAWING.write_text(drawing(package_imports()), encoding="utf-8")
    print(DRAWING)
