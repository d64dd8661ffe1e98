"""Do the tests find faults nobody thought of? Changes one place of the physics at a time and runs its module's tests.

    python benchmarks/mutation/mutate_physics.py --out mutants.jsonl --count 200 --seed 1
    python benchmarks/mutation/mutate_physics.py --out mutants.jsonl --count 40 --only calibration
    python benchmarks/mutation/mutate_physics.py --out mutants.jsonl --count 300 --seed 64 --own --limit 20

A mutant changes one sign, factor, power, axis, transpose, unit, half pixel, quadrature sum, wavelength, dark frame,
degree of freedom, or takes energy for quanta. Modules take turns, so that each has its share. A module's tests are
its own file of tests, then those of its package, others that name it or what it defines, and those of packages that
use it. They have a minute of processor time (``--limit``); a mutant whose tests take longer counts as escaped.
``--own`` takes modules with a file of tests that has their name, and runs it alone. A test that fails without the
mutant, too, finds nothing. Code is exchanged in this process, which saves new ones; one that hangs in a kernel is
stopped by hand, and counts as escaped.

Every result is a line of the file, the last of a mutant counts, and a stopped run goes on from there; mutants whose
lines are taken out are looked at again. Prints what escapes; exit code 1 if more than one in twenty does. Changes
known to change nothing (EQUIVALENT) are printed and not counted.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from exchanged_code import OutOfTime, exchanged, run_here
from planted_faults import ROOMS, ROOT

PHYSICS = (
    "scenes",
    "scenes/spectrum_readers",
    "render/effects",
    *(f"calibration/{name}" for name in ("correction", "detector", "radiometry", "colour", "geometry")),
    *(f"calibration/{name}" for name in ("instrument", "quality", "quality/frame_checks")),
    *(f"render/{name}" for name in ("chain", "sensor", "perturbation", "visibility", "radiosity", "integrators")),
    *(f"render/{name}" for name in ("fitted_fields", "image", "photometry", "dataset", "materials", "synthetic")),
    *(f"validate/{name}" for name in ("compare", "diagnose", "predict", "capture_checks")),
    *(f"validate/diagnose/{name}" for name in ("base_flaws", "explain", "field_fit", "linear_model", "hypotheses")),
    *(f"validate/compare_renders/{name}" for name in ("regress", "stored_references", "renderers")),
)
_SIGNS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
_DARKS = {"dark_scene": "dark_flat", "dark_flat": "dark_reference", "dark_reference": "dark_scene"}
_AXES = {"0": "1", "1": "0", "2": "1", "-1": "-2", "-2": "-1"}
#: Names of files, and of the clock.
_NOT_PHYSICS = re.compile(r"\b(folder|path|directory|perf_counter)\b")
_NOT_NUMBERS = (ast.JoinedStr, ast.List, ast.ListComp, ast.Tuple, ast.Dict)
#: Changes of a file's expression that change nothing which can be observed, and why: they are not run.
EQUIVALENT = {
    (
        "render/sensor/simulation.py",
        "mean + detector.offset_spread_dn * draws.standard_normal(electrons.shape)",
    ): "a normal draw of either sign is a normal draw",
    (
        "calibration/detector/photon_transfer.py",
        "mean.shape[1] - 1",
    ): "another unit of a coordinate whose polynomials are fitted: the same polynomials",
    (
        "render/integrators/general_path_tracer.py",
        "RAY_OFFSET_MM * dr.sign(dr.dot(way, hit.normal))",
    ): "over a sign is times the sign",
    ("render/integrators/passes.py", "job.seed + 7919 * job.number"): "other seeds, as different from each other",
    ("render/integrators/path_points.py", "x + seed"): "another hash of the seed",
    ("validate/diagnose/search.py", "np.sqrt(ratio)"): "another start of a search that arrives",
    ("validate/compare/maps.py", "measured - rendered + 0 * relative[1]"): "the sign of nothing",
    ("validate/diagnose/effect_fit.py", "rounds * len(candidates)"): "reports of the progress",
    ("render/radiosity/lamp.py", "centre[2] + half[2] * place(v)"): "a lamp's pattern is the same on both sides",
    (
        "validate/diagnose/further_captures.py",
        "surveyed(step.after.applied) - here",
    ): "camera's own columns are in the design: another combination of the same columns",
    ("calibration/geometry/targets.py", "v - top"): "a plane is fitted: the same planes",
    ("render/image/film.py", "job.batch_seed + BATCH_SEED_STEP * (batch + 1)"): "other seeds, as different",
    ("render/fitted_fields/exchange.py", "self.shift_px[0] + i"): "the same nine neighbours in another order",
    ("validate/diagnose/explain/odds.py", "utility - utility.max()"): "a common factor of shares whose sum is 1",
    (
        "validate/compare_renders/regress/view_explanations.py",
        "p.sum(axis=-1)",
    ): "another unit of the light whose place is looked for",
    (
        "validate/diagnose/effect_fit.py",
        "(turn * len(candidates) + position + 1) / (rounds * len(candidates))",
    ): "reports of the progress",
    ("validate/diagnose/effect_fit.py", "turn * len(candidates) + position"): "reports of the progress",
    (
        "validate/diagnose/search.py",
        "factors / np.linalg.norm(factors, axis=0)",
    ): "columns of other lengths: a basis of the same space",
    (
        "calibration/radiometry/uncertainty.py",
        "share @ share * np.outer(unit, unit)",
    ): "over ones is times ones",
    (
        "calibration/detector/nonlinearity.py",
        "knot_counts[-1] - knot_counts[0]",
    ): "another factor of the first slope, which all rows of the fit share",
    (
        "calibration/geometry/distortion_choice.py",
        "2 * count - model.shared - 6 * len(cameras)",
    ): "a fit with fewer coordinates than numbers is refused, too",
    (
        "calibration/correction/exposure_merge.py",
        "used * a",
    ): "another start of an iteration that arrives, to 3e-13",
    ("validate/diagnose/stepwise.py", "(index + 1) / len(possible)"): "reports of the progress",
    (
        "validate/compare_renders/regress/explanations.py",
        "exponent / e",
    ): "the list holds each exponent and its inverse",
    (
        "validate/diagnose/field_fit/field.py",
        "1 / width + _TRIAL_RIDGE * np.trace(a)",
    ): "rounding: the system is regular with either sign",
    (
        "validate/diagnose/field_fit/light_exchange.py",
        "weight.T + np.float32(1e-9)",
    ): "weights of 0 count alike with either sign, and others are far larger",
    ("validate/diagnose/field_fit/field.py", "s - before"): "all six rounds: the same fit within its tolerance",
}


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


def _number(node: ast.AST) -> bool:
    """Whether an operand may be a number: no text, no list."""
    text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return not (text or isinstance(node, _NOT_NUMBERS))


def _of_operator(node: ast.BinOp) -> Iterator[tuple[str, str]]:
    left, right = ast.unparse(node.left), ast.unparse(node.right)
    numbers = _number(node.left) and _number(node.right) and not _NOT_PHYSICS.search(ast.unparse(node))
    if type(node.op) in _SIGNS and numbers and not isinstance(node.left, ast.Constant):
        kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "factor"
        yield kind, f"(({left}) {_SIGNS[type(node.op)]} ({right}))"
    if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
        yield "power", f"(({left}) ** {node.right.value - 1})"
    if isinstance(node.op, ast.Add | ast.Sub) and right == "0.5":
        yield "half pixel", f"({left})"


def _of_call(node: ast.Call) -> Iterator[tuple[str, str]]:
    name = ast.unparse(node.func)
    function, text = name.rpartition(".")[2], ast.unparse(node)
    arguments = [ast.unparse(argument) for argument in node.args]
    if function in ("radians", "degrees", "deg2rad", "rad2deg"):
        yield "unit", f"({arguments[0]})"
    if function in ("sqrt", "square"):
        yield "power", f"({arguments[0]})"
    if function == "hypot" and len(arguments) == 2:
        yield "share left out", f"abs({arguments[0]})"
    if name == "np.interp":
        rest = [*arguments[1:], *(ast.unparse(key) for key in node.keywords)]
        yield "wavelength shift", f"np.interp(({arguments[0]}) + 2.0, {', '.join(rest)})"
    if function == "at" and re.search("nm|wavelength|grid", ", ".join(arguments), re.IGNORECASE):
        yield "wavelength shift", f"{name}(({arguments[0]}) + 2.0)"
    if name == "dark.at":
        yield "dark frame", "dark.bias"
    if function == "quanta_per_joule":
        yield "energy for quanta", f"{name}(0 * ({arguments[0]}) + 555.0)"
    for key in node.keywords:
        value = ast.unparse(key.value)
        if key.arg == "ddof":
            yield "degrees of freedom", text.replace(f"ddof={value}", "ddof=0")
        if key.arg == "axis" and value in _AXES:
            yield "axis", text.replace(f"axis={value}", f"axis={_AXES[value]}")


def _changes(node: ast.AST) -> Iterator[tuple[str, str]]:
    """(kind, new text) of the changes of one expression or one statement like ``a += b``."""
    if isinstance(node, ast.BinOp):
        yield from _of_operator(node)
    elif isinstance(node, ast.Call):
        yield from _of_call(node)
    elif isinstance(node, ast.AugAssign):
        if type(node.op) in _SIGNS and _number(node.value):
            kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "factor"
            target, value = ast.unparse(node.target), ast.unparse(node.value)
            yield kind, f"{target} {_SIGNS[type(node.op)]}= {value}"
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        mask = isinstance(node.operand, ast.Constant) and isinstance(node.operand.value, int)
        if not mask:  # places in arrays and numbers of axes
            yield "sign", f"({ast.unparse(node.operand)})"
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
        if node.attr == "T":
            yield "transpose", f"({ast.unparse(node.value)})"
        if node.attr in _DARKS:
            yield "dark frame", f"{ast.unparse(node.value)}.{_DARKS[node.attr]}"


def _arithmetic(node: ast.AST) -> Iterator[ast.expr | ast.AugAssign]:
    """The expressions of functions, and ``a += b``, without annotations, text and what is raised."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.JoinedStr | ast.Raise | ast.arg):
            continue
        if isinstance(node, ast.FunctionDef) and child is node.returns:
            continue
        if isinstance(child, ast.expr | ast.AugAssign):
            yield child
        yield from _arithmetic(child)


