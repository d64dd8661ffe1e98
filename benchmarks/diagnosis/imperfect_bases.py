"""Blind practice on boxes that are a little off: what is named next to a flaw of the base, and what is not.

Every capture has a flaw of ``flawed_bases`` (chi2 per sample of 0.05 to 0.5 above noise) and holds nothing else, one
effect of the catalogue, two, or a weak cause that the catalogue lacks. --kept-back takes the flaws and the weak causes
that no decision constant was set with, in place of the others. Finished captures are kept in --results (JSON lines), so
that an interrupted run continues; --score prints the tables of such files and runs nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from blind_diagnosis import random_effect
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import RenderSettings, over_field, scene_light
from cboxlab.rendering.effects import AppliedEffect, Effect, catalogue
from cboxlab.rendering.image import RenderedImage, RenderJob
from cboxlab.rendering.integrators import render_to_precision
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import unit_factors
from cboxlab.scenes import load_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose import Diagnosis, diagnose_validation
from cboxlab.validation.synthetic import perturbed_camera, photographed_scene
from cboxlab.validation.synthetic.model_capture import photograph_image, write_model_capture
from cboxlab.validation.synthetic.strengths import STRENGTHS, Scale, scale_of
from cboxlab.validation.synthetic.varied import varied_settings
from flawed_bases import FLAWS, KEPT_BACK, Picture
from numpy.typing import NDArray
from outside_effects import KEPT_BACK as KEPT_BACK_OUTSIDE
from outside_effects import OUTSIDE
from shared_cases import add_scheduler, answers

#: Chi2 per sample by a flaw over shot and read noise alone, the smallest and the largest: about 0.05 and 0.5 of all
#: that a diagnosis counts.
_LEAST, _MOST = 0.12, 1.2

#: Largest factor by which a flaw changes a pixel at full size.
_LARGEST_FACTOR = 2.0

#: Relative error of the rendered pictures, median over pixels.
_PICTURE_ERROR = 0.002

#: Chi2 per sample of a weak cause that no effect fits.
_WEAK = 0.1

#: A number is right within this number of its standard deviations; a stated one never counts as smaller than this part.
_SIGMAS, _LEAST_SIGMA = 2.5, 0.01

#: Flaws that an effect of the catalogue describes, too.
_DESCRIBES = {"leaning-blocks": {"block-pose"}, "sizes": {"block-pose"}, "astigmatism": {"defocus", "crosstalk"}}

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One capture. kind : none, single, pair or weak. names : what it holds. flaw : of ``FLAWS``."""

    kind: str
    names: tuple[str, ...]
    flaw: str
    seed: int

    @property
    def key(self) -> str:
        return f"{self.kind}:{'+'.join(self.names)}:{self.flaw}:{self.seed}"

    @classmethod
    def of_key(cls, key: str) -> Case:
        kind, names, flaw, seed = key.split(":")
        return cls(kind, tuple(name for name in names.split("+") if name), flaw, int(seed))


def cases(options: argparse.Namespace) -> list[Case]:
    """The set in an order by chance, flaws taking turns; or the cases that are named."""
    if options.cases:
        return [Case.of_key(key) for key in options.cases.read_text().split()]
    flaws = [f for f in FLAWS if f != "none" and (f in KEPT_BACK) == options.kept_back]
    flaws = options.flaws.split(",") if options.flaws else flaws
    able = [name for name, effect in catalogue().items() if effect.stage != "settings"]
    draw = np.random.default_rng(options.first_seed)
    cases_drawn: list[tuple[str, tuple[str, ...]]] = [("none", ())] * options.nones
    cases_drawn += [("single", (name,)) for name in draw.permutation(able)[: options.singles]]
    cases_drawn += [("pair", tuple(map(str, draw.choice(able, 2, replace=False)))) for _ in range(options.pairs)]
    outside = [*(KEPT_BACK_OUTSIDE if options.kept_back else OUTSIDE)]
    cases_drawn += [("weak", (outside[i % len(outside)],)) for i in range(options.weak)]
    turns = [(kind, names, flaws[i % len(flaws)]) for i, (kind, names) in enumerate(cases_drawn)]
    several = [Case(*turn, options.first_seed + i) for i, turn in enumerate(turns)]
    return [several[i] for i in draw.permutation(len(several))]


