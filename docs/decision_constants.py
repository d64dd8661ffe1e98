"""Constants that decide verdicts, read from the source with their reasons.

Only the syntax is read, so that a benchmark can list the constants before it imports a changed package.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["FOLDERS", "DecisionConstant", "assigned", "decision_constants", "table"]

ROOT = Path(__file__).resolve().parents[1]

#: Folders whose constants decide verdicts, with what they decide.
FOLDERS = {
    "validate/diagnose": "Effects, remainder and explanation of `cbox diagnose`.",
    "validate/compare_renders/regress": "Verdict and named change of `cbox regress`.",
    "calibration/quality": "Suspicions of a capture.",
}

#: Names of packages in `cboxlab` that differ from their folder.
_INSTALLED = {"render": "rendering", "validate": "validation"}


@dataclass(frozen=True)
class DecisionConstant:
    """A numeric constant at the top level of a module."""

    #: Path of the module, relative to the repository.
    path: str
    #: Line of the assignment, from 1.
    line: int
    #: Name of the constant.
    name: str
    #: Its value as an expression.
    value: str
    #: Text of its `#:` comment; empty without one.
    reason: str

    @property
    def module(self) -> str:
        """Name under which the module is imported."""
        folder, *others = self.path.removesuffix(".py").split("/")
        return ".".join(["cboxlab", _INSTALLED.get(folder, folder), *others]).removesuffix(".__init__")

    @property
    def key(self) -> str:
        """Name that identifies the constant: path of the module without its suffix, then the name."""
        return f"{self.path.removesuffix('.py')}:{self.name}"


def decision_constants(root: Path = ROOT) -> list[DecisionConstant]:
    """Constants of `FOLDERS` that decide; those of numerics say so in the first word of their reason.

    Parameters
    ----------
    root
        Folder of the repository.

    Returns
    -------
    list of DecisionConstant
        By folder, module and line.
    """
    paths = [path for folder in FOLDERS for path in sorted((root / folder).rglob("*.py"))]
    constants = [constant for path in paths for constant in _of_module(path, path.relative_to(root).as_posix())]
    return [constant for constant in constants if not constant.reason.startswith("Numerics:")]


def _text_of(lines: list[str], node: ast.expr) -> str:
    """Source of an expression on one line; `ast.get_source_segment` reads the whole source every time."""
    # columns are counted in bytes
    parts = [line.encode() for line in lines[node.lineno - 1 : node.end_lineno]]
    parts[-1] = parts[-1][: node.end_col_offset]
    parts[0] = parts[0][node.col_offset :]
    return " ".join(b" ".join(parts).decode().split())


def _of_module(path: Path, name: str) -> Iterator[DecisionConstant]:
    source = path.read_text(encoding="utf-8")
    lines = source.splitlines()
    for node in ast.parse(source).body:
        for constant, value in assigned(node):
            if constant.isupper() and _holds_number(value):
                yield DecisionConstant(name, node.lineno, constant, _text_of(lines, value), _reason(lines, node.lineno))


def assigned(node: ast.stmt) -> list[tuple[str, ast.expr]]:
    """Names that a statement assigns, with their values.

    Parameters
    ----------
    node
        Statement of a module.

    Returns
    -------
    list of tuple
        Several for a tuple of names; empty for any other statement.
    """
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return []
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    if isinstance(target, ast.Name):
        return [(target.id, node.value)]
    if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
        pairs = zip(target.elts, node.value.elts, strict=False)
        return [(name.id, value) for name, value in pairs if isinstance(name, ast.Name)]
    return []


def _holds_number(value: ast.expr) -> bool:
    """Whether an expression holds a number outside indices, functions and records such as `Family(...)`."""
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id.istitle():
        return False
    inner = [node.slice for node in ast.walk(value) if isinstance(node, ast.Subscript)]
    inner += [node.body for node in ast.walk(value) if isinstance(node, ast.Lambda)]
    skipped = {id(part) for node in inner for part in ast.walk(node)}
    return any(
        isinstance(node, ast.Constant) and type(node.value) in (int, float) and id(node) not in skipped
        for node in ast.walk(value)
    )


def _reason(lines: list[str], line: int) -> str:
    """Text of the `#:` comment directly above a line."""
    block: list[str] = []
    for text in reversed(lines[: line - 1]):
        if not text.startswith("#:"):
            break
        block.append(text.removeprefix("#:").strip())
    return " ".join(reversed(block))


def table(root: Path = ROOT) -> str:
    """The constants as Markdown, one table per module.

    Parameters
    ----------
    root
        Folder of the repository.

    Returns
    -------
    str
        Sections by folder, sub-sections by module.
    """
    constants, lines = decision_constants(root), []
    for folder, subject in FOLDERS.items():
        lines += [f"## `{folder}`\n", f"{subject}\n"]
        paths = dict.fromkeys(c.path for c in constants if c.path.startswith(f"{folder}/"))
        for path in paths:
            lines += [f"### `{path}`\n", "| constant | value | reason |", "|---|---|---|"]
            for constant in (c for c in constants if c.path == path):
                cells = [f"`{constant.name}`", f"`{constant.value}`", _plain(constant.reason) or "–"]
                lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
            lines.append("")
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Text without Markdown's meanings, except for code."""
    parts = re.split(r"(`+[^`]+`+)", text)
    return "".join(part if part.startswith("`") else re.sub(r"([*^_<\[])", r"\\\1", part) for part in parts)
