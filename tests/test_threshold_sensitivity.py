"""The benchmark that moves constants: verdicts of a stub, an interrupted run, a module changed at import."""

import importlib
import json
import sys
from pathlib import Path

import pytest

benchmark = importlib.import_module("threshold_sensitivity")

GAIN = benchmark.DecisionConstant("validate/diagnose/evidence.py", 1, "GAIN", "1.0", "")
PIXELS = benchmark.DecisionConstant("calibration/quality/bands.py", 1, "PIXELS", "3", "")
GRID = benchmark.DecisionConstant("validate/diagnose/explain/field.py", 1, "GRID", "np.logspace(-8, 6, 57)", "")
PAIRS = benchmark.DecisionConstant("validate/compare_renders/regress/noise.py", 1, "PAIRS", "2.0", "")
CAPTURES = ["glare", "sound"]


class Stub:
    """Verdicts of a world in which glare is found up to a gain of 1.2, and the suspicion needs four pixels or fewer."""

    def __init__(self, broken_at=None):
        self.asked, self.broken_at = [], broken_at

    def __call__(self, moved, subjects):
        if moved.key == self.broken_at:
            raise KeyboardInterrupt
        self.asked.append((moved.key, tuple(subjects)))
        name = None if moved.constant is None else moved.constant.name
        selected = "adequate" if name == "GAIN" and moved.factor > 1.2 else "veiling-glare"
        first = "no suspicion" if name == "PIXELS" and moved.factor > 1 else "band: dim"
        results = {"glare": f"{first} | {selected}", "sound": "no suspicion | adequate"}
        return {s: results[s].split(" | ")[0] if name == "PIXELS" else results[s] for s in subjects}


def test_verdicts_that_change_are_listed(tmp_path):
    stub, lines = Stub(), []
    table = benchmark.measure([GAIN, PIXELS], CAPTURES, stub, tmp_path / "r.jsonl", lines.append)
    assert benchmark.changes(table, benchmark.Moved(GAIN, 0.7).key, CAPTURES) == {}
    assert benchmark.changes(table, benchmark.Moved(GAIN, 1.4).key, CAPTURES) == {
        "glare": ("band: dim | veiling-glare", "band: dim | adequate")
    }
    # a verdict of suspicions alone is compared with the suspicions of the complete one
    assert benchmark.changes(table, benchmark.Moved(PIXELS, 1.4).key, CAPTURES) == {
        "glare": ("band: dim", "no suspicion")
    }
    assert len(lines) == 5 and lines[2] == "[3/5] validate/diagnose/evidence:GAIN x 1.4: 1 of 2 verdicts change"
    page = benchmark.report([GAIN, PIXELS], table, CAPTURES)
    row = "| validate/diagnose/evidence:GAIN = 1.0 | 1.4 | glare | band: dim | veiling-glare | band: dim | adequate |"
    assert row in page and "0 constants change no verdict" in page


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path):
    results = tmp_path / "r.jsonl"
    first = Stub(broken_at=benchmark.Moved(GAIN, 1.4).key)
    with pytest.raises(KeyboardInterrupt):
        benchmark.measure([GAIN, PIXELS], CAPTURES, first, results, lambda line: None)
    assert [key for key, _ in first.asked] == ["baseline", "validate/diagnose/evidence:GAIN x 0.7"]
    second = Stub()
    resumed = benchmark.measure([GAIN, PIXELS], CAPTURES, second, results, lambda line: None)
    assert second.asked[0][0] == "validate/diagnose/evidence:GAIN x 1.4" and len(second.asked) == 3
    assert resumed == benchmark.measure([GAIN, PIXELS], CAPTURES, Stub(), tmp_path / "new.jsonl", lambda line: None)
    third = Stub()
    benchmark.measure([GAIN, PIXELS], CAPTURES, third, results, lambda line: None)
    assert third.asked == []


def test_constants_concern_the_subjects_that_they_decide(tmp_path):
    """A pair of cubes is judged for the constants of the regression alone; grids are not moved."""
    calls = []

    def verdicts(moved, subjects):
        calls.append((moved.key, tuple(subjects)))
        return dict.fromkeys(subjects, "same")

    subjects = ["glare", "a.npz=b.npz"]
    table = benchmark.measure([GAIN, PAIRS, GRID], subjects, verdicts, tmp_path / "r.jsonl", lambda line: None)
    assert calls == [
        ("baseline", tuple(subjects)),
        (f"{GAIN.key} x 0.7", ("glare",)),
        (f"{GAIN.key} x 1.4", ("glare",)),
        (f"{PAIRS.key} x 0.7", ("a.npz=b.npz",)),
        (f"{PAIRS.key} x 1.4", ("a.npz=b.npz",)),
    ]
    page = benchmark.report([GAIN, PAIRS, GRID], table, subjects)
    assert "2 constants change no verdict" in page and f"1 are no numbers and were not moved: {GRID.key}." in page