MODEL = Model(load_scene("cornell-box"))
SCENE = photographed_scene(MODEL)


@cache
def laboratory_of(seed: int, size: int) -> tuple[Camera, Any]:
    return perturbed_camera(size, seed), varied_settings(seed)


@cache
def _strengths(seed: int, size: int) -> Scale:
    camera, settings = laboratory_of(seed, size)
    return scale_of(MODEL, camera, settings, seed)


def _relative_strength(laboratory: int, size: int, unit: float, effect: AppliedEffect) -> float:
    return _strengths(laboratory, size)(effect) / unit


@cache
def image_of(flaw: str, seed: int, laboratory: int, size: int, bounces: int | None = None) -> RenderedImage:
    """What is photographed of a box with a flaw and no effect."""
    camera, _ = laboratory_of(laboratory, size)
    change = FLAWS[flaw].scene
    scene = SCENE if change is None else change(np.random.default_rng(seed), SCENE)
    return render_to_precision(
        RenderJob(scene, camera, WAVELENGTH_NM, seed=laboratory + 1, max_bounces=bounces),
        _PICTURE_ERROR,
    )


def _signal(image: RenderedImage, laboratory: int, size: int) -> NDArray[np.float64]:
    camera, settings = laboratory_of(laboratory, size)
    curves = over_field(unit_factors(settings, camera.width_px, grid=FILTER_GRID), camera)
    return np.asarray(scene_light(image, curves, camera).signal)


def _excess(signal: NDArray, other: NDArray, laboratory: int, size: int, lamp: NDArray) -> float:
    """Chi2 per sample by which two pictures differ, the lamp's power free."""
    _, settings = laboratory_of(laboratory, size)
    full = settings.level * settings.full_scale_dn * settings.gain_e_per_dn
    used = np.broadcast_to(~lamp, signal.shape)
    level = np.percentile(signal[:, ~lamp], 99.5, axis=1)[:, None, None]
    electrons, changed = (full * picture / level for picture in (signal, other))
    sigma = np.sqrt((electrons + settings.read_noise_e**2) / settings.repeats)
    a, b = (electrons / sigma)[used], (changed / sigma)[used]
    return float(np.mean((b - a * (a @ b) / (a @ a)) ** 2))


@cache
def flaw_of(
    name: str, laboratory: int, size: int, seed: int, limits: tuple[float, float] = (_LEAST, _MOST)
) -> tuple[AppliedEffect | None, float]:
    """A flaw of a size between the limits, as an effect on light, and its chi2 per sample over shot and read noise."""
    if name == "none":
        return None, 0.0
    draw, flaw = np.random.default_rng(seed), FLAWS[name]
    sound = image_of("none", 0, laboratory, size)
    signal = _signal(sound, laboratory, size)
    if flaw.light is not None:
        direct = _signal(image_of("none", 0, laboratory, size, 1), laboratory, size)
        factor = flaw.light(draw, Picture(signal, direct, *_reflectance(sound), sound))
    else:
        changed = _signal(image_of(name, seed, laboratory, size), laboratory, size)
        factor = np.divide(changed, signal, out=np.ones_like(signal), where=signal > 0)
    factor = np.clip(factor, 1 / _LARGEST_FACTOR, _LARGEST_FACTOR)
    excess = _excess(signal, factor * signal, laboratory, size, sound.sees_lamp)
    target = excess if flaw.as_drawn else float(np.exp(draw.uniform(*np.log(limits))))
    factor = 1 + np.sqrt(target / excess) * (factor - 1)
    effect = Effect("flaw", "optics", "a flaw", (), lambda light: light.with_signal(light.signal * factor), "none")
    return AppliedEffect(effect, {}), target


