"""Every benchmark can be loaded: none imports what has moved. Hidden effects fit every box of the blind
practice, and answers are scored as its tables say."""

import ast
import importlib
import math
import re
import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest
from cboxlab.rendering.chain import Counts, over_field
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.synthetic import CaptureSettings, behind_mosaic, unit_factors
from cboxlab.scenes import cornell_camera
from cboxlab.scenes.scene_file import load_scene
from helpers.places import ROOT

BENCHMARKS = ROOT / "benchmarks"
FILES = sorted(BENCHMARKS.rglob("*.py"))
pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(BENCHMARKS).as_posix())
def test_benchmark_loads(path):
    with mi.scoped_set_variant(mi.variant()):  # some benchmarks choose another one
        assert importlib.import_module(path.stem).__file__ == str(path)


def test_index_names_every_benchmark():
    """Each file in the section of its folder, no file that is gone, and no two files of one name."""
    sections = re.split(r"^## .*`(\w+)/`$", (BENCHMARKS / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    mentioned = [
        f"{folder}/{name}"
        for folder, text in zip(sections[1::2], sections[2::2], strict=True)
        for name in sorted(set(re.findall(r"\b(\w+\.py)\b", text)))
    ]
    assert sorted(mentioned) == [path.relative_to(BENCHMARKS).as_posix() for path in FILES]
    assert len({path.stem for path in FILES}) == len(FILES)


def test_every_fault_can_be_planted():
    """Its text stands once in its file: else the benchmark ends there."""
    faults = importlib.import_module("planted_faults").FAULTS
    counts = {fault.name: (ROOT / fault.file).read_text(encoding="utf-8").count(fault.text) for fault in faults}
    assert len(counts) == len(faults) > 20
    assert set(counts.values()) == {1}, counts


def test_effects_outside_the_catalogue_act_in_every_box():
    """A paint of another colour, a cube on the floor: whatever stands in the room."""
    boxes, causes = (importlib.import_module(name) for name in ("blind_places", "outside_effects"))
    outside = (*causes.OUTSIDE.values(), *causes.KEPT_BACK.values())
    of_scenes = [effect for effect in outside if effect.stage == "scene"]
    assert len(of_scenes) == 3
    for box in boxes.BOXES:
        scene = load_scene(boxes.scene_of(box))
        for effect in of_scenes:
            for row in (0.0, 0.6, 1.0):
                changed = effect.apply(scene, amount=0.3, row=row, column=0.5)
                assert {s.material for s in changed.surfaces} <= set(changed.materials)
                assert [s.material for s in changed.all_surfaces] != [s.material for s in scene.all_surfaces]


def test_causes_of_colour_sensors():
    """A leak moves charge and loses none; other rows and columns change the scene alone; mixed dyes keep their sum."""
    causes = importlib.import_module("outside_effects").COLOUR_SENSOR
    draw, level, t = np.random.default_rng(3), np.full(2, 50.0), np.ones(2)
    frames = [50 + draw.uniform(100, 900, (2, 12, 12)) for _ in range(3)]
    before = Counts(("r", "g"), *frames, level, level, level, t, t, t, t, 4095.0)

    def after(name, row):
        return causes[name].apply(before, amount=0.01, row=row, column=0.5)

    rows, columns = after("sideways-leak", 1.0), after("sideways-leak", 0.0)
    np.testing.assert_allclose(rows.flat.sum(axis=2), before.flat.sum(axis=2))
    np.testing.assert_allclose(columns.scene.sum(axis=1), before.scene.sum(axis=1))
    assert not np.allclose(rows.reference, before.reference, rtol=1e-4)
    shares = (("other-rows", 1 / 2), ("column-pair", 2 / 12), ("one-place", 1 / 4), ("quarter", 1 / 4))
    for name, share in shares:
        changed = after(name, 1.0)
        assert changed.flat is before.flat
        assert np.mean(changed.scene != before.scene) == pytest.approx(share)
    black = after("black-level", 1.0)
    assert np.unique(np.round(black.flat - before.flat, 6)).tolist() == [0.0, 10.0]
    one_way = after("one-way-leak", 1.0).scene - before.scene
    signal = before.scene - 50
    np.testing.assert_allclose(one_way[:, :, :-1], 0.01 * (signal[:, :, 1:] - signal[:, :, :-1]))
    assert (after("bent-place", 1.0).reference <= before.reference).all()
    camera = cornell_camera(16)
    curves = over_field(unit_factors(behind_mosaic(CaptureSettings(), "RGGB"), 16), camera)
    mixed = causes["mixed-dyes"].apply(curves, amount=0.1, row=0.5, column=0.5)
    np.testing.assert_allclose(mixed.rest.sum(axis=0), curves.rest.sum(axis=0))
    deep = causes["deep-red"].apply(curves, amount=0.1, row=0.5, column=0.5).rest - curves.rest
    assert (deep >= 0).all()
    assert set(curves.wavelength_nm[np.argmax(deep, axis=1)]) <= set(np.arange(675.0, 700.0))


def test_blind_scores():
    """A group names each of its effects; an effect too many is not exact; the first answer has the probability."""
    scores = importlib.import_module("blind_scores")
    row = {"kind": "single", "strength": "weak", "truth": {"gloss": {}}, "groups": [], "probability": 0.8}
    group = [["haze", "gloss"]]
    alone, accompanied, grouped, wrong, missed = (
        row | {"selected": selected, "groups": groups, "first": (*selected, "unknown")[0]}
        for selected, groups in (
            (["gloss"], []),
            (["gloss", "haze"], []),
            (["haze"], group),
            (["haze"], []),
            ([], []),
        )
    )
    pair = row | {"kind": "pair", "truth": {"gloss": {}, "haze": {}}, "selected": ["gloss"]}
    rows = [alone, accompanied, grouped, wrong, missed, pair]
    assert [scores.is_right(r) for r in rows] == [True, True, True, False, False, False]
    assert [scores.exact(r) for r in rows] == [True, False, True, False, False, False]
    outside = row | {"kind": "outside", "truth": {"stain": {}}}
    assert scores.exact(outside | {"selected": ["unknown"]})
    assert not scores.exact(outside | {"selected": ["unknown", "haze"]})
    (table,) = scores.reliability([alone, accompanied, wrong])
    assert (table["stated"], table["right"], table["captures"]) == (pytest.approx(0.8), 2, 3)
    assert scores.log_loss([alone, wrong]) == pytest.approx(-(math.log(0.8) + math.log(0.2)) / 2)


def test_a_state_of_the_code_is_what_it_does(tmp_path):
    """Comments and docstrings may change; a number, and a text that is no docstring, may not."""
    code_state = importlib.import_module("blind_diagnosis").code_state
    module = tmp_path / "render" / "one.py"
    module.parent.mkdir()
    states = []
    for text in (
        '"""A."""\n\ndef f():\n    """B."""\n    return "c", 1\n',
        '"""D."""\n\n# E\ndef f():\n    """F."""\n    return "c", 1\n',
        '"""A."""\n\ndef f():\n    """B."""\n    return "c", 2\n',
        '"""A."""\n\ndef f():\n    """B."""\n    return "d", 1\n',
    ):
        module.write_text(text)
        states.append(code_state(tmp_path))
    assert states[0] == states[1]
    assert len(set(states)) == 3
    page_module = tmp_path / "validate" / "report" / "page.py"
    page_module.parent.mkdir(parents=True)
    page_module.write_text("width = 3\n")
    assert code_state(tmp_path) == states[-1]


def test_what_a_state_leaves_out_no_diagnosis_imports():
    listing = "import sys, blind_diagnosis as b; print(b.SHOWING); print([n for n in sys.modules if 'cboxlab.v' in n])"
    run = subprocess.run(
        [sys.executable, "-c", listing], cwd=BENCHMARKS / "diagnosis", capture_output=True, text=True, check=True
    )
    left_out, loaded = (ast.literal_eval(line) for line in run.stdout.splitlines())
    rooms = tuple(f"cboxlab.validation.{room.replace('/', '.')}." for room in left_out)
    assert not [name for name in loaded if f"{name}.".startswith(rooms)]
    assert all((ROOT / "validate" / room).is_dir() for room in left_out)


def test_cases_on_a_scheduler_have_the_rows_of_one_process(tmp_path, monkeypatch):
    """Of a benchmark's module that the worker imports; and None where a case cannot be made."""
    distributed = pytest.importorskip("distributed")
    source = """
from dataclasses import dataclass
@dataclass(frozen=True)
class Case:
    names: tuple[str, ...]
    seed: int
def run(case, factor):
    return None if case.seed == 2 else {"key": "+".join(case.names), "value": factor * case.seed}
"""
    (tmp_path / "three_cases.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    module, shared = (importlib.import_module(name) for name in ("three_cases", "shared_cases"))
    cases = [module.Case(("haze", "gloss"), seed) for seed in (1, 2, 3)]
    alone = list(shared.answers("three_cases", cases, module.run, (10,), None))
    local = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**local) as cluster:
        rows = list(shared.answers("three_cases", cases, module.run, (10,), cluster.scheduler_address))
    assert sorted(rows, key=lambda pair: pair[0].seed) == alone
    assert [row and row["value"] for _, row in alone] == [10, None, 30]
