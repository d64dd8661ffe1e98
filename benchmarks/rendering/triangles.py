"""Cost against the number of triangles: a ball in place of the short block, of 20 to 81,920 triangles.

Each box is rendered in a separate process, 128 x 128 pixels, 31 bands, the kernels compiled beforehand. Printed: CPU
seconds and peak memory of the final gather (256 samples, its solution included) and of the path tracer (64 samples),
and their ratio to the published box.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import trimesh
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.scenes import Scene, Surface, cornell_box, cornell_camera
from contenders import BANDS
from rich.progress import track

_CENTRE_MM, _RADIUS_MM, _SIZE = (186.0, 82.5, 169.0), 80.0, 128
_WAYS = {"final gather": (render_final_gather, 256), "path tracer": (render_path_tracer, 64)}
_DIVISIONS = (0, 1, 2, 3, 4, 5, 6)


def box(divisions: int) -> Scene:
    """The published box, its short block replaced by an icosahedron divided so often; -1 leaves it as it is."""
    scene = cornell_box()
    if divisions < 0:
        return scene
    mesh = trimesh.creation.icosphere(divisions, _RADIUS_MM)
    ball = Surface("ball", "white", np.asarray(mesh.vertices) + _CENTRE_MM, np.asarray(mesh.faces, np.int64))
    return replace(scene, surfaces=(*(s for s in scene.surfaces if s.name != "short-block"), ball))


def measured(way: str, divisions: int) -> dict[str, float]:
    """Triangles, CPU seconds and peak memory (MiB) of one picture after a small one for the kernels."""
    render, samples = _WAYS[way]
    scene = box(divisions)
    render(RenderJob(scene, cornell_camera(_SIZE), BANDS, samples=8, batches=1))
    start = time.process_time()
    render(RenderJob(scene, cornell_camera(_SIZE), BANDS, samples=samples, batches=1, seed=1))
    cost = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"triangles": sum(len(s.faces) for s in scene.surfaces), "seconds": cost, "mib": memory}


def main() -> None:
    if len(sys.argv) == 3:
        print(json.dumps(measured(sys.argv[1], int(sys.argv[2]))))
        return
    runs = [(way, divisions) for divisions in (-1, *_DIVISIONS) for way in _WAYS]
    first: dict[str, float] = {}
    rows = []
    for way, divisions in track(runs, "rendering"):
        run = subprocess.run(
            [sys.executable, __file__, way, str(divisions)], capture_output=True, text=True, check=True
        )
        timings = json.loads(run.stdout)
        ratio = timings["seconds"] / first.setdefault(way, timings["seconds"])
        rows.append(
            f"{way:12} {timings['triangles']:6} triangles: {timings['seconds']:6.2f} CPU s, "
            f"{ratio:5.2f} of the published box, {timings['mib']:5.0f} MiB"
        )
    print("\n".join(sorted(rows)))


if __name__ == "__main__":
    main()
