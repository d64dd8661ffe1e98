"""Sensitivity of verdicts to the constants that decide them: each one times 0.7 and times 1.4.

    python benchmarks/diagnosis/threshold_sensitivity.py CAPTURE ... [BASELINE=CANDIDATE ...] [--only diagnose/evidence]

The suspicions of a capture judge the constants of calibration/quality, its diagnosis those of validate/diagnose. A pair
of cubes, compared as by `cbox regress`, judges those of compare_renders/regress. Every moved constant runs in another
process. There the source of its module is changed before the import, so that values derived from it and modules that
import it follow. Finished verdicts are appended to --results (JSON lines): an interrupted run continues from there.
The constants: docs/reference/decision-constants.md.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.machinery
import json
import math
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))

from decision_constants import DecisionConstant, assigned, decision_constants

#: Factors by which each constant is multiplied.
FACTORS = (0.7, 1.4)

#: Longest time of one process, s.
TIMEOUT_S = 3600.0

#: Subject of a pair of cubes, `BASELINE=CANDIDATE`; any other subject is a capture.
PAIR = "="

_ERROR = "error: "


@dataclass(frozen=True)
class Moved:
    """A constant times a factor; none for the source as it is."""

    #: The constant, None for the baseline.
    constant: DecisionConstant | None = None
    #: Factor on its value.
    factor: float = 1.0

    @property
    def key(self) -> str:
        """Name in the file of results."""
        return "baseline" if self.constant is None else f"{self.constant.key} x {self.factor:g}"


def moves_of(constant: DecisionConstant) -> list[Moved]:
    """The constant times each factor; none where a factor has no meaning.

    Parameters
    ----------
    constant
        Constant with its expression.

    Returns
    -------
    list of Moved
        Empty for an expression such as a grid.
    """
    value = ast.parse(constant.value, mode="eval").body
    return [Moved(constant, factor) for factor in FACTORS] if is_movable(value) else []


#: Verdicts by subject, for a moved constant and the subjects that it concerns.
Verdicts = Callable[[Moved, Sequence[str]], Mapping[str, str]]


def moved_number(value: float, factor: float) -> float:
    """A number times a factor.

    Integers are rounded away from their value, and stay at least 1. A share below 1 that would exceed 1 moves towards 1
    instead, so that the distance to 1 is divided by the factor.

    Parameters
    ----------
    value
        The number.
    factor
        0.7 or 1.4.

    Returns
    -------
    float
        The moved number; equal to the value where it cannot move.
    """
    if isinstance(value, int):
        return max(math.floor(value * factor) if factor < 1 else math.ceil(value * factor), min(value, 1))
    if 0 < value < 1 <= value * factor:
        return 1 - (1 - value) / factor
    return value * factor


class _Scaling(ast.NodeTransformer):
    """Every number of an expression times a factor, but for indices and functions."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        if type(node.value) not in (int, float):
            return node
        return ast.copy_location(ast.Constant(moved_number(node.value, self.factor)), node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        if not is_movable(node):
            return self.generic_visit(node)
        product = eval(compile(ast.Expression(node), "constant", "eval"), {})
        return ast.copy_location(ast.Constant(moved_number(product, self.factor)), node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.Subscript:
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.Lambda:
        return node

    def visit_Dict(self, node: ast.Dict) -> ast.Dict:
        node.values = [self.visit(value) for value in node.values]
        return node


def is_movable(value: ast.expr) -> bool:
    """Whether an expression is a number, or a collection of numbers.

    Parameters
    ----------
    value
        Expression of a constant; arithmetic of numbers is a number.

    Returns
    -------
    bool
        False for expressions such as a grid: a factor on each of its numbers has no meaning.
    """
    allowed = (ast.Constant, ast.Tuple, ast.List, ast.Dict, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop)
    return all(isinstance(node, (*allowed, ast.expr_context)) for node in ast.walk(value))


def moved_tree(source: str, name: str, factor: float) -> ast.Module:
    """Syntax of a module with one constant times a factor.

    Parameters
    ----------
    source
        Text of the module.
    name
        Name of a constant at its top level.
    factor
        Factor on each number of the constant's value.

    Returns
    -------
    ast.Module
        To be compiled.

    Raises
    ------
    KeyError
        Where the module has no such constant.
    """
    tree, changed = ast.parse(source), False
    for node in tree.body:
        for constant, value in assigned(node):
            if constant == name:
                scaled = _Scaling(factor).visit(value)
                changed = True
                if node.value is value:
                    node.value = scaled
                else:
                    node.value.elts[node.value.elts.index(value)] = scaled
    if not changed:
        raise KeyError(name)
    return ast.fix_missing_locations(tree)


class _MovedLoader(importlib.machinery.SourceFileLoader):
    """Loads a module with one constant moved."""

    def __init__(self, fullname: str, path: str, name: str, factor: float) -> None:
        super().__init__(fullname, path)
        self.constant, self.factor = name, factor

    def get_code(self, fullname: str) -> CodeType:
        tree = moved_tree(Path(self.path).read_text(encoding="utf-8"), self.constant, self.factor)
        return compile(tree, self.path, "exec")


class MovedFinder(importlib.abc.MetaPathFinder):
    """Finds the module of a moved constant before any other finder does."""

    def __init__(self, module: str, name: str, factor: float) -> None:
        self.module, self.constant, self.factor = module, name, factor

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Specification of the module with its constant moved; None for any other module."""
        if fullname != self.module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        if spec is not None and spec.origin is not None:
            spec.loader = _MovedLoader(fullname, spec.origin, self.constant, self.factor)
        return spec


def concerns(constant: DecisionConstant | None, subject: str) -> bool:
    """Whether a constant takes part in the verdict of a subject.

    Parameters
    ----------
    constant
        The constant; None for the baseline, which concerns every subject.
    subject
        Folder of a capture, or a pair of cubes.

    Returns
    -------
    bool
        Constants of `cbox regress` for pairs, all others for captures.
    """
    return constant is None or ("/regress/" in constant.path) == (PAIR in subject)


def verdict_of(subject: str, constant: DecisionConstant | None, cache: Path | None) -> str:
    """Verdict on a subject, computed in this process.

    Parameters
    ----------
    subject
        Folder of a capture, or a pair of cubes.
    constant
        The moved constant: one of calibration/quality decides suspicions alone. None: the complete verdict.
    cache
        Folder of rendered pictures that other processes reuse.

    Returns
    -------
    str
        In one line; parts separated by " | ", suspicions first.
    """
    import cboxlab

    if PAIR in subject:
        from cboxlab.validation.compare_renders.regress import regress_inputs

        baseline, candidate = subject.split(PAIR)
        outcome = regress_inputs(baseline, candidate)
        return ", ".join(["same" if outcome.same else "different", *(change.change for change in outcome.changes[:1])])
    records = [suspicion.record for suspicion in cboxlab.calibrate(subject).calibration.suspicions]
    first = "; ".join(sorted(f"{record['where']}: {record['what']}" for record in records)) or "no suspicion"
    if constant is not None and constant.path.startswith("calibration/"):
        return first
    diagnosis = cboxlab.diagnose(subject, cache=cache).diagnosis
    family = "nothing remains" if diagnosis.explanation is None else diagnosis.explanation.family
    groups = ", ".join("/".join(group) for group in diagnosis.indistinguishable)
    return f"{first} | {', '.join(diagnosis.selected) or 'adequate'} | {groups or 'no rival'} | {family}"


def _worker(arguments: argparse.Namespace) -> None:
    """Print the verdicts on the subjects as JSON, one a line, with a constant moved."""
    constant = None
    if arguments.worker != "baseline":
        constant = {c.key: c for c in decision_constants()}[arguments.worker]
        sys.meta_path.insert(0, MovedFinder(constant.module, constant.name, arguments.factor))
    for subject in arguments.subjects:
        print(json.dumps({subject: verdict_of(subject, constant, arguments.cache)}), flush=True)


def in_processes(cache: Path | None) -> Verdicts:
    """Verdicts computed in a process for each moved constant.

    Parameters
    ----------
    cache
        Folder of rendered pictures.

    Returns
    -------
    Verdicts
        A process that fails makes the verdict "error" with its last line, for the subjects without a verdict.
    """

    def verdicts(moved: Moved, subjects: Sequence[str]) -> Mapping[str, str]:
        key = "baseline" if moved.constant is None else moved.constant.key
        command = [sys.executable, __file__, *subjects, "--worker", key, "--factor", str(moved.factor)]
        command += [] if cache is None else ["--cache", str(cache)]
        try:
            run = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
            printed, fault = run.stdout, (run.stderr.strip().splitlines() or [f"exit status {run.returncode}"])[-1]
        except subprocess.TimeoutExpired as error:
            printed, fault = (error.stdout or b"").decode(), f"no verdict after {TIMEOUT_S:g} s"
        rows = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
        return {**dict.fromkeys(subjects, f"{_ERROR}{fault}"), **{k: v for row in rows for k, v in row.items()}}

    return verdicts


def measure(
    constants: Sequence[DecisionConstant],
    subjects: Sequence[str],
    verdicts: Verdicts,
    results: Path,
    progress: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
) -> dict[str, dict[str, str]]:
    """Verdicts for the source as it is and for each constant moved.

    Parameters
    ----------
    constants
        Constants to move.
    subjects
        Folders of captures, and pairs of cubes.
    verdicts
        Computes the verdicts for a moved constant.
    results
        File of JSON lines with finished verdicts, which are not computed again; new ones are appended.
    progress
        Receives a line for each moved constant.

    Returns
    -------
    dict
        Verdicts by subject, by key of the moved constant.

    Raises
    ------
    RuntimeError
        Where a subject has no verdict with the source as it is.
    """
    table: dict[str, dict[str, str]] = defaultdict(dict)
    if results.exists():
        for line in results.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            table[row["moved"]][row["subject"]] = row["verdict"]
    moves = [Moved(), *(moved for constant in constants for moved in moves_of(constant))]
    with results.open("a", encoding="utf-8") as file:
        for index, moved in enumerate(moves, 1):
            done = table[moved.key]
            missing = [s for s in subjects if concerns(moved.constant, s) and s not in done]
            if missing:
                for subject, verdict in verdicts(moved, missing).items():
                    if moved.constant is None and verdict.startswith(_ERROR):
                        raise RuntimeError(f"{subject}: {verdict}")
                    done[subject] = verdict
                    file.write(json.dumps({"moved": moved.key, "subject": subject, "verdict": verdict}) + "\n")
                file.flush()
            count = len(changes(table, moved.key, subjects))
            progress(f"[{index}/{len(moves)}] {moved.key}: {count} of {len(done)} verdicts change")
    return dict(table)


def changes(table: Mapping[str, Mapping[str, str]], key: str, subjects: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Verdicts that a moved constant changes.

    A verdict of suspicions alone is compared with the first part of the complete one.

    Parameters
    ----------
    table
        Verdicts by subject, by key of the moved constant.
    key
        Key of a moved constant.
    subjects
        Subjects to compare.

    Returns
    -------
    dict
        Verdict before and after, by subject.
    """
    changed = {}
    for subject in subjects:
        after = table.get(key, {}).get(subject)
        if after is not None:
            before = table["baseline"][subject]
            parts = len(after.split(" | "))
            before = before if after.startswith(_ERROR) else " | ".join(before.split(" | ")[:parts])
            if after != before:
                changed[subject] = before, after
    return changed


def report(
    constants: Sequence[DecisionConstant], table: Mapping[str, Mapping[str, str]], subjects: Sequence[str]
) -> str:
    """The changed verdicts as Markdown, then the constants that change none or were not moved.

    Parameters
    ----------
    constants
        Constants that were to be moved.
    table
        Verdicts by subject, by key of the moved constant.
    subjects
        Subjects of the verdicts.

    Returns
    -------
    str
        A table and two lines.
    """
    lines = ["| constant | factor | subject | before | after |", "|---|---|---|---|---|"]
    steady, fixed = [], []
    for constant in constants:
        if not moves_of(constant):
            fixed.append(constant.key)
            continue
        rows = [
            f"| {constant.key} = {constant.value} | {moved.factor:g} | {Path(subject).name} | {before} | {after} |"
            for moved in moves_of(constant)
            for subject, (before, after) in changes(table, moved.key, subjects).items()
        ]
        lines += rows
        if not rows and any(concerns(constant, subject) for subject in subjects):
            steady.append(constant.key)
    lines.append(f"\n{len(steady)} constants change no verdict: {', '.join(steady) or 'none'}.")
    return "\n".join([*lines, f"{len(fixed)} are no numbers and were not moved: {', '.join(fixed) or 'none'}."])


def main() -> None:
    """Measure and print the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="+", metavar="CAPTURE|BASELINE=CANDIDATE")
    parser.add_argument("--only", default="", help="constants whose key contains this text")
    parser.add_argument("--results", type=Path, default=Path("threshold_sensitivity.jsonl"))
    parser.add_argument("--cache", type=Path, help="folder of rendered pictures, reused by all processes")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--factor", type=float, default=1.0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        _worker(arguments)
        return
    constants = [constant for constant in decision_constants() if arguments.only in constant.key]
    table = measure(constants, arguments.subjects, in_processes(arguments.cache), arguments.results)
    print(report(constants, table, arguments.subjects))


if __name__ == "__main__":
    main()
