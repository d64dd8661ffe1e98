"""Causes that no catalogue holds, explained: family, surface, place, bands and share, scored as by a stranger.

The causes are those of ``made_causes``; laboratories take turns. Finished captures are kept in --results (JSON lines),
so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.integrators import RenderJob, render_to_precision
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings, behind_mosaic, write_photographs
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose import diagnose_validation
from cboxlab.validation.synthetic.model_capture import (
    perturbed_camera,
    photographed_light,
    photographed_scene,
)
from cboxlab.validation.synthetic.varied import varied_settings, with_block_offsets
from made_causes import CAUSES, SIZE_PX, Made, Stack, Truth

#: Relative error of a picture, and of one that adds a tenth of itself or less.
_PICTURE_ERROR, _ADDED_ERROR = 0.002, 0.02
_LABORATORIES = 2

#: A place is right within this part of the picture's width.
_PLACE = 0.1


@cache
def laboratory(seed: int, mosaic: str = "") -> tuple[Camera, CaptureSettings, Scene]:
    """A camera, the rest of a laboratory, and its box.

    mosaic : pattern of a colour sensor, empty for the seven filters.
    """
    settings = behind_mosaic(varied_settings(seed), mosaic) if mosaic else varied_settings(seed)
    return perturbed_camera(SIZE_PX, seed), settings, with_block_offsets(photographed_scene(Model()), seed)


def _image(scene: Scene, camera: Camera, seed: int, error: float = _PICTURE_ERROR) -> RenderedImage:
    return render_to_precision(RenderJob(scene, camera, WAVELENGTH_NM, seed=seed), error)


@cache
def _sound(number: int, seed: int) -> RenderedImage:
    camera, _, box = laboratory(number)
    return _image(box, camera, seed)


def write_capture(folder: Path, name: str, seed: int, frames_before: int = 0, mosaic: str = "") -> Truth:
    """One capture with a cause; ``none`` leaves the box sound.

    taken : how often it was taken before: the same box, camera and cause, but other noise in picture and frames.
    mosaic : pattern of a colour sensor, empty for the seven filters.
    """
    first_seed = 9000 + seed % _LABORATORIES
    camera, settings, box = laboratory(first_seed, mosaic)
    draw = np.random.default_rng([seed, len(name)])
    noise = seed + 5000 * frames_before
    cause = Made(Truth("none")) if name == "none" else CAUSES[name](draw, box, camera)
    pictures = []
    for i, (image_seen, taken_by, weight) in enumerate(cause.pictures):
        error = _ADDED_ERROR if np.max(weight) <= 0.1 else _PICTURE_ERROR
        pictures.append((_image(image_seen, taken_by, noise + i, error), taken_by, weight))
    total: Stack | None = None
    for image, image_seen, weight in pictures or [(_sound(first_seed, first_seed + 5000 * frames_before), camera, 1.0)]:
        signals, uniform, _ = photographed_light(image, (), None, image_seen, settings)
        total = weight * signals if total is None else total + weight * signals
    assert total is not None
    sees_lamp = _sound(first_seed, first_seed + 5000 * frames_before).sees_lamp
    scene = photographed_scene(Model())
    write_photographs(
        folder,
        cause.light(total),
        uniform,
        sees_lamp,
        camera=camera,
        scene=scene,
        settings=settings,
        seed=noise,
        hooks=cause.hooks,
    )
    return cause.truth


def run(name: str, seed: int, keep: Path | None, mosaic: str = "") -> dict[str, Any]:
    """Make one capture, diagnose it, and score the explanation."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = (keep or Path(temporary)) / f"{name}-{seed}"
        truth = write_capture(folder, name, seed, mosaic=mosaic)
        start, cpu = time.perf_counter(), time.process_time()
        diagnosis = diagnose_validation(validate_capture(load_capture(folder), Model()))
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    explanation = diagnosis.explanation
    centre = None if explanation is None or explanation.centre_px is None else list(explanation.centre_px)
    row = {
        "key": f"{name}:{seed}",
        "cause": name,
        "truth": truth.family,
        "true_surface": truth.surface,
        "true_centre": truth.centre_px,
        "true_band": truth.band,
        "selected": list(diagnosis.selected),
        "family": None if explanation is None else explanation.family,
        "family_probability": None if explanation is None else explanation.probability,
        "surface": None if explanation is None else explanation.surface,
        "centre": centre,
        "bands": [] if explanation is None else list(explanation.bands),
        "share": 0.0 if explanation is None else explanation.share,
        "runner_up": None if explanation is None else explanation.runner_up,
        "told_apart": explanation is not None and explanation.told_apart,
        "chi2_per_dof": diagnosis.chi2_per_dof,
        "seconds": seconds,
        "cpu_seconds": cpu,
    }
    return {**row, **_score(row)}


def _score(row: Mapping[str, Any]) -> dict[str, bool]:
    if row["truth"] == "none":
        return {"right": not row["selected"], "place": True}
    true, estimate = row["true_centre"], row["centre"]
    if true is None:
        placed = row["true_surface"] is None or row["surface"] == row["true_surface"]
    else:
        placed = estimate is not None and bool(
            np.hypot(estimate[0] - true[0], estimate[1] - true[1]) < _PLACE * SIZE_PX
        )
    return {"right": row["family"] == row["truth"] and row["selected"] == ["unknown"], "place": placed}


def main() -> None:
    """Run what is not in the results yet, and print the table and the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--causes", default=",".join([*CAUSES, "none"]))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--results", type=Path, default=Path("unknown_causes.jsonl"))
    parser.add_argument("--mosaic", default="", help="pattern of a colour sensor; causes of a single filter have none")
    parser.add_argument("--keep", type=Path, help="folder in which the captures stay")
    options = parser.parse_args()
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = {row["key"]: row for row in map(json.loads, lines)}
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for name in options.causes.split(","):
            if f"{name}:{seed}" in rows:
                continue
            row = run(name, seed, options.keep, options.mosaic)
            rows[row["key"]] = row
            with options.results.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(
                f"{row['key']:18} {row['truth']:16} -> {row['family']} {row['surface']} {row['selected']} "
                f"right {row['right']} place {row['place']} share {row['share']:.2f} {row['seconds']:.0f} s",
                flush=True,
            )
    hidden = [row for row in rows.values() if row["truth"] != "none"]
    sound = [row for row in rows.values() if row["truth"] == "none"]
    rates = {
        "family": float(np.mean([r["right"] for r in hidden])) if hidden else None,
        "place": float(np.mean([r["place"] for r in hidden])) if hidden else None,
        "sound": float(np.mean([r["right"] for r in sound])) if sound else None,
        "captures": len(rows),
    }
    print(json.dumps(rates))


if __name__ == "__main__":
    main()
