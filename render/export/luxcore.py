"""LuxCoreRender: scene and configuration files, three wavelengths a run as red, green and blue, which never mix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .exported import Exported, Layout, groups_of
from .neutral import mesh_path
from .raw_pixels import exr_pixels

__all__ = ["read", "write"]

#: Path depth where there is no limit.
_MANY = 1000

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


def write(folder: Path, exported: Exported) -> None:
    """A .scn and a .cfg for each three wavelengths, and run.py."""
    groups = groups_of(exported.settings.wavelength_nm.size, 3)
    for number, group in enumerate(groups):
        scene = _scene(exported, np.resize(group, 3))
        (folder / f"group-{number}.scn").write_text(scene, encoding="ascii")
        (folder / f"group-{number}.cfg").write_text(_settings(exported, number), encoding="ascii")
    script = _RUN.format(batches=exported.settings.batches, groups=len(groups))
    (folder / "run.py").write_text(script, encoding="ascii")


def read(folder: Path, layout: Layout) -> NDArray[np.float32]:
    """(batch, film y, film x, w)."""
    shape = layout.film_height_px + 1, layout.film_width_px
    found = np.empty((layout.settings.batches, shape[0] - 1, shape[1], layout.channels), np.float32)
    for number, group in enumerate(groups_of(layout.channels, 3)):
        for batch, picture in enumerate(found):
            path = folder / "out" / f"batch-{batch}-group-{number}.exr"
            picture[..., group] = exr_pixels(path, shape, ["R", "G", "B"])[1:, :, : len(group)]
    return found


def _settings(exported: Exported, number: int) -> str:
    bounces, film = exported.max_bounces, exported.film
    depth = _MANY if bounces is None else bounces + 1
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
    scene, film, camera = exported.scene, exported.film, exported.camera
    forward, up = camera.rotation[2], -camera.rotation[1]
    target = camera.position_mm + 100 * forward
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
    for one in exported.lamps:
        own = f"scene.materials.{one.key}--"
        lines += [
            f'{own}.type = "matte"',
            f"{own}.kd = {_numbers(one.reflectance[group])}",
            f"{own}.emission = {_numbers(one.radiance[group])}",
            f"{own}.emission.gain.normalizebycolor = 0",
        ]
    shapes = [(surface, surface.material) for surface in scene.surfaces]
    shapes += [(one.surface, f"{one.key}--") for one in exported.lamps]
    for surface, material in shapes:
        lines += [
            f'scene.objects.{surface.name}.ply = "../{mesh_path(surface)}"',
            f'scene.objects.{surface.name}.material = "{material}"',
        ]
    return "\n".join(lines) + "\n"


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(repr(float(v)) for v in values)
