"""Blind practice: captures with hidden effects, diagnosed and scored as a stranger would.

Four laboratories take turns, each with its own camera, detector, exposures and survey, and with blocks that stand a
little next to where they were surveyed; noise and effects are each capture's own. Kinds: every effect of the catalogue
by itself at every strength (chi2 per sample of 0.0024, 0.06, 1 and 8), pairs and triples of effects, nothing at all,
effects that the catalogue does not hold, and causes of ``made_causes``, scored by family and place (these in the
published box at 128 x 128). --boxes and --instruments take turns through those of ``blind_places``. Captures come in
an order by chance, so that a part of the set has all kinds. Finished ones are kept in --results (JSON lines), so that
an interrupted run goes on where it stopped, with the same code only; --part K/N does a share of the set, and
``blind_scores.py`` prints the tables of all parts. --scheduler ADDRESS shares the captures between Dask's workers. The
last line printed with --json is one JSON object.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from blind_places import BOXES, INSTRUMENTS, scene_of
from blind_scores import is_right, print_tables, summary
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.chain.stages import PHOTOGRAPHED, stages_between
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.integrators.precision import render_to_precision
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.scenes import load_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare.pipeline import validate_capture
from cboxlab.validation.diagnose.diagnosis import Diagnosis, diagnose_validation
from cboxlab.validation.synthetic.blind import draw_effect
from cboxlab.validation.synthetic.model_capture import (
    perturbed_camera,
    photograph_image,
    photographed_scene,
    write_model_capture,
)
from cboxlab.validation.synthetic.strengths import STRENGTHS, Scale, at_strength, scale_of
from cboxlab.validation.synthetic.varied import BlockOffset, block_offsets, varied_settings, with_block_offsets
from made_causes import CAUSES
from outside_effects import COLOUR_SENSOR, KEPT_BACK, OUTSIDE
from shared_cases import add_scheduler, answers
from unknown_causes import run as run_unknown

_DRAWS = 8

#: Causes that the catalogue does not hold, by name.
_CAUSES = OUTSIDE | KEPT_BACK | COLOUR_SENSOR

#: Cameras, detectors, surveys and boxes that captures share in turn; noise and effects are each capture's own.
_LABORATORIES = 4

#: Relative error of the pictures that are photographed, median over pixels.
_PICTURE_ERROR = 0.002

_AFTER_THE_PICTURE = stages_between("filter", "counts")

#: Rooms of ``validate`` that no diagnosis imports: they show what it found.
SHOWING = ("api", "app", "compare_renders/renderers", "compare_renders/stored_references", "report", "study")

#: What may begin with a docstring.
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)

#: Largest error of a fitted number that counts as right, as a part of its distance from null.
_CLOSE = 0.15
#: Largest error of a fitted number that counts as right, in standard deviations, where that is larger.
_SIGMAS = 2.0


@dataclass(frozen=True)
class Case:
    """One capture. kind : single, pair, triple, none, outside or unknown. names : what is in it.

    strength : one of STRENGTHS, empty for a kind without.
    """

    kind: str
    names: tuple[str, ...]
    strength: str
    seed: int
    box: str = "published"
    instrument: str = "plain"

    @property
    def laboratory(self) -> int:
        """Seeds camera, detector, exposures, survey and where the blocks stand; one for a box and instrument."""
        return 7000 + ([*BOXES].index(self.box) + [*INSTRUMENTS].index(self.instrument)) % _LABORATORIES

    @property
    def key(self) -> str:
        """Names the capture in the results."""
        return f"{self.kind}:{'+'.join(self.names)}:{self.strength}:{self.seed}:{self.box}:{self.instrument}"


def cases(options: argparse.Namespace) -> list[Case]:
    """The whole set in an order by chance, the same for the same options."""
    names = options.effects.split(",") if options.effects else [*catalogue()]
    strengths = options.strengths.split(",")
    results = []
    for name, strength, _ in product(names, strengths, range(options.seeds)):
        results.append(Case("single", (name,), strength, options.first_seed + len(results)))
    generator = np.random.default_rng(options.first_seed)
    able = [name for name in names if catalogue()[name].stage != "settings"]
    for kind, count, number, first in (
        ("pair", options.pairs, 2, 1000),
        ("triple", options.triples, 3, 4000),
    ):
        for index in range(count):
            several = tuple(str(name) for name in generator.choice(able, number, replace=False))
            results.append(Case(kind, several, "medium", options.first_seed + first + index))
    results += [Case("none", (), "", options.first_seed + 2000 + index) for index in range(options.nones)]
    outside = COLOUR_SENSOR if options.colour_sensor else OUTSIDE
    for index in range(options.outside):
        name = [*outside][index % len(outside)]
        strength = ("medium", "strong")[(index // len(outside)) % 2]
        results.append(Case("outside", (name,), strength, options.first_seed + 3000 + index))
    laboratories = [*product(options.boxes.split(","), options.instruments.split(","))]
    turns = np.random.default_rng(options.first_seed + 1).permutation(len(laboratories))
    results = [
        replace(case, box=laboratories[turns[i % len(turns)]][0], instrument=laboratories[turns[i % len(turns)]][1])
        for i, case in enumerate(results)
    ]
    for index in range(options.unknown):
        results.append(Case("unknown", ([*CAUSES][index % len(CAUSES)],), "", options.first_seed + 5000 + index))
    return [results[i] for i in generator.permutation(len(results))]


def own_part(case: Case, part: str) -> bool:
    """Whether a capture belongs to part "K/N": a box and instrument stay in one, which renders them once."""
    number, parts = (int(n) for n in part.split("/"))
    source = f"{case.box} {case.instrument} {case.names if case.kind == 'unknown' else ''}"
    return int(hashlib.sha256(source.encode()).hexdigest(), 16) % parts == number - 1


def code_state(root: Path = Path(__file__).parents[2]) -> str:
    """A hash of the source that a diagnosis runs, comments and docstrings left out."""
    rooms = ("scenes", "calibration", "render", "validate")
    digest = hashlib.sha256()
    for path in sorted(path for room in rooms for path in (root / room).rglob("*.py")):
        if not any(path.is_relative_to(root / "validate" / room) for room in SHOWING):
            for node in ast.walk(tree := ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
                    del node.body[0]
            digest.update(f"{path.relative_to(root)} {ast.dump(tree)}".encode())
    return digest.hexdigest()[:12]


def random_effect(
    name: str,
    strength: str,
    generator: np.random.Generator,
    scale: Scale,
    scene: Scene,
    bands: tuple[str, ...],
) -> AppliedEffect | None:
    """An effect with numbers by chance, as strong as asked for; None where it cannot be."""
    for _ in range(_DRAWS):
        if name in _CAUSES:
            position = {"row": float(generator.uniform()), "column": float(generator.uniform())}
            trial = AppliedEffect(_CAUSES[name], {"amount": 0.01, **position})
        else:
            try:
                trial = draw_effect(generator, scene, bands, (name,))
            except InputError:  # on a block, in a box without any
                return None
        scaled = at_strength(trial, STRENGTHS[strength], scale)
        if scaled is not None:
            return scaled
    return None


@dataclass(frozen=True)
class Laboratory:
    """A box, a camera, and the rest of the laboratory."""

    model: Model
    scene: Scene
    camera: Camera
    settings: CaptureSettings


@cache
def laboratory(seed: int, box: str, instrument: str) -> Laboratory:
    """Repeatable by ``seed``. box, instrument : of ``blind_places``."""
    size, changed = INSTRUMENTS[instrument]
    model = Model(load_scene(scene_of(box)))
    camera, settings = perturbed_camera(size, seed), changed(varied_settings(seed))
    return Laboratory(model, photographed_scene(model), camera, settings)


@cache
def strengths(seed: int, box: str, instrument: str) -> Scale:
    """How strong effects are in a laboratory."""
    site = laboratory(seed, box, instrument)
    return scale_of(site.model, site.camera, site.settings, seed)


@cache
def picture(seed: int, box: str, instrument: str, max_bounces: int | None) -> RenderedImage:
    """What a laboratory photographs when its box holds no effect."""
    site = laboratory(seed, box, instrument)
    pilot = RenderJob(
        with_block_offsets(site.scene, seed), site.camera, WAVELENGTH_NM, seed=seed, max_bounces=max_bounces
    )
    return render_to_precision(pilot, _PICTURE_ERROR)


def write_capture(path: Path, case: Case, effects: Sequence[AppliedEffect], max_bounces: int | None = None) -> None:
    """Photograph a case's box, its laboratory and noise, with these effects in it."""
    where = (case.laboratory, case.box, case.instrument)
    site = laboratory(*where)
    inside = tuple(e for e in effects if e.stage in PHOTOGRAPHED)
    if all(e.stage in _AFTER_THE_PICTURE for e in inside):
        image, box = picture(*where, max_bounces), with_block_offsets(site.scene, case.laboratory)
        photograph_image(path, image, inside, box, site.scene, site.camera, settings=site.settings, seed=case.seed)
        return
    model = replace(site.model, effects=inside, render=RenderSettings(seed=case.seed))
    write_model_capture(
        path,
        model,
        site.camera,
        site.settings,
        case.seed,
        relative_error=_PICTURE_ERROR,
        box=lambda scene: with_block_offsets(scene, case.laboratory),
    )


