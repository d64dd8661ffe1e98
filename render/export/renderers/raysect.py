"""Raysect: a Python script that traces the ray file, all wavelengths along each path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray

from ..neutral import Exported, Layout, mesh_path, npy_pixels, rays_path
from .renderer import PYTHON_SCRIPT, Renderer

__all__ = ["RENDERER"]

#: Path depth where the export has no limit: Raysect needs a number, and its roulette ends paths long before.
_MAX_DEPTH = 500
#: Depth from which on roulette ends paths: after most of the box's light, so that roulette adds little noise.
_ROULETTE_DEPTH = 4

_SCRIPT = '''#!/usr/bin/env python3
"""Renders the batches that are missing: python run.py [PROCESSES]. Needs the packages raysect and numpy.

Channel i of the export is the range from i + 1 to i + 2 of Raysect's wavelengths, where spectra are constant.
Lengths are divided by 1000, since Raysect's meshes are made for metres.
"""

import multiprocessing
import sys
from pathlib import Path

import numpy as np
from raysect.core import Point3D, Vector3D, translate
from raysect.core.math.random import seed
from raysect.optical import InterpolatedSF, Ray, World
from raysect.optical.material import AbsorbingSurface, Add, Lambert, UniformSurfaceEmitter
from raysect.primitive import Mesh, Sphere

FOLDER = Path(__file__).resolve().parent
ROWS, COLUMNS, SAMPLES, CHANNELS = @NUMBERS@
MATERIALS = {
@MATERIALS@
}
SURFACES = [  # mesh, material, centre and radius of a ball
@SURFACES@
]
LAMPS = [  # mesh, radiance, reflectance
@LAMPS@
]
RAYS = @RAYS@


def spectrum(values):
    """Constant in each channel."""
    edges = np.arange(CHANNELS) + 1.0
    places = np.stack([edges + 1e-9, edges + 1 - 1e-9], axis=1).ravel()
    return InterpolatedSF(places, np.repeat(values, 2))


def paint(values):
    return Lambert(spectrum(values)) if any(values) else AbsorbingSurface()


def mesh(path, world, material):
    lines = (FOLDER.parent / path).read_text().split("end_header")[1].split()
    head = (FOLDER.parent / path).read_text().split()
    corners, triangles = (int(head[head.index(kind) + 1]) for kind in ("vertex", "face"))
    points = np.array(lines[: 3 * corners], float).reshape(-1, 3) / 1000
    faces = np.array(lines[3 * corners : 3 * corners + 4 * triangles], int).reshape(-1, 4)[:, 1:]
    return Mesh(points, faces, smoothing=False, closed=False, parent=world, material=material)


WORLD = World()
for path, name, ball in SURFACES:
    if ball:
        x, y, z, radius = (value / 1000 for value in ball)
        Sphere(radius, WORLD, translate(x, y, z), paint(MATERIALS[name]))
    else:
        mesh(path, WORLD, paint(MATERIALS[name]))
for path, radiance, reflectance in LAMPS:
    lamp = Add(paint(reflectance), UniformSurfaceEmitter(spectrum(radiance)), surface_only=True)
    lamp.importance = 1.0
    mesh(path, WORLD, lamp)


def row(job):
    batch, index = job
    seed(1 + index + ROWS * batch)
    places = np.memmap(FOLDER.parent / RAYS[batch], "<f4", "r", shape=(ROWS, COLUMNS, 6))[index].astype(float)
    found = np.zeros((COLUMNS, CHANNELS), np.float32)
    for column, values in enumerate(places):
        origin, direction = Point3D(*(values[:3] / 1000)), Vector3D(*values[3:])
        ray = Ray(origin, direction, min_wavelength=1.0, max_wavelength=1.0 + CHANNELS, bins=CHANNELS, @DEPTH@)
        for _ in range(SAMPLES):
            found[column] += ray.trace(WORLD).samples
    return found / SAMPLES


if __name__ == "__main__":
    WORLD.build_accelerator()
    (FOLDER / "out").mkdir(exist_ok=True)
    processes = int(sys.argv[1]) if len(sys.argv) > 1 else None
    with multiprocessing.get_context("fork").Pool(processes) as pool:
        for batch in range(len(RAYS)):
            if (FOLDER / "out" / f"batch-{batch}.npy").exists():
                continue
            picture = np.stack(pool.map(row, [(batch, index) for index in range(ROWS)], chunksize=4))
            unfinished = FOLDER / "out" / f"batch-{batch}.part.npy"
            np.save(unfinished, picture)
            unfinished.replace(FOLDER / "out" / f"batch-{batch}.npy")
'''


def _write(folder: Path, exported: Exported) -> None:
    """Write run.py. Without reflections all surfaces are black: paths have two parts at least."""
    scene, settings, bounces = exported.scene, exported.settings, exported.max_bounces
    reflecting = bounces != 0
    reflectances = reflecting * exported.reflectances
    materials = [f"    {name!r}: {row.tolist()!r}," for name, row in zip(scene.materials, reflectances, strict=True)]
    surfaces = [f"    ({mesh_path(s)!r}, {s.material!r}, {_ball(s)!r})," for s in scene.surfaces]
    lamps = [
        f"    ({mesh_path(lamp.surface)!r}, {lamp.radiance.tolist()!r}, {(reflecting * lamp.reflectance).tolist()!r}),"
        for lamp in exported.lamps
    ]
    deepest = _MAX_DEPTH if bounces is None else max(bounces + 1, 2)
    depth = f"extinction_prob=0.2, extinction_min_depth={min(_ROULETTE_DEPTH, deepest)}, max_depth={deepest}"
    s = settings.subpixels
    numbers = (
        exported.camera.height_px * s,
        exported.camera.width_px * s,
        exported.subpixel_samples,
        settings.wavelength_nm.size,
    )
    filled = {
        "NUMBERS": ", ".join(str(n) for n in numbers),
        "MATERIALS": "\n".join(materials),
        "SURFACES": "\n".join(surfaces),
        "LAMPS": "\n".join(lamps),
        "RAYS": repr([rays_path(batch) for batch in range(settings.batches)]),
        "DEPTH": depth,
    }
    script = _SCRIPT
    for key, text in filled.items():
        script = script.replace(f"@{key}@", text)
    (folder / "run.py").write_text(script, encoding="ascii")


def _ball(surface: Surface) -> tuple[float, ...]:
    """Centre and radius of a ball, mm; empty for other surfaces."""
    if not surface.ball:
        return ()
    centre, radius = surface.sphere_mm
    return *(float(x) for x in centre), radius


def _read(folder: Path, layout: Layout) -> NDArray[np.float64]:
    """(batch, y * s, x * s, w) radiance from one NumPy file for each batch."""
    s, batches = layout.settings.subpixels, layout.settings.batches
    shape = layout.height_px * s, layout.width_px * s, layout.channels
    return np.stack([npy_pixels(folder / "out" / f"batch-{batch}.npy", shape) for batch in range(batches)])


RENDERER = Renderer("raysect", "Raysect", _write, _read, PYTHON_SCRIPT, "rays", package="raysect", by_default=True)