def _reflectance(image: RenderedImage) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(band, y, x) reflectance of what pixels show, and (y, x) whether they show walls alone."""
    nm = np.array([curve.wavelength_nm[np.argmax(curve.values)] for curve in varied_settings(0).filters.values()])
    values = {s.name: SCENE.materials[s.material].reflectance.at(nm) for s in SCENE.surfaces}
    names = image.surface_names
    of_face = np.array([values[names[i]] if i < len(names) else np.zeros(len(nm)) for i in image.facet_surface])
    walls = np.array([i < len(names) and "block" not in names[i] for i in image.facet_surface])
    return np.einsum("yxf,fb->byx", image.coverage, of_face), (image.coverage @ walls) > 0.999


def run(case: Case, size: int, laboratories: int, draws: int) -> Row | None:
    """Make one capture, diagnose it, and note the answer; None where the effect cannot be so strong."""
    laboratory = 8800 + case.seed % laboratories
    camera, settings = laboratory_of(laboratory, size)
    flaw, excess = flaw_of(case.flaw, laboratory, size, 100 + case.seed % draws)
    draw, effects = np.random.default_rng([case.seed, 7]), []
    strength = _WEAK if case.kind == "weak" else STRENGTHS["medium"]
    for name in case.names:
        scale = partial(_relative_strength, laboratory, size, strength / STRENGTHS["medium"])
        effect = random_effect(name, "medium", draw, scale, SCENE, tuple(settings.filters))
        if effect is None:
            return None
        effects.append(effect)
    inside = (*((flaw,) if flaw else ()), *effects)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture"
        if all(e.stage in ("optics", "filter", "counts") for e in inside):
            image = image_of("none", 0, laboratory, size)
            photograph_image(path, image, inside, SCENE, SCENE, camera, settings=settings, seed=case.seed)
        else:
            model = replace(MODEL, effects=inside, render=RenderSettings(seed=case.seed))
            write_model_capture(path, model, camera, settings, case.seed, relative_error=_PICTURE_ERROR)
        cpu = time.process_time()
        diagnosis = diagnose_validation(validate_capture(load_capture(path), MODEL))
    return {**_row(case, effects, diagnosis), "flaw_chi2": excess, "cpu_seconds": time.process_time() - cpu}


def _row(case: Case, effects: Sequence[AppliedEffect], diagnosis: Diagnosis) -> Row:
    last, explanation = diagnosis.path[-1], diagnosis.explanation
    return {
        "key": case.key,
        "kind": case.kind,
        "flaw": case.flaw,
        "truth": {e.id: dict(e.values) for e in effects},
        "selected": list(diagnosis.selected),
        "groups": [list(g) for g in diagnosis.indistinguishable],
        "ranking": [(r.effect, dict(r.values), dict(r.sigma), r.probability) for r in diagnosis.ranking[:4]],
        "fitted": {e.id: dict(e.values) for e in last.effects},
        "sigma": {e.id: dict(s) for e, s in zip(last.effects, last.sigma, strict=True)},
        "chi2": diagnosis.chi2_per_dof,
        "final_chi2": diagnosis.final_chi2_per_dof,
        "family": None if explanation is None else [explanation.family, explanation.share, explanation.heldout],
        "told_apart": None if explanation is None else explanation.told_apart,
        "flaws": {f.kind: f.chi2_per_dof for f in diagnosis.flaws},
    }


def is_right(row: Row) -> bool:
    """Whether all effects of a capture are selected, each or in a group with what cannot be distinguished."""
    groups = [set(group) for group in row["groups"]]
    return all(
        name in row["selected"] or any(name in g and g & set(row["selected"]) for g in groups) for name in row["truth"]
    )


def false_names(row: Row) -> set[str]:
    """Effects that are selected and neither hidden, nor in a group with a hidden one, nor another name of the flaw."""
    hidden = set(row["truth"])
    false = set(row["selected"]) - hidden - {"unknown"} - _DESCRIBES.get(row["flaw"], set())
    return {name for name in false if not any(name in g and hidden & set(g) for g in row["groups"])}


def numbers_right(row: Row) -> list[bool]:
    """For each fitted number of a hidden effect, whether it is within its stated error."""
    right = []
    for name, truth in row["truth"].items():
        for p in catalogue()[name].numbers if name in catalogue() else ():
            estimate = row["fitted"].get(name, {}).get(p.name)
            if estimate is None or not np.isfinite(estimate) or not np.isfinite(truth[p.name]):
                continue
            null = p.null if p.null is not None and np.isfinite(p.null) else 0.0
            sigma = max(row["sigma"][name].get(p.name, 0.0), _LEAST_SIGMA * abs(truth[p.name] - null))
            right.append(bool(abs(estimate - truth[p.name]) <= _SIGMAS * sigma))
    return right


def tables(rows: Sequence[Row]) -> list[str]:
    """Scores by kind and by flaw, and what is wrong."""
    lines = []
    for kind in ("single", "pair"):
        of = [r for r in rows if r["kind"] == kind]
        right = [b for r in of for b in numbers_right(r)]
        lines.append(
            f"{kind}: named {sum(map(is_right, of))} of {len(of)}, "
            f"with a false name {sum(map(bool, map(false_names, of)))}, "
            f"numbers within {_SIGMAS} standard deviations {sum(right)} of {len(right)}"
        )
    sound = [r for r in rows if r["kind"] == "none"]
    lines.append(
        f"sound: named {sum(bool(false_names(r)) for r in sound)} of {len(sound)}, unknown "
        f"{sum('unknown' in r['selected'] for r in sound)}, flaw described {sum(bool(r['flaws']) for r in sound)}"
    )
    weak = [r for r in rows if r["kind"] == "weak"]
    sure = [r for r in weak if r["ranking"][0][0] != "unknown" and r["ranking"][0][3] >= 0.9 and r["selected"]]
    lines.append(f"weak causes outside the catalogue: an effect at 0.9 or more {len(sure)} of {len(weak)}")
    for row in rows:
        wrong = not is_right(row) or false_names(row) or (row["kind"] == "none" and "unknown" in row["selected"])
        if (wrong and row["kind"] != "weak") or row in sure or not all(numbers_right(row)):
            first = row["ranking"][0]
            lines.append(
                f"{row['key']} {row['truth']} -> {row['selected']} {row['fitted']} {row['sigma']} "
                f"chi2 {row['chi2']:.3f} {row['final_chi2']:.3f} flaw {row['flaw_chi2']:.3f} "
                f"first {first[0]} {first[3]:.3f} {row['family']}"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("imperfect.jsonl"))
    parser.add_argument("--size", type=int, default=56)
    parser.add_argument("--first-seed", type=int, default=500)
    for kind, count in (("nones", 12), ("singles", 30), ("pairs", 12), ("weak", 10)):
        parser.add_argument(f"--{kind}", type=int, default=count)
    parser.add_argument("--flaws", default="")
    parser.add_argument("--laboratories", type=int, default=2)
    parser.add_argument("--draws", type=int, default=4, help="pictures of each flaw; few are faster")
    parser.add_argument("--cases", type=Path, help="file of cases by key, as in --results, in place of a draw")
    parser.add_argument("--kept-back", action="store_true")
    parser.add_argument("--score", action="store_true")
    add_scheduler(parser)
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.results.read_text().splitlines()] if options.results.exists() else []
    finished = {row["key"] for row in rows}
    pending = [] if options.score else [case for case in cases(options) if case.key not in finished]
    arguments = options.size, options.laboratories, options.draws
    for _, row in answers("imperfect_bases", pending, run, arguments, options.scheduler):
        if row is not None:
            rows.append(row)
            with options.results.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(row["key"], row["selected"], f"chi2 {row['chi2']:.3f} {row['final_chi2']:.3f}", flush=True)
    print("\n".join(tables(rows)))


if __name__ == "__main__":
    main()
