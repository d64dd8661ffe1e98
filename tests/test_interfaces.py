"""How the library meets its callers: errors without the command line's words, few positional parameters."""

import ast
import re

import pytest
from architecture import MODULES
from helpers.places import ROOT

#: Positional parameters of a function, ``self`` included.
MOST_POSITIONAL = 7

LIBRARY = [path for path in MODULES if not {"commands", "terminal"} & set(path.parts)]


def sentences(tree):
    """The string constants of a module that are no docstrings."""
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    bodies = [node.body[0] for node in ast.walk(tree) if isinstance(node, holders) and node.body]
    members = {id(first.value) for first in bodies if isinstance(first, ast.Expr)}
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in members
    ]


def relative(path):
    return str(path.relative_to(ROOT))


def speaks_of_the_command_line(text):
    return bool(re.search(r"(^|[^-\w])--[a-z]|`cbox ", text))


@pytest.mark.parametrize("path", LIBRARY, ids=relative)
def test_only_commands_speak_of_options_and_commands(path):
    source = path.read_text(encoding="utf-8")
    strings = sentences(ast.parse(source)) if re.search("--[a-z]|`cbox ", source) else []
    results = [(node.lineno, node.value) for node in strings if speaks_of_the_command_line(node.value)]
    assert results == []


@pytest.mark.parametrize(
    ("text", "speaks"),
    [
        ("--fit", True),
        ("give it with --hide", True),
        ("`cbox add` does", True),
        ("--", False),
        ("a--b", False),
    ],
)
def test_what_counts_as_the_command_line(text, speaks):
    assert speaks_of_the_command_line(text) is speaks


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_long_lists_of_arguments_go_by_name(path):
    functions = [
        node
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    counts = {node.name: len(node.args.posonlyargs) + len(node.args.args) for node in functions}
    assert {name: count for name, count in counts.items() if count > MOST_POSITIONAL} == {}