def test_a_subject_without_a_verdict_ends_the_run(tmp_path):
    def verdicts(moved, subjects):
        return dict.fromkeys(subjects, "error: no such folder")

    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"glare: error: no such folder"):
            benchmark.measure([GAIN], CAPTURES, verdicts, tmp_path / "r.jsonl", lambda line: None)


def test_a_failure_is_a_verdict(tmp_path, monkeypatch):
    """A process that ends with an error gives its last line; what it printed before counts."""
    script = tmp_path / "worker.py"
    script.write_text('print(\'{"glare": "adequate"}\', flush=True)\nraise ValueError("no light")', encoding="utf-8")
    monkeypatch.setattr(benchmark, "__file__", str(script))
    assert benchmark.in_processes(None)(benchmark.Moved(GAIN, 0.7), CAPTURES) == {
        "glare": "adequate",
        "sound": "error: ValueError: no light",
    }


@pytest.mark.parametrize(
    ("value", "factor", "expected"),
    [
        (2.0, 0.7, 1.4),
        (2.0, 1.4, 2.8),
        (-2.0, 1.4, -2.8),
        (0.5, 1.4, 0.7),
        (0.9, 1.4, 1 - 0.1 / 1.4),
        (3, 0.7, 2),
        (3, 1.4, 5),
        (1, 0.7, 1),
        (0, 0.7, 0),
    ],
)
def test_numbers_move_by_the_factor(value, factor, expected):
    assert benchmark.moved_number(value, factor) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("A = 2.0\nB = A", (2.8, 2.8)),
        ("A, B = 2.0, 3.0", (2.8, 3.0)),
        ("A: tuple = (1.0, 2)\nB = 0", ((1.4, 3), 0)),
        ("A = {1: 2.0}\nB = -1", ({1: 2.8}, -1)),
        ("B = 5.0\nA = -B\nA = 10.0", (14.0, 5.0)),
        ("A = 2 * 3.0\nB = 0", (8.4, 0)),
        ("A = (2 * 3.0, 1.0)\nB = 0", ((8.4, 1.4), 0)),
    ],
)
def test_a_constant_is_moved_in_the_source(source, expected):
    names = {}
    exec(compile(benchmark.moved_tree(source, "A", 1.4), "module", "exec"), names)
    assert names["A"] == pytest.approx(expected[0]) and names["B"] == expected[1]


def test_a_constant_that_is_not_there_is_refused():
    with pytest.raises(KeyError):
        benchmark.moved_tree("B = 1", "A", 1.4)


def test_modules_that_import_a_moved_constant_see_it_moved(tmp_path, monkeypatch):
    package = tmp_path / "moved_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "limits.py").write_text("LIMIT = 10.0\n_TWICE = 2 * LIMIT\n")
    (package / "user.py").write_text("from .limits import LIMIT, _TWICE\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    finder = benchmark.MovedFinder("moved_package.limits", "LIMIT", 0.7)
    monkeypatch.setattr(sys, "meta_path", [finder, *sys.meta_path])
    user = importlib.import_module("moved_package.user")
    assert (user.LIMIT, user._TWICE) == pytest.approx((7.0, 14.0))


def test_a_process_sees_the_constant_of_the_product_moved(tmp_path):
    """The real finder on a real module, in a process that only imports it."""
    constant = next(c for c in benchmark.decision_constants() if c.name == "INDISTINGUISHABLE_CHI2")
    script = (
        f"import sys; sys.path.insert(0, {str(Path(benchmark.__file__).parent)!r})\n"
        "import threshold_sensitivity as t\n"
        f"sys.meta_path.insert(0, t.MovedFinder({constant.module!r}, {constant.name!r}, 0.7))\n"
        "import json\n"
        "from cboxlab.validation.diagnose import evidence, several_captures\n"
        "print(json.dumps([evidence.INDISTINGUISHABLE_CHI2, several_captures.INDISTINGUISHABLE_CHI2]))\n"
    )
    run = benchmark.subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == pytest.approx([0.7 * 9.2] * 2)
