"""LuxCoreRender: three wavelengths a run, as red, green and blue, which never mix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..neutral import Exported, Layout, channel_groups, exr_radiance, mesh_path
from .renderer import PYTHON_SCRIPT, Renderer

__all__ = ["RENDERER"]

#: Path depth where the export has no limit: LuxCore needs a number, and its roulette ends paths long before.
_MAX_DEPTH = 1000
#: Wavelengths of a scene: red, green and blue.
_CHANNELS = 3
#: Distance of the point that the camera looks at, mm. Any positive one gives the same direction.
_TARGET_MM = 100

_RUN = """#!/usr/bin/env python3
\"\"\"Renders the batches that are missing: python run.py. Needs the package pyluxcore.\"\"\"

import os
import time
from pathlib import Path

import pyluxcore

BATCHES, GROUPS = {batches}, {groups}
folder = Path(__file__).resolve().parent
os.chdir(folder)
(folder / "out").mkdir(exist_ok=True)
pyluxcore.Init()
for group in range(GROUPS):
    for batch in range(BATCHES):
        settings = pyluxcore.Properties(f"group-{{group}}.cfg")
        settings.Set(pyluxcore.Property("renderengine.seed", 1 + batch + BATCHES * group))
        out = f"out/batch-{{batch}}-group-{{group}}.exr"
        if Path(out).exists():
            continue
        settings.Set(pyluxcore.Property("film.outputs.0.filename", out))
        session = pyluxcore.RenderSession(pyluxcore.RenderConfig(settings))
        session.Start()
        while not session.HasDone():
            time.sleep(0.05)
            session.UpdateStats()
        session.GetFilm().SaveOutputs()
        session.Stop()
"""


def _write(folder: Path, exported: Exported) -> None:
    """Write a .scn and a .cfg for each three wavelengths, and run.py."""
    groups = channel_groups(exported.settings.wavelength_nm.size, _CHANNELS)
    for number, group in enumerate(groups):
        scene = _scene(exported, np.resize(group, _CHANNELS))
        (folder / f"group-{number}.scn").write_text(scene, encoding="ascii")
        (folder / f"group-{number}.cfg").write_text(_settings(exported, number), encoding="ascii")
    script = _RUN.format(batches=exported.settings.batches, groups=len(groups))
    (folder / "run.py").write_text(script, encoding="ascii")


def _read(folder: Path, layout: Layout) -> NDArray[np.float32]:
    """(batch, film y, film x, w) radiance; LuxCore's film has one row more."""
    return exr_radiance(folder, layout, extra_rows=1)


def _settings(exported: Exported, number: int) -> str:
    """Configuration of one scene."""
    bounces, film = exported.max_bounces, exported.film
    depth = _MAX_DEPTH if bounces is None else bounces + 1
    return (
        "\n".join(
            [
                f'scene.file = "group-{number}.scn"',
                'renderengine.type = "PATHCPU"',
                'sampler.type = "RANDOM"',
                f"batch.haltspp = {exported.film_samples}",
                f"path.pathdepth.total = {depth}",
                f"path.pathdepth.diffuse = {depth}",
                "path.pathdepth.glossy = 1",
                "path.pathdepth.specular = 1",
                "path.clamping.variance.maxvalue = 0",
                'film.filter.type = "NONE"',
                f"film.width = {int(film.size[0])}",
                f"film.height = {int(film.size[1]) + 1}",
                'film.outputs.0.type = "RGB"',
                f'film.outputs.0.filename = "out/group-{number}.exr"',
            ]
        )
        + "\n"
    )


def _scene(exported: Exported, group: NDArray[np.int64]) -> str:
    """Scene of three channels: camera, materials, lamps, meshes."""
    scene, film, camera = exported.scene, exported.film, exported.camera
    forward, up = camera.rotation[2], -camera.rotation[1]
    target = camera.position_mm + _TARGET_MM * forward
    # LuxCore shows every row one pixel too low and leaves the top row black: one row more, which the reader drops
    low, high = film.low, film.low + (film.size + np.array([0, 1])) / film.scale
    # the screen's unit is the tangent of half the field of view
    unit = float(film.size.max() / (2 * film.scale))
    window = np.array([low[0], high[0], -high[1], -low[1]]) / unit
    lines = [
        'scene.camera.type = "perspective"',
        f"scene.camera.lookat.orig = {_numbers(camera.position_mm)}",
        f"scene.camera.lookat.target = {_numbers(target)}",
        f"scene.camera.up = {_numbers(up)}",
        f"scene.camera.fieldofview = {float(np.degrees(2 * np.arctan(unit)))!r}",
        f"scene.camera.screenwindow = {_numbers(window)}",
        "scene.camera.cliphither = 0.1",
        "scene.camera.clipyon = 1e7",
        "scene.camera.autofocus.enable = 0",
    ]
    for (name, _), values in zip(scene.materials.items(), exported.reflectances, strict=True):
        lines += [
            f'scene.materials.{name}.type = "matte"',
            f"scene.materials.{name}.kd = {_numbers(values[group])}",
        ]
    for lamp in exported.lamps:
        material = f"scene.materials.{lamp.key}--"
        lines += [
            f'{material}.type = "matte"',
            f"{material}.kd = {_numbers(lamp.reflectance[group])}",
            f"{material}.emission = {_numbers(lamp.radiance[group])}",
            f"{material}.emission.gain.normalizebycolor = 0",
        ]
    shapes = [(surface, surface.material) for surface in scene.surfaces]
    shapes += [(lamp.surface, f"{lamp.key}--") for lamp in exported.lamps]
    for surface, material in shapes:
        lines += [
            f'scene.objects.{surface.name}.ply = "../{mesh_path(surface)}"',
            f'scene.objects.{surface.name}.material = "{material}"',
        ]
    return "\n".join(lines) + "\n"


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(repr(float(v)) for v in values)


RENDERER = Renderer("luxcore", "LuxCoreRender", _write, _read, PYTHON_SCRIPT, "film", package="pyluxcore")