def run(case: Case) -> dict[str, Any] | None:
    """Make one capture, diagnose it, and score the answer; None where the effect cannot be so strong."""
    if case.kind == "unknown":
        row = run_unknown(case.names[0], case.seed, None)
        record = {"key": case.key, "kind": "unknown", "box": case.box, "instrument": case.instrument}
        return {**row, **record, "strength": "", "truth": {case.names[0]: {}}, "family_true": row["truth"]}
    generator = np.random.default_rng([case.seed, len(case.key)])
    site = laboratory(case.laboratory, case.box, case.instrument)
    bands = site.settings.band_ids
    model, effects, bounces = site.model, [], None
    truncating = [catalogue()[n] for n in case.names if n in catalogue() and catalogue()[n].stage == "settings"]
    if truncating:
        model = replace(model, render=RenderSettings(max_bounces=int(generator.integers(1, 4))))
        effects = [AppliedEffect(truncating[0], {p.name: np.inf for p in truncating[0].parameters})]
        bounces = effects[0].apply(model.render).max_bounces
    elif case.names:
        scale = strengths(case.laboratory, case.box, case.instrument)
        for name in case.names:
            effect = random_effect(name, case.strength, generator, scale, site.scene, bands)
            if effect is None:
                return None
            effects.append(effect)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture"
        write_capture(path, case, effects, bounces)
        start, cpu = time.perf_counter(), time.process_time()
        diagnosis = diagnose_validation(validate_capture(load_capture(path), model))
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    offsets = block_offsets(site.scene, case.laboratory)
    return {
        "key": case.key,
        "kind": case.kind,
        "box": case.box,
        "instrument": case.instrument,
        "strength": case.strength,
        "truth": {e.id: dict(e.values) for e in effects},
        "selected": list(diagnosis.selected),
        "groups": [list(g) for g in diagnosis.indistinguishable],
        "first": diagnosis.ranking[0].effect,
        "first_three": [r.effect for r in diagnosis.ranking[:3]],
        "tried": [(r.effect, dict(r.values), dict(r.sigma)) for r in diagnosis.ranking[:6]],
        "certainty": diagnosis.certainty,
        "probability": diagnosis.ranking[0].probability,
        "best_gain": diagnosis.chi2_per_dof - min(r.chi2_per_dof for r in diagnosis.ranking),
        "fitted": {e.id: dict(e.values) for e in diagnosis.path[-1].effects},
        "parameters_right": _parameters_right(effects, diagnosis, offsets),
        "settled_block": _is_settled_block(diagnosis, offsets),
        "chi2_per_dof": diagnosis.chi2_per_dof,
        "final_chi2_per_dof": diagnosis.final_chi2_per_dof,
        "seconds": seconds,
        "cpu_seconds": cpu,
    }


