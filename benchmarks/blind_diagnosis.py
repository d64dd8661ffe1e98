"""Blind practice: captures with hidden effects drawn by chance, diagnosed, and scored.

Each capture has its own camera, lamp error, exposures and noise. Every ``--none-every``-th holds no effect, every
``--pair-every``-th two. Only effects that the simulated laboratory can photograph are drawn; those of light
transport (gloss, haze, fluorescence ...) share their formulas with the diagnosis, so a test on them would prove
nothing. The last line printed with --json is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from cboxlab.render.laboratory import CaptureSettings
from cboxlab.validate.blind import draw_effect
from cboxlab.validate.diagnosis import Diagnosis, diagnose
from cboxlab.validate.effects import AppliedEffect
from cboxlab.validate.model import Model, RenderSettings
from cboxlab.validate.pipeline import validate
from cboxlab.validate.synthetic import perturbed_camera, write_model_capture


def right(truth: AppliedEffect, diagnosis: Diagnosis) -> bool:
    """The first answer is the effect, or its group holds it; a named paint, surface or band must be right too."""
    if not diagnosis.selected or diagnosis.selected[0] == "unknown":
        return False
    names = {diagnosis.selected[0]}
    for group in diagnosis.indistinguishable:
        names |= set(group) if diagnosis.selected[0] in group else set()
    if truth.id not in names:
        return False
    answer = diagnosis.path[-1].effects[0]
    chosen = {k: v for k, v in truth.values.items() if isinstance(v, str)}
    return answer.id != truth.id or all(answer.values[k] == v for k, v in chosen.items())


def worst_parameter(truth: AppliedEffect, diagnosis: Diagnosis) -> float:
    """Largest of the parameters' errors, relative to the distance from null; NaN where the effect was not chosen."""
    for answer in diagnosis.path[-1].effects:
        if answer.id == truth.id:
            errors = []
            for p in truth.effect.numbers:
                null = p.null if p.null is not None and np.isfinite(p.null) else 0.0
                true, found = float(truth.values[p.name]), float(answer.values[p.name])
                if np.isfinite(true) and np.isfinite(found) and true != null:
                    errors.append(abs(found - true) / abs(true - null))
            return max(errors, default=float("nan"))
    return float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--none-every", type=int, default=4)
    parser.add_argument("--pair-every", type=int, default=6)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for index in range(options.captures):
        seed = options.first_seed + index
        generator = np.random.default_rng(seed)
        count = 0 if index % options.none_every == 0 else 2 if index % options.pair_every == 5 else 1
        effects: list[AppliedEffect] = []
        while len(effects) < count:
            drawn = draw_effect(generator)
            if drawn.id not in {e.id for e in effects}:
                effects.append(drawn)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "capture"
            model = Model(effects=tuple(effects), render=RenderSettings(seed=seed))
            camera = perturbed_camera(options.size, seed)
            write_model_capture(path, model, camera, CaptureSettings(), seed, relative_error=0.002)
            start = time.perf_counter()
            diagnosis = diagnose(validate(path, Model()))
            seconds = time.perf_counter() - start
        found = (
            [right(e, diagnosis) for e in effects]
            if count == 1
            else [e.id in diagnosis.selected for e in effects]
        )
        row = {
            "seed": seed,
            "truth": [(e.id, dict(e.values)) for e in effects],
            "selected": diagnosis.selected,
            "right": all(found) if effects else diagnosis.adequate,
            "top3": all(e.id in [r.effect for r in diagnosis.ranking[:3]] for e in effects),
            "probability": diagnosis.ranking[0].probability,
            "chi2_per_dof": diagnosis.chi2_per_dof,
            "final_chi2_per_dof": diagnosis.final_chi2_per_dof,
            "parameter_error": max((worst_parameter(e, diagnosis) for e in effects), default=float("nan")),
            "seconds": seconds,
        }
        rows.append(row)
        told = "; ".join(f"{e.id} {dict(e.values)}" for e in effects) or "none"
        print(
            f"{seed} {told} -> {', '.join(diagnosis.selected) or 'adequate'} {'right' if row['right'] else 'WRONG'} "
            f"chi2/dof {diagnosis.chi2_per_dof:.3f} -> {diagnosis.final_chi2_per_dof:.3f}, {seconds:.0f} s",
            flush=True,
        )
    kinds = {"none": 0, "singles": 1, "pairs": 2}
    summary = {
        name: float(np.mean([r["right"] for r in rows if len(r["truth"]) == count] or [np.nan]))
        for name, count in kinds.items()
    }
    visible = [r for r in rows if len(r["truth"]) == 1 and r["selected"]]
    summary["singles_answered_right"] = float(np.mean([r["right"] for r in visible] or [np.nan]))
    summary["top3"] = float(np.mean([r["top3"] for r in rows if r["truth"]] or [np.nan]))
    summary["median_seconds"] = float(np.median([r["seconds"] for r in rows]))
    print(f"right: {summary}")
    if options.json:
        print(json.dumps({"summary": summary, "captures": rows}, default=str))


if __name__ == "__main__":
    main()
