"""Do the tests find faults nobody thought of? Changes one place of the physics at a time and runs its package's tests.

    python benchmarks/mutate_physics.py --out mutants.jsonl --count 200 --seed 1
    python benchmarks/mutate_physics.py --out mutants.jsonl --count 40 --only calibration

A mutant changes one sign, factor, power, axis, transpose, unit, quadrature sum, wavelength or degree of freedom.
Modules take turns, so that each has its share. Its tests, those of ``tests/ROOM/PACKAGE``, have a minute; a mutant
whose tests take longer counts as escaped. Every result is a line of the file, from which a stopped run goes on; a new
file looks again. Prints what escapes; exit code 1 if more than one in twenty does.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from planted_faults import ROOT, copy_tree, run_tests

PHYSICS = (
    *(f"calibration/{name}" for name in ("correction", "detector", "radiometry", "colour", "geometry")),
    *(
        f"render/{name}"
        for name in ("chain", "sensor", "perturbation", "visibility", "radiosity", "integrators")
    ),
    *(f"validate/{name}" for name in ("compare", "diagnose", "effects")),
)
LIMIT_S = 60.0
_SIGNS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}


@dataclass(frozen=True)
class Mutant:
    """kind : in the field's words. line : from 1. text, mutated : source before and after. start : character."""

    file: str
    line: int
    kind: str
    text: str
    mutated: str
    start: int

    @property
    def name(self) -> str:
        return f"{self.file}:{self.start}:{self.mutated}"


def _changes(node: ast.AST) -> Iterator[tuple[str, str]]:
    """(kind, new text) of the changes of one expression."""
    if isinstance(node, ast.BinOp):
        left, right = ast.unparse(node.left), ast.unparse(node.right)
        if type(node.op) in _SIGNS and not isinstance(node.left, ast.Constant | ast.JoinedStr):
            kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "factor"
            yield kind, f"(({left}) {_SIGNS[type(node.op)]} ({right}))"
        if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
            yield "power", f"(({left}) ** {node.right.value - 1})"
        if isinstance(node.op, ast.Add | ast.Sub) and right == "0.5":
            yield "half pixel", f"({left})"
    elif isinstance(node, ast.Attribute) and node.attr == "T":
        yield "transpose", f"({ast.unparse(node.value)})"
    elif isinstance(node, ast.Call):
        name = ast.unparse(node.func)
        arguments = [ast.unparse(argument) for argument in node.args]
        if name in ("np.radians", "np.degrees"):
            yield "unit", f"({arguments[0]})"
        if name in ("np.sqrt", "math.sqrt"):
            yield "power", f"({arguments[0]})"
        if name in ("np.hypot", "math.hypot") and len(arguments) == 2:
            yield "share left out", f"abs({arguments[0]})"
        if name == "np.interp":
            yield "wavelength shift", f"np.interp(({arguments[0]}) + 2.0, {', '.join(arguments[1:])})"
        for key in node.keywords:
            if key.arg == "ddof" and isinstance(key.value, ast.Constant):
                yield "degrees of freedom", ast.unparse(node).replace(f"ddof={key.value.value}", "ddof=0")
            if key.arg == "axis" and isinstance(key.value, ast.Constant) and key.value.value in (0, 1):
                swapped = 1 - key.value.value
                yield "axis", ast.unparse(node).replace(f"axis={key.value.value}", f"axis={swapped}")