def _parameters_right(
    effects: Sequence[AppliedEffect], diagnosis: Diagnosis, offsets: Mapping[str, BlockOffset]
) -> list[bool]:
    """For every number of an effect that was found, whether it is close to the truth or within its stated error.

    A block that was moved stands where it had with_block_offsets, and as much further as it was moved.
    """
    last, right = diagnosis.path[-1], []
    for truth in effects:
        for answer, sigma in zip(last.effects, last.sigma, strict=True):
            if answer.id != truth.id or truth.id not in catalogue():
                continue
            for p in truth.effect.numbers:
                offset = getattr(offsets.get(str(truth.values.get("block"))), p.name, 0.0)
                true, estimate = float(truth.values[p.name]) + offset, float(answer.values[p.name])
                if not (np.isfinite(true) and np.isfinite(estimate)):
                    continue
                null = p.null if p.null is not None and np.isfinite(p.null) else 0.0
                allowed = max(_CLOSE * abs(true - null), _SIGMAS * sigma.get(p.name, 0.0))
                right.append(bool(abs(estimate - true) <= allowed))
    return right


def _is_settled_block(diagnosis: Diagnosis, offsets: Mapping[str, BlockOffset]) -> bool:
    """Whether all that was found is a block where the laboratory's really stands, a little next to its survey."""
    last = diagnosis.path[-1]
    off = [
        abs(float(effect.values[name]) - getattr(offsets.get(str(effect.values["block"])), name, np.inf)) / sigma[name]
        for effect, sigma in zip(last.effects, last.sigma, strict=True)
        if effect.id == "block-pose"
        for name in sigma
    ]
    return list(diagnosis.selected) == ["block-pose"] and max(off) <= _SIGMAS


