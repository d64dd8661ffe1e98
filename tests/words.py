"""Measures of the language of code and manual: ``python tests/words.py [PATH ...]`` lists faults, ``--update`` limits.

Counts by package, and of the manual's pages as ``docs``. ``tests/test_words.py`` compares them with the limits in
``tests/words_limits.json``, which only decrease.
"""

from __future__ import annotations

import ast
import io
import json
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from architecture import MODULES, package_of
from helpers.places import ROOT

LIMITS = ROOT / "tests" / "words_limits.json"

#: Pages of the manual that people write.
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))

#: Modules of tests, benchmarks and the manual's making by folder; only nameless locals and banned words count there.
SCRIPTS = {name: sorted((ROOT / name).rglob("*.py")) for name in ("tests", "benchmarks", "docs")}

#: Names that point at a value instead of saying what it is.
NAMELESS = frozenset(
    """
    found own one ones known told seen made kept place places words here there thing things given taken asked lit
    shown stated wanted whole held looked tried drawn solved named chosen left
    """.split()  # noqa: SIM905
)
#: Words and phrases for which the language of the field has a plainer one.
BANNED = re.compile(
    r"\b(so many|tells?|told|lest|whereof|of which|likewise|in (?:its|their|each other's) stead|anew|thereof|"
    r"of (?:its|their) own|beside|astray|hereof)\b",
    re.IGNORECASE,
)
#: Names with banned words that stay: a method of Python's files, and keys of files that users read.
EXEMPT_NAMES = frozenset({"tell", "told_apart", "beside_errors"})
#: A docstring's first word that begins a clause.
CLAUSE = re.compile(r"(What|Of|How|Which|Where|When|That|Why|Who|Lest|As|So)\b")
MAX_FIRST_LINE, MAX_WORDS = 90, 30

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_SENTENCE_END = re.compile(r"(?<=[.!?;:])\s+")


@dataclass(frozen=True)
class Finding:
    """One fault of language: where it is, and which measure counts it."""

    path: Path
    line: int
    measure: str
    text: str


def findings(path: Path) -> list[Finding]:
    """All faults of one module or page."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return [Finding(path, *fault) for fault in _page(source)]
    if any(path in paths for paths in SCRIPTS.values()):
        names = _names(list(ast.walk(ast.parse(source))))
        # tokens are read slowly, and only where a banned phrase stands, possibly across lines of a comment
        prose = _Module.read(source).prose if BANNED.search(re.sub(r"[#:\s]+", " ", source)) else []
        return [Finding(path, *fault) for fault in (*names, *_banned(prose))]
    module = _Module.read(source)
    faults = [*_names(module.nodes), *_docstrings(module), *_constants(module), *_texts(module)]
    return [Finding(path, *fault) for fault in faults]


@dataclass(frozen=True)
class _Module:
    """A module's source, read once: trees and tokens are walked slowly."""

    lines: list[str]
    nodes: list[ast.AST]  # the module's own node first
    docstrings: dict[ast.AST, str | None]  # of every node that may have one
    comments: list[tuple[int, str]]
    prose: list[tuple[int, str]]

    @classmethod
    def read(cls, source: str) -> _Module:
        nodes = list(ast.walk(ast.parse(source)))
        docstrings = {node: ast.get_docstring(node) for node in nodes if isinstance(node, _DOCUMENTED)}
        comments, blocks = _comments(source)
        texts = [(getattr(node, "lineno", 1), text) for node, text in docstrings.items() if text is not None]
        return cls(source.splitlines(), nodes, docstrings, comments, texts + blocks)


def _comments(source: str) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """(line, text) of every comment, and of blocks of comments."""
    comments: list[tuple[int, str]] = []
    blocks: list[tuple[int, str]] = []
    block: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comments.append((token.start[0], token.string))
            block.append(token.string.lstrip("#: "))
        elif block and token.type not in (tokenize.NL, tokenize.NEWLINE):
            blocks.append((token.start[0] - len(block), " ".join(block)))
            block = []
    return comments, blocks


def assigned_names(nodes: list[ast.AST]) -> list[tuple[int, str]]:
    """(line, name) of everything that is bound: variables, parameters, loop and exception names."""
    names = []
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.append((node.lineno, node.id))
        elif isinstance(node, ast.arg):
            names.append((node.lineno, node.arg))
        elif isinstance(node, ast.ExceptHandler) and node.name:
            names.append((node.lineno, node.name))
    return names