def _arithmetic(node: ast.AST) -> Iterator[ast.AST]:
    """The expressions of functions, without annotations, text and what is raised."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.JoinedStr | ast.Raise | ast.arg):
            continue
        if isinstance(node, ast.FunctionDef) and child is node.returns:
            continue
        if isinstance(child, ast.expr):
            yield child
        yield from _arithmetic(child)


def mutants_of(file: str) -> list[Mutant]:
    """All mutants of a source file, named from the repository's root."""
    source = (ROOT / file).read_text(encoding="utf-8")
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    for function in functions:
        for node in _arithmetic(function):
            text = ast.get_source_segment(source, node)
            line = source.splitlines()[node.lineno - 1]  # type: ignore[attr-defined]
            # columns are counted in bytes
            column = len(line.encode()[: node.col_offset].decode())  # type: ignore[attr-defined]
            for kind, mutated in _changes(node):
                start = starts[node.lineno - 1] + column  # type: ignore[attr-defined]
                found.append(Mutant(file, node.lineno, kind, text or "", mutated, start))  # type: ignore[attr-defined]
    return list({mutant.name: mutant for mutant in found}.values())


def sample(count: int, seed: int, only: str) -> list[Mutant]:
    """At most ``count`` mutants, the modules in turn, kinds of a module in turn; the same for the same seed."""
    draw = random.Random(seed)
    queues = []
    for package in PHYSICS:
        for path in sorted((ROOT / package).glob("*.py")):
            file = path.relative_to(ROOT).as_posix()
            left = mutants_of(file)
            draw.shuffle(left)
            turn: dict[str, int] = {}
            rounds = []
            for mutant in left:
                turn[mutant.kind] = turn.get(mutant.kind, -1) + 1
                rounds.append((turn[mutant.kind], mutant))
            rounds.sort(key=lambda entry: entry[0])
            if rounds and file.startswith(only):
                queues.append([mutant for _, mutant in rounds])
    draw.shuffle(queues)
    taken: list[Mutant] = []
    while queues and len(taken) < count:
        queues = [queue for queue in queues if queue]
        taken += [queue.pop(0) for queue in queues]
    return taken[:count]


def verdict_of(mutant: Mutant, folder: Path) -> str:
    """``found by TEST``, ``ESCAPED`` or ``no answer within a minute``, of a copy of the sources; mends the copy."""
    path = folder / mutant.file
    source = path.read_text(encoding="utf-8")
    end = mutant.start + len(mutant.text)
    if source[mutant.start : end] != mutant.text:
        raise ValueError(f"{mutant.file} line {mutant.line} is not {mutant.text}")
    path.write_text(source[: mutant.start] + mutant.mutated + source[end:], encoding="utf-8")
    package = "tests" / Path(mutant.file).parent
    own = folder / package / f"test_{Path(mutant.file).stem.lstrip('_')}.py"
    # the module's own tests first
    paths = [own.relative_to(folder).as_posix()] if own.exists() else []
    try:
        failure = run_tests(folder, [*paths, package.as_posix()], LIMIT_S)
    except subprocess.TimeoutExpired:
        return "no answer within a minute"
    finally:
        path.write_text(source, encoding="utf-8")
    return "ESCAPED" if failure is None else f"found by {failure}"


def main() -> int:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--out", type=Path, required=True, help="file of results, one line of JSON each")
    options.add_argument("--count", type=int, default=200)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--only", default="", help="start of the files' paths")
    asked = options.parse_args()
    lines = asked.out.read_text(encoding="utf-8").splitlines() if asked.out.exists() else []
    results = {entry["name"]: entry["verdict"] for entry in map(json.loads, lines)}
    chosen = sample(asked.count, asked.seed, asked.only)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / ROOT.name
        copy_tree(folder)
        for mutant in chosen:
            if mutant.name not in results:
                results[mutant.name] = verdict_of(mutant, folder)
                entry = {"name": mutant.name, "verdict": results[mutant.name], **asdict(mutant)}
                with asked.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(entry) + "\n")
    escaped = [mutant for mutant in chosen if not results[mutant.name].startswith("found")]
    for mutant in escaped:
        place = f"{mutant.file}:{mutant.line}"
        print(f"{place:50s} {mutant.kind:18s} {results[mutant.name]}: {mutant.text} -> {mutant.mutated}")
    print(f"{len(chosen) - len(escaped)} of {len(chosen)} found")
    return 1 if len(escaped) > len(chosen) / 20 else 0


if __name__ == "__main__":
    sys.exit(main())