def among(names: Sequence[str]) -> Callable[[str], str]:
    """Reads names separated by commas."""

    def read(text: str) -> str:
        if wrong := [name for name in text.split(",") if name not in names]:
            raise argparse.ArgumentTypeError(f"{', '.join(wrong)}: not one of {', '.join(names)}")
        return text

    return read


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effects", type=among([*catalogue()]), help="identifiers, comma separated; all if none")
    parser.add_argument("--strengths", type=among([*STRENGTHS]), default=",".join(STRENGTHS))
    parser.add_argument("--seeds", type=int, default=1, help="captures of each effect and strength")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--triples", type=int, default=10)
    parser.add_argument("--nones", type=int, default=10)
    parser.add_argument("--outside", type=int, default=12)
    parser.add_argument(
        "--colour-sensor", action="store_true", help="causes of colour sensors as those outside the catalogue"
    )
    parser.add_argument("--unknown", type=int, default=17, help="captures with a cause of made_causes")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--boxes", type=among([*BOXES]), default="published", help=f"of {', '.join(BOXES)}")
    parser.add_argument(
        "--instruments", type=among([*INSTRUMENTS]), default="plain", help=f"of {', '.join(INSTRUMENTS)}"
    )
    parser.add_argument("--part", default="1/1")
    parser.add_argument("--results", type=Path, default=Path("blind-results.jsonl"))
    parser.add_argument("--json", action="store_true")
    add_scheduler(parser)
    options = parser.parse_args()
    try:
        every = cases(options)
    except ValueError:
        parser.error("a triple takes three effects, a pair two: name more, or ask for none of them")
    lines_before = options.results.read_text().splitlines() if options.results.exists() else []
    rows = [json.loads(line) for line in lines_before]
    done = {row["key"] for row in rows}
    code = code_state()
    if others := {row.get("code", "unstated") for row in rows} - {code}:
        sys.exit(f"{options.results}: made by other code ({', '.join(others)}, not {code}); name another --results")
    pending = [case for case in every if case.key not in done and own_part(case, options.part)]
    for case, row in answers("blind_diagnosis", pending, run, (), options.scheduler):
        if row is None:
            print(f"{case.key}: cannot be so strong, left out", flush=True)
            continue
        row["code"] = code
        rows.append(row)
        with options.results.open("a") as lines:
            lines.write(json.dumps(row, default=str) + "\n")
        print(
            f"{case.key} -> {', '.join(row['selected']) or 'adequate'} {'right' if is_right(row) else 'WRONG'} "
            f"chi2 {row['chi2_per_dof']:.3f}, {row['seconds']:.0f} s",
            flush=True,
        )
    if rows:
        print_tables(rows)
    if options.json:
        print(json.dumps({"summary": summary(rows) if rows else {}, "captures": rows}, default=str))


if __name__ == "__main__":
    main()
