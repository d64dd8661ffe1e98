"""Radiance: triangles as polygons, 4 to 24 spectral channels a run, rays to rtrace.

Radiance divides its range of wavelengths into equal channels, the longest wavelength first. Each channel here stands
for one wavelength of the export: the spectra are given at the channels' centres, with one value more at each end, so
that no channel is interpolated from its neighbours.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray

from ..neutral import Exported, Layout, channel_groups, raw_pixels, rays_path
from .renderer import SHELL_SCRIPT, Renderer

__all__ = ["RENDERER"]

#: Most channels of a run: the limit of Radiance 6.
_MAX_CHANNELS = 24
#: Fewest channels of a run: three would be red, green and blue, which Radiance mixes.
_MIN_CHANNELS = 4
#: Longest and shortest wavelength of a run, nm. They only name the channels.
_RANGE_NM = 700.0, 400.0
#: Reflections where the export has no limit: roulette ends paths long before.
_MAX_BOUNCES = 100
#: Largest distance of a fourth corner from that of a parallelogram, relative to its size: 1e-6, the files' rounding.
_PARALLELOGRAM_TOLERANCE = 1e-6


def _write(folder: Path, exported: Exported) -> None:
    """Write a scene for each group of channels, and run.sh."""
    settings = exported.settings
    lines = [
        "#!/bin/sh",
        "# Needs oconv and rtrace of Radiance 6 or newer.",
        "set -e",
        'cd "$(dirname "$0")"',
        "mkdir -p out",
        "# the package pyradiance keeps Radiance's library next to its programs",
        'library="$(dirname "$(command -v rtrace)")/../lib"',
        '[ -n "$RAYPATH" ] || [ ! -f "$library/rayinit.cal" ] || export RAYPATH=".:$library"',
    ]
    bounces = exported.max_bounces
    paths = f"-ab {_MAX_BOUNCES if bounces is None else max(bounces - 1, 0)} -lr -{_MAX_BOUNCES} -lw 2e-3"
    for number, group in enumerate(channel_groups(settings.wavelength_nm.size, _MAX_CHANNELS)):
        padded = np.resize(group, max(len(group), _MIN_CHANNELS))
        (folder / f"group-{number}.rad").write_text(_scene(exported, padded), encoding="ascii")
        part = f"out/group-{number}.f32"
        lines.append(f"if [ ! -f {part} ]; then")
        lines.append(f"oconv group-{number}.rad > out/group-{number}.oct")
        low, high = _RANGE_NM
        # aa 0: no ambient cache; u+, dj 1, dt 0: independent random samples of all of the lamp
        options = (
            f"-fff -h -co+ -cs {len(padded)} -cw {low:g} {high:g} {paths} -aa 0 -as 0 "
            f"-ad {exported.subpixel_samples} -u+ -dt 0 -dc 1 -dj 1 -ds 0.1 -dr 0 -st 0 -bv- -w-"
        )
        rays = " ".join(f"../{rays_path(batch)}" for batch in range(settings.batches))
        lines.append(f"cat {rays} | rtrace $RTRACE_OPTIONS {options} out/group-{number}.oct > {part}.part")
        lines.append(f"mv {part}.part {part}")
        lines.append("fi")
    (folder / "run.sh").write_text("\n".join(lines) + "\n", encoding="ascii")


def _read(folder: Path, layout: Layout) -> NDArray[np.float32]:
    """(batch, y * s, x * s, w) radiance from one file of float32 for each group of channels."""
    s, channels, batches = layout.settings.subpixels, layout.channels, layout.settings.batches
    radiance = np.empty((batches, layout.height_px * s, layout.width_px * s, channels), np.float32)
    for number, group in enumerate(channel_groups(channels, _MAX_CHANNELS)):
        shape = (*radiance.shape[:3], max(len(group), _MIN_CHANNELS))
        radiance[..., group] = raw_pixels(folder / "out" / f"group-{number}.f32", shape)[..., : len(group)]
    return radiance


def _scene(exported: Exported, group: NDArray[np.int64]) -> str:
    """Scene of one group of channels: materials, surfaces, lamps."""
    blocks = []
    for (name, _), values in zip(exported.scene.materials.items(), exported.reflectances, strict=True):
        blocks += [
            _spectrum(f"spectrum-{name}", values[group]),
            f"spectrum-{name} plastic material-{name}\n0\n0\n5 1 1 1 0 0",
        ]
    for surface in exported.scene.surfaces:
        shapes = _sphere if surface.ball else _polygons
        blocks += shapes(surface, f"material-{surface.material}")
    for lamp in exported.lamps:
        spectrum = f"spectrum--{lamp.key}"
        blocks += [_spectrum(spectrum, lamp.radiance[group]), f"{spectrum} light {lamp.key}\n0\n0\n3 1 1 1"]
        blocks += _polygons(lamp.surface, lamp.key, merged=True)
    return "\n\n".join(blocks) + "\n"


def _spectrum(name: str, values: NDArray[np.float64]) -> str:
    """Spectrum with one value more at each end, so that no channel is interpolated."""
    half = (_RANGE_NM[0] - _RANGE_NM[1]) / len(values) / 2
    padded = [values[0], *values, values[-1]]
    ends = f"{_RANGE_NM[0] + half:.9g} {_RANGE_NM[1] - half:.9g}"
    return f"void spectrum {name}\n0\n0\n{len(padded) + 2} {ends}\n{' '.join(f'{v:.9g}' for v in padded)}"


def _sphere(surface: Surface, modifier: str) -> list[str]:
    centre, radius = surface.sphere_mm
    numbers = " ".join(repr(float(x)) for x in (*centre, radius))
    return [f"{modifier} sphere {surface.name}\n0\n0\n4 {numbers}"]


def _polygons(surface: Surface, modifier: str, merged: bool = False) -> list[str]:
    """Triangles of a surface as polygons; where ``merged``, parallelograms as one.

    Radiance samples a lamp over a parallelogram. A triangular lamp loses light: 0.7 to 2.3 % in the published box.
    """
    corners = [surface.vertices_mm[face] for face in surface.faces]
    if merged:
        corners = _parallelograms(corners)
    return [
        f"{modifier} polygon {surface.name}.{index}\n0\n0\n{3 * len(polygon)}\n"
        + "\n".join(" ".join(repr(float(x)) for x in corner) for corner in polygon)
        for index, polygon in enumerate(corners)
    ]


def _parallelograms(triangles: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Polygons in which two following triangles that make a parallelogram are one."""
    polygons: list[NDArray[np.float64]] = []
    for triangle in triangles:
        last = polygons[-1] if polygons and len(polygons[-1]) == 3 else None
        if last is not None and np.array_equal(last[[0, 2]], triangle[[0, 1]]):
            size = np.ptp(last, axis=0).max()
            if np.abs(last[0] + last[2] - last[1] - triangle[2]).max() < _PARALLELOGRAM_TOLERANCE * size:
                polygons[-1] = np.concatenate([last, triangle[2:]])
                continue
        polygons.append(triangle)
    return polygons


def _environment() -> dict[str, str]:
    """Paths to the programs of the package pyradiance, unless Radiance is installed."""
    package = importlib.util.find_spec("pyradiance")
    if package is None or package.origin is None or shutil.which("rtrace") is not None:
        return {}
    folder = Path(package.origin).parent
    path = f"{folder / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"
    return {"PATH": path, "RAYPATH": str(folder / "lib")}


RENDERER = Renderer(
    "radiance",
    "Radiance",
    _write,
    _read,
    SHELL_SCRIPT,
    "rays",
    programs=("oconv", "rtrace"),
    package_of_programs="pyradiance",
    environment=_environment,
    lamp_reflects=False,
    by_default=True,
)
