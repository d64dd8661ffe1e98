"""Names of a package that are imported when they are first used."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["lazy_names"]


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Functions ``__getattr__`` and ``__dir__`` of a package (PEP 562).

    The imports stand in the package under ``if TYPE_CHECKING``, where type checkers and editors read them, and this
    function too. A command then loads only the modules that it uses. No name may be that of a module of the package.

    Parameters
    ----------
    package
        Full name of the package, which calls this in its ``__init__``.

    Returns
    -------
    Callable
        ``__getattr__`` of the package: imports a name from its module.
    Callable
        ``__dir__`` of the package: its names, including those not imported yet.
    """
    module = sys.modules[package]
    homes = _imports_for_types(Path(str(module.__file__)).read_text(encoding="utf-8"))

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        value = getattr(import_module(homes[name], package), name)
        setattr(module, name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(module), *homes, *module.__all__})

    return load, names


def _imports_for_types(source: str) -> dict[str, str]:
    """Module of each name that a source imports under ``if TYPE_CHECKING``."""
    blocks = [
        node.body
        for node in ast.parse(source).body
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    ]
    return {
        alias.name: "." * node.level + (node.module or "")
        for block in blocks
        for node in block
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