def mutants_of(file: str) -> list[Mutant]:
    """All mutants of a source file, named from the repository's root."""
    source = (ROOT / file).read_text(encoding="utf-8")
    lines, starts = source.splitlines(keepends=True), [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def offset(number: int, column: int) -> int:
        """Of a character; columns are counted in bytes."""
        return starts[number - 1] + len(lines[number - 1].encode()[:column].decode())

    results = []
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    for node in (node for function in functions for node in _arithmetic(function)):
        start = offset(node.lineno, node.col_offset)
        text = source[start : offset(node.end_lineno or 0, node.end_col_offset or 0)]
        results += [Mutant(file, node.lineno, kind, text, mutated, start) for kind, mutated in _changes(node)]
    return list({mutant.name: mutant for mutant in results}.values())


def own_tests(file: str) -> Path:
    """The file of tests that belongs to a module alone; it need not exist."""
    return Path("tests", file).with_name(f"test_{Path(file).stem.lstrip('_')}.py")


def sample(count: int, seed: int, only: str, alone: bool) -> list[Mutant]:
    """At most ``count`` mutants, the modules in turn, kinds of a module in turn; the same for the same seed.

    A module's mutants do not depend on other modules' sources. alone : of modules with
    a file of tests that has their name.
    """
    files = [path.relative_to(ROOT).as_posix() for package in PHYSICS for path in sorted((ROOT / package).glob("*.py"))]
    files = [file for file in files if not alone or (ROOT / own_tests(file)).exists()]
    random.Random(seed).shuffle(files)
    queues = []
    for file in files:
        left = mutants_of(file) if file.startswith(only) else []
        random.Random(f"{seed} {file}").shuffle(left)
        turn: dict[str, int] = {}
        rounds = []
        for mutant in left:
            turn[mutant.kind] = turn.get(mutant.kind, -1) + 1
            rounds.append((turn[mutant.kind], mutant))
        rounds.sort(key=lambda entry: entry[0])
        queues.append([mutant for _, mutant in rounds])
    mutants: list[Mutant] = []
    while len(mutants) < count and any(queues):
        queues = [queue for queue in queues if queue]
        mutants += [queue.pop(0) for queue in queues]
    return mutants[:count]


@cache
def tests_of(file: str) -> tuple[tuple[str, ...], ...]:
    """Files of tests in the order they run.

    The module's own; those of its package, first the ones that name it or what it defines; others that do; those of
    packages that use it.
    """
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    defined = [n.name for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef) and n.name[0] != "_"]
    stem, package = Path(file).stem.lstrip("_"), "tests" / Path(file).parent
    pattern = re.compile(rf"\b({'|'.join((stem, stem.replace('_', '-'), *defined))})\b")

    def mentions(path: Path) -> int:
        return len(pattern.findall((ROOT / path).read_text(encoding="utf-8")))

    tests = [path.relative_to(ROOT) for path in sorted((ROOT / "tests").glob("*/**/test_*.py"))]
    tests.sort(key=mentions, reverse=True)
    sources = [path.relative_to(ROOT) for room in ROOMS for path in (ROOT / room).glob("**/*.py")]
    users = {"tests" / path.parent for path in sources if mentions(path)}
    left = dict.fromkeys(tests)
    stages = []
    for belongs in (
        lambda path: path == own_tests(file),
        lambda path: path.parent == package and mentions(path) > 0,
        lambda path: path.parent == package,
        lambda path: mentions(path) > 0,
        lambda path: path.parent in users,
    ):
        stages.append(tuple(path.as_posix() for path in left if belongs(path)))
        left = {path: None for path in left if not belongs(path)}
    return tuple(stage for stage in stages if stage)