def _names(nodes: list[ast.AST]) -> Iterator[tuple[int, str, str]]:
    """Nameless variables, and banned words in names of variables, functions and classes."""
    names = assigned_names(nodes)
    directions = "right" in {name for _, name in names}
    for line, name in names:
        if name.strip("_") in NAMELESS and not (name == "left" and directions):
            yield line, "nameless", name
    definitions = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    defined = [(node.lineno, node.name) for node in nodes if isinstance(node, definitions)]
    for line, name in defined:
        if name.strip("_") in NAMELESS:
            yield line, "nameless", f"{name}()"
    for line, name in (*names, *defined):
        if name not in EXEMPT_NAMES and BANNED.search(name.replace("_", " ")):
            yield line, "banned", f"name {name}"


def _is_public(name: str) -> bool:
    return not name.startswith("_")


def _decorators(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> set[str]:
    return set(re.findall(r"\w+", " ".join(ast.unparse(item) for item in node.decorator_list)))


def _sections(node: ast.FunctionDef | ast.AsyncFunctionDef, text: str) -> Iterator[str]:
    """Sections that a public function's docstring lacks."""
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    arguments = [argument for argument in arguments if argument.arg not in ("self", "cls")]
    returns = node.returns is not None and ast.unparse(node.returns) not in (
        "None",
        "NoReturn",
        "Self",
        "Iterator[None]",
    )
    # help texts document the parameters of a command; its docstring is printed as its help
    command = any(item.annotation is not None and "help=" in ast.unparse(item.annotation) for item in arguments)
    if arguments and not command and not re.search(r"^Parameters\n-+$", text, re.MULTILINE):
        yield "Parameters"
    if returns and not re.search(r"^(Returns|Yields)\n-+$", text, re.MULTILINE):
        yield "Returns"
    if re.search(r"\bRaises\b", text) and not re.search(r"^Raises\n-+$", text, re.MULTILINE):
        yield "Raises"


def _hidden(node: ast.AST, hidden: bool = False) -> Iterator[ast.AST]:
    """Classes and functions inside functions or private classes."""
    for child in ast.iter_child_nodes(node):
        # of expressions alone no definition is a part
        if isinstance(child, ast.expr):
            continue
        if hidden and isinstance(child, _DOCUMENTED):
            yield child
        inside = isinstance(child, ast.FunctionDef) or (isinstance(child, ast.ClassDef) and not _is_public(child.name))
        yield from _hidden(child, hidden or inside)


def _docstrings(module: _Module) -> Iterator[tuple[int, str, str]]:
    lines, hidden = module.lines, set(_hidden(module.nodes[0]))
    for node, text in module.docstrings.items():
        name, line = getattr(node, "name", "module"), getattr(node, "lineno", 1)
        public = _is_public(name) and node not in hidden
        if text is None:
            short = isinstance(node, ast.FunctionDef) and len(node.body) <= 1
            if public and not short and not isinstance(node, ast.Module):
                yield line, "docstring", f"{name}: none"
            continue
        first = text.splitlines()[0]
        if len(first) > MAX_FIRST_LINE or CLAUSE.match(first) or not first.endswith((".", ":")):
            yield line, "first-line", f"{name}: {first}"
        if public and isinstance(node, ast.FunctionDef) and not _decorators(node) & {"property", "cached_property"}:
            for section in _sections(node, text):
                yield line, "section", f"{name}: no {section}"
        if public and isinstance(node, ast.ClassDef) and "dataclass" in _decorators(node):
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                    above, same = lines[field.lineno - 2].strip(), lines[field.end_lineno - 1]
                    if _is_public(field.target.id) and not above.startswith("#:") and "#:" not in same:
                        yield field.lineno, "field", f"{name}.{field.target.id}"


def _constants(module: _Module) -> Iterator[tuple[int, str, str]]:
    for node in module.nodes[0].body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            names = [ast.unparse(item) for item in node.targets[0].elts]
            if all(name.isupper() for name in names):
                yield node.lineno, "tuple-constant", ", ".join(names)


def _banned(texts: list[tuple[int, str]]) -> Iterator[tuple[int, str, str]]:
    """Banned words and phrases, also where a line ends inside a phrase."""
    for line, text in texts:
        joined = " ".join(text.split())
        for match in BANNED.finditer(joined):
            yield line, "banned", f"{match.group()}: {joined[max(match.start() - 30, 0) : match.end() + 40]!r}"


def _texts(module: _Module) -> Iterator[tuple[int, str, str]]:
    """Banned words in docstrings, comments and messages; sentences that are too long in docstrings and comments."""
    documentation = {node.body[0].value for node, text in module.docstrings.items() if text is not None}
    messages = [
        (node.lineno, node.value)
        for node in module.nodes
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in documentation
    ]
    yield from _banned([*module.prose, *((line, text) for line, text in messages if " " in text)])
    for line, text in module.comments:
        if "fmt: skip" in text:
            yield line, "fmt-skip", ""
    for line, text in module.prose:
        yield from _long_sentences(line, text)


def _long_sentences(line: int, text: str) -> Iterator[tuple[int, str, str]]:
    for paragraph in re.split(r"\n\s*\n|\n(?=\s*[-*] )|\n-+\n|(?<=\n)\w[\w, ]* : .*\n", text):
        for sentence in _SENTENCE_END.split(" ".join(paragraph.split())):
            count = len(re.findall(r"[^\W\d_][\w'-]*", sentence))
            if count > MAX_WORDS:
                yield line, "long-sentence", f"{count} words: {sentence[:80]}"


def _page(source: str) -> Iterator[tuple[int, str, str]]:
    """Banned words and long sentences of a page, outside code; a table's cell is a sentence."""
    without_code = re.sub(r"^( *)(`{3,}).*?^ *\2", lambda m: "\n" * m.group().count("\n"), source, flags=re.M | re.S)
    paragraph: list[str] = []
    for line, text in enumerate([*without_code.splitlines(), ""], start=1):
        apart = not text.strip() or text.startswith(("|", "#")) or re.match(r"\s*([-*]|\d+\.) ", text)
        if apart and paragraph:
            yield from _banned([(line - len(paragraph), "\n".join(paragraph))])
            if not paragraph[0].startswith("    "):
                yield from _long_sentences(line - len(paragraph), "\n".join(paragraph))
            paragraph = []
        if text.startswith("|"):
            yield from _banned([(line, text)])
        for cell in text.split("|") if text.startswith("|") else ():
            yield from _long_sentences(line, cell)
        if text.strip() and not text.startswith("|"):
            paragraph.append(text)


def documentation_lines(path: Path) -> tuple[int, int]:
    """Lines of docstrings and attribute documentation, and all lines, of a module."""
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    count = len(re.findall(r"^\s*#:", source, re.MULTILINE))
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            count += node.body[0].end_lineno - node.body[0].lineno + 1
    return count, len(source.splitlines())


def counts() -> dict[str, dict[str, int]]:
    """By package, the number of faults of each measure."""
    table: dict[str, Counter[str]] = {}
    for path in MODULES:
        package = table.setdefault(package_of(path), Counter())
        package.update(finding.measure for finding in findings(path))
    for folder, paths in SCRIPTS.items():
        table[folder] = Counter(finding.measure for path in paths for finding in findings(path))
    table["docs"].update(finding.measure for path in PAGES for finding in findings(path))
    return {package: dict(sorted(table[package].items())) for package in sorted(table)}


def main(arguments: list[str]) -> None:
    if arguments == ["--update"]:
        LIMITS.write_text(json.dumps(counts(), indent=1) + "\n", encoding="utf-8")
        return
    folders = [Path(name).resolve() for name in arguments] or [ROOT]
    groups = (MODULES, [path for paths in SCRIPTS.values() for path in paths], PAGES)
    paths, scripts, pages = ([p for p in group if any(p.is_relative_to(f) for f in folders)] for group in groups)
    total: Counter[str] = Counter()
    for finding in (finding for path in (*paths, *scripts, *pages) for finding in findings(path)):
        total[finding.measure] += 1
        if arguments:
            print(f"{finding.path.relative_to(ROOT)}:{finding.line}: {finding.measure}: {finding.text}")
    print(dict(sorted(total.items())))
    if not paths:
        return
    names = sum(len(assigned_names(list(ast.walk(ast.parse(path.read_text(encoding="utf-8")))))) for path in paths)
    documented, lines = (sum(column) for column in zip(*map(documentation_lines, paths), strict=True))
    print(f"nameless {total['nameless'] / names:.2%} of {names} names, documentation {documented / lines:.1%} of lines")


if __name__ == "__main__":
    main(sys.argv[1:])
