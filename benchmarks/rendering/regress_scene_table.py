"""Verdicts of `cbox regress` on six scenes of Mitsuba and Cycles, with and without layers, as one table.

    python regress_scene_table.py [--cycles PYTHON] [--scenes hair,outdoor] [--samples 32] [--seed 5]

Each side is three pictures of other seeds, 48 x 48 px. An equal pair has to be SAME. In a changed pair, one property of
the scene is another; it has to be DIFFERENT, without a wrong name that fits. Pictures without layers are the same ones,
saved with R, G and B alone. PYTHON has the package bpy; without it Mitsuba's scenes are compared alone.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR
import regress_any_scene as any_scene
from cboxlab.validation.compare_renders.regress import UNKNOWN, regress_inputs

SCRIPT = Path(__file__).with_name("cycles_scenes.py")
SEEDS = 3
LAYERS = "alb:albedo,nn:sh_normal,dd:depth,idx:shape_index"


def glass(scene: dict[str, Any]) -> None:
    scene["small-box"]["bsdf"] |= {"int_ior": 1.1}


def hair(scene: dict[str, Any]) -> None:
    for name, shape in scene.items():
        if name.startswith("hair"):
            shape["bsdf"] = any_scene.paint(0.28, 0.17, 0.06)


def volume(scene: dict[str, Any]) -> None:
    scene["fog"]["interior"] |= {"sigma_t": 0.6}


def interior(scene: dict[str, Any]) -> None:
    scene["table"]["bsdf"] |= {"diffuse_reflectance": {"type": "rgb", "value": [0.2, 0.19, 0.17]}}


def textured(scene: dict[str, Any]) -> None:
    scene["ball"]["bsdf"]["reflectance"] |= {"to_uv": any_scene.T().scale([9, 8, 1])}


def outdoor(scene: dict[str, Any]) -> None:
    scene["house"]["to_world"] = any_scene.T().translate([-0.85, 0.8, 0]).scale([0.9, 0.8, 0.8])


#: One changed property of each scene.
CHANGES: dict[str, Callable[[dict[str, Any]], None]] = {
    f.__name__: f for f in (interior, glass, hair, volume, textured, outdoor)
}
Job = tuple[str, bool, int, int, str]


def by_mitsuba(jobs: list[Job]) -> None:
    scenes: dict[tuple[str, bool], Any] = {}
    for name, changed, seed, samples, file in jobs:
        if (name, changed) not in scenes:
            scene = any_scene.SCENES[name]("box")
            if changed:
                CHANGES[name](scene)
            scene["integrator"] = {"type": "aov", "aovs": LAYERS, "picture": scene["integrator"]}
            scenes[name, changed] = mi.load_dict(scene)
        loaded = scenes[name, changed]
        mi.render(loaded, spp=samples, seed=7919 * seed)
        loaded.sensors()[0].film().bitmap().write(file)


def by_cycles(python: str, jobs: list[Job]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / "jobs.json"
        listed.write_text(json.dumps(jobs))
        subprocess.run([python, SCRIPT, listed], check=True, stdout=subprocess.DEVNULL, env=dict(os.environ))


def without_layers(file: Path) -> Path:
    """The picture alone, as R, G, B."""
    with OpenEXR.File(str(file), separate_channels=True) as picture:
        planes = {name: np.array(channel.pixels) for part in picture.parts for name, channel in part.channels.items()}
    prefix = next(p for p in ("", "ViewLayer.Combined.") if f"{p}R" in planes)
    alone = file.with_name(f"alone-{file.name}")
    channels = {name: np.ascontiguousarray(planes[prefix + name], np.float32) for name in "RGB"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(alone))
    return alone


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", default="", help="Python with the package bpy.")
    parser.add_argument("--scenes", default=",".join(CHANGES))
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0, help="Added to the seeds of the renderings.")
    options = parser.parse_args()
    right = total = 0
    renderers: dict[str, Callable[[list[Job]], None]] = {"Mitsuba": by_mitsuba}
    if options.cycles:
        renderers["Cycles"] = lambda jobs: by_cycles(options.cycles, jobs)
    print("| scene | renderer | layers | equal pair | changed pair |\n|---|---|---|---|---|")
    for number, name in enumerate(options.scenes.split(",")):
        for renderer, render in renderers.items():
            with tempfile.TemporaryDirectory() as folder:
                sides = [
                    [Path(folder) / f"{side}-{seed}.exr" for seed in range(SEEDS)]
                    for side in ("baseline", "equal", "changed")
                ]
                jobs = [
                    (name, side == 2, 1 + options.seed + seed + SEEDS * (side + 3 * number), options.samples, str(file))
                    for side, files in enumerate(sides)
                    for seed, file in enumerate(files)
                ]
                render(jobs)
                for layers in (True, False):
                    texts = [",".join(str(f if layers else without_layers(f)) for f in files) for files in sides]
                    equal, changed = (regress_inputs(texts[0], text) for text in texts[1:])
                    best = changed.changes[0] if changed.changes else None
                    wrong = best is not None and best.change != UNKNOWN and best.fits
                    verdicts = equal.same, not changed.same and not wrong
                    right, total = right + sum(verdicts), total + 2
                    clearest = "SAME" if changed.same else f"DIFFERENT ({changed.deciding[0].kind})"
                    alarm = "SAME" if equal.same else f"DIFFERENT ({equal.deciding[0].kind} {equal.deciding[0].name})"
                    name_ = f", named {best.change} {best.probability:.2f}" if best is not None and wrong else ""
                    with_layers = "with" if layers else "without"
                    print(f"| {name} | {renderer} | {with_layers} | {alarm} | {clearest}{name_} |", flush=True)
    print(f"\nright: {right} of {total}")


if __name__ == "__main__":
    main()