def verdict_of(mutant: Mutant, limit_s: float, alone: bool, unsound: dict[str, bool]) -> str:
    """``found by TEST``, ``ESCAPED`` or ``no answer in time``.

    limit_s : of processor time. alone : with the module's own tests only. unsound : of tests that failed before,
    whether they fail without a mutant, too; grows.
    """
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    mutated = source[: mutant.start] + mutant.mutated + source[mutant.start + len(mutant.text) :]
    room, _, rest = mutant.file.removesuffix(".py").partition("/")
    module = f"cboxlab.{ROOMS[room]}.{rest.replace('/', '.')}"
    left = limit_s
    try:
        for stage in tests_of(mutant.file)[: 1 if alone else None]:
            failure: str | None = ""
            while failure is not None:
                skipped = [test for test, fails in unsound.items() if fails]
                with exchanged(module, source, mutated):
                    failure, spent = run_here(stage, left, skipped)
                left -= spent
                if failure is not None and failure not in unsound:
                    unsound[failure] = run_here([failure], limit_s)[0] is not None
                if failure is not None and not unsound[failure]:
                    return f"found by {failure}"
    except OutOfTime:
        return "no answer in time"
    return "ESCAPED"


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--out", type=Path, required=True, help="file of results, one line of JSON each")
    options.add_argument("--count", type=int, default=200)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--only", default="", help="start of the files' paths")
    options.add_argument("--own", action="store_true", help="each module's own tests alone")
    options.add_argument("--limit", type=float, default=60.0, help="processor time of a mutant's tests in s")
    arguments = options.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    lines = arguments.out.read_text(encoding="utf-8").splitlines() if arguments.out.exists() else []
    results = {entry["name"]: entry["verdict"] for entry in map(json.loads, lines)}
    mutants = sample(arguments.count, arguments.seed, arguments.only, arguments.own)
    os.chdir(ROOT)
    unsound: dict[str, bool] = {}
    with arguments.out.open("a", encoding="utf-8", buffering=1) as file:
        for mutant in mutants:
            if mutant.name in results:
                continue
            entry = {"name": mutant.name, "verdict": "no answer in time", **asdict(mutant)}
            file.write(json.dumps(entry) + "\n")  # one that hangs in a kernel is not run again
            reason = EQUIVALENT.get((mutant.file, mutant.text))
            verdict = f"equivalent: {reason}" if reason else verdict_of(mutant, arguments.limit, arguments.own, unsound)
            results[mutant.name] = verdict
            file.write(json.dumps(entry | {"verdict": verdict}) + "\n")
    detected = [mutant for mutant in mutants if results[mutant.name].startswith("found")]
    equivalent = [mutant for mutant in mutants if results[mutant.name].startswith("equivalent")]
    for mutant in mutants:
        if mutant not in detected:
            location = f"{mutant.file}:{mutant.line}"
            print(f"{location:50s} {mutant.kind:18s} {results[mutant.name]}: {mutant.text} -> {mutant.mutated}")
    judged = len(mutants) - len(equivalent)
    print(f"{len(detected)} of {judged} found; {len(equivalent)} of {len(mutants)} change nothing")
    return 1 if judged - len(detected) > judged / 20 else 0


if __name__ == "__main__":
    sys.exit(main())
