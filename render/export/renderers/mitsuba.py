"""Mitsuba 3: three wavelengths a scene, as red, green and blue, which never mix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray

from ..neutral import Exported, channel_groups, exr_radiance, mesh_path
from .renderer import PYTHON_SCRIPT, Renderer

__all__ = ["RENDERER"]

#: Wavelengths of a scene: the red, green and blue of an RGB variant.
_CHANNELS = 3

_RUN = """#!/usr/bin/env python3
\"\"\"Renders the batches that are missing: python run.py [VARIANT]. Needs the package mitsuba.\"\"\"

import sys
from pathlib import Path

import mitsuba as mi

BATCHES, GROUPS = {batches}, {groups}
mi.set_variant(*(sys.argv[1:2] or ["llvm_ad_rgb", "scalar_rgb"]))
folder = Path(__file__).resolve().parent
(folder / "out").mkdir(exist_ok=True)
for group in range(GROUPS):
    scene = mi.load_file(str(folder / f"group-{{group}}.xml"))
    for batch in range(BATCHES):
        out = folder / "out" / f"batch-{{batch}}-group-{{group}}.exr"
        if out.exists():
            continue
        picture = mi.render(scene, seed=1 + batch + BATCHES * group)
        unfinished = out.with_suffix(".part.exr")
        mi.Bitmap(picture, pixel_format=mi.Bitmap.PixelFormat.RGB).write(str(unfinished))
        unfinished.replace(out)
"""


def _write(folder: Path, exported: Exported) -> None:
    """Write one XML scene for each three wavelengths, and run.py."""
    groups = channel_groups(exported.settings.wavelength_nm.size, _CHANNELS)
    for number, group in enumerate(groups):
        (folder / f"group-{number}.xml").write_text(_scene(exported, np.resize(group, _CHANNELS)), encoding="ascii")
    script = _RUN.format(batches=exported.settings.batches, groups=len(groups))
    (folder / "run.py").write_text(script, encoding="ascii")


def _scene(exported: Exported, group: NDArray[np.int64]) -> str:
    """XML scene of three channels."""
    bounces, samples = exported.max_bounces, exported.film_samples
    names = ", ".join(f"{w:g}" for w in exported.settings.wavelength_nm[group])
    lines = [
        '<scene version="3.0.0">',
        f"  <!-- red, green and blue stand for {names} nm -->",
        f'  <default name="spp" value="{samples}"/>',
        '  <integrator type="path">',
        f'    <integer name="max_depth" value="{-1 if bounces is None else bounces + 1}"/>',
        "  </integrator>",
        *_sensor(exported),
    ]
    for (name, _), values in zip(exported.scene.materials.items(), exported.reflectances, strict=True):
        lines += [f'  <bsdf type="diffuse" id="material-{name}">', _rgb("reflectance", values[group], 4), "  </bsdf>"]
    for surface in exported.scene.surfaces:
        lines += _shape(surface, f"material-{surface.material}", [])
    for lamp in exported.lamps:
        lines += [
            f'  <bsdf type="diffuse" id="{lamp.key}--">',
            _rgb("reflectance", lamp.reflectance[group], 4),
            "  </bsdf>",
        ]
        emitter = ['    <emitter type="area">', _rgb("radiance", lamp.radiance[group], 6), "    </emitter>"]
        lines += _shape(lamp.surface, f"{lamp.key}--", emitter)
    return "\n".join([*lines, "</scene>"]) + "\n"


def _shape(surface: Surface, material: str, emitter: list[str]) -> list[str]:
    """Lines of a mesh or a sphere."""
    kind = [
        f'  <shape type="ply" id="shape-{surface.name}">',
        f'    <string name="filename" value="../{mesh_path(surface)}"/>',
        '    <boolean name="face_normals" value="true"/>',
    ]
    if surface.ball:
        (x, y, z), radius = surface.sphere_mm
        kind = [
            f'  <shape type="sphere" id="shape-{surface.name}">',
            f'    <point name="center" x="{float(x)!r}" y="{float(y)!r}" z="{float(z)!r}"/>',
            f'    <float name="radius" value="{radius!r}"/>',
        ]
    return [
        *kind,
        f'    <ref id="{material}"/>',
        *emitter,
        "  </shape>",
    ]


def _rgb(name: str, values: NDArray[np.float64], indent: int) -> str:
    return f'{" " * indent}<rgb name="{name}" value="{", ".join(f"{v:.9g}" for v in values)}"/>'


def _sensor(exported: Exported) -> list[str]:
    """Lines of the pinhole, its film with a box filter, and the sampler."""
    film = exported.film
    centre = (film.low + film.size / (2 * film.scale)) * film.scale / film.size
    matrix = " ".join(repr(float(x)) for x in exported.axes.ravel())
    field = float(np.degrees(2 * np.arctan(film.size[0] / (2 * film.scale))))
    return [
        '  <sensor type="perspective">',
        f'    <transform name="to_world"><matrix value="{matrix}"/></transform>',
        '    <string name="fov_axis" value="x"/>',
        f'    <float name="fov" value="{field!r}"/>',
        f'    <float name="principal_point_offset_x" value="{float(centre[0])!r}"/>',
        f'    <float name="principal_point_offset_y" value="{float(centre[1])!r}"/>',
        '    <float name="near_clip" value="0.1"/>',
        '    <float name="far_clip" value="1e7"/>',
        '    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>',
        '    <film type="hdrfilm">',
        f'      <integer name="width" value="{int(film.size[0])}"/>',
        f'      <integer name="height" value="{int(film.size[1])}"/>',
        '      <string name="pixel_format" value="rgb"/>',
        '      <string name="component_format" value="float32"/>',
        '      <rfilter type="box"/>',
        "    </film>",
        "  </sensor>",
    ]


RENDERER = Renderer(
    "mitsuba", "Mitsuba 3", _write, exr_radiance, PYTHON_SCRIPT, "film", package="mitsuba", by_default=True
)
