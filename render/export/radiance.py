"""Radiance: triangles as polygons, up to 24 channels a run as its spectral colours, rays to rtrace.

Radiance divides its range of wavelengths into equal channels, the longest wavelength first. Each channel here stands
for one wavelength of the export: the spectra are given at the channels' centres, with one value more at each end, so
that no channel is interpolated from its neighbours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cboxlab.scenes.scene import Surface
from numpy.typing import NDArray

from .exported import Exported, Layout, groups_of
from .neutral import rays_path
from .raw_pixels import raw_pixels

__all__ = ["read", "write"]

#: The most channels that Radiance carries, and the fewest: three would be red, green and blue, and mixed.
_MOST, _FEWEST = 24, 4
#: Its range of wavelengths, nm, which only names the channels.
_RANGE_NM = 700.0, 400.0
#: So many reflections where there is no limit; roulette ends paths long before.
_MANY = 100


def write(folder: Path, exported: Exported) -> None:
    """Scene files and run.sh."""
    settings = exported.settings
    lines = [
        "#!/bin/sh",
        "# Needs oconv and rtrace of Radiance 6 or newer.",
        "set -e",
        'cd "$(dirname "$0")"',
        "mkdir -p out",
        "# the package pyradiance keeps Radiance's library beside its programs",
        'library="$(dirname "$(command -v rtrace)")/../lib"',
        '[ -n "$RAYPATH" ] || [ ! -f "$library/rayinit.cal" ] || export RAYPATH=".:$library"',
    ]
    bounces = exported.max_bounces
    paths = f"-ab {_MANY if bounces is None else max(bounces - 1, 0)} -lr -{_MANY} -lw 2e-3"
    for number, group in enumerate(groups_of(settings.wavelength_nm.size, _MOST)):
        padded = np.resize(group, max(len(group), _FEWEST))
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


def read(folder: Path, layout: Layout) -> NDArray[np.float32]:
    """(batch, y * s, x * s, w)."""
    s, channels, batches = layout.settings.subpixels, layout.channels, layout.settings.batches
    found = np.empty((batches, layout.height_px * s, layout.width_px * s, channels), np.float32)
    for number, group in enumerate(groups_of(channels, _MOST)):
        shape = (*found.shape[:3], max(len(group), _FEWEST))
        found[..., group] = raw_pixels(folder / "out" / f"group-{number}.f32", shape)[..., : len(group)]
    return found


def _scene(exported: Exported, group: NDArray[np.int64]) -> str:
    blocks = []
    for (name, _), values in zip(exported.scene.materials.items(), exported.reflectances, strict=True):
        blocks += [
            _spectrum(f"spectrum-{name}", values[group]),
            f"spectrum-{name} plastic material-{name}\n0\n0\n5 1 1 1 0 0",
        ]
    for surface in exported.scene.surfaces:
        shapes = _sphere if surface.ball else _polygons
        blocks += shapes(surface, f"material-{surface.material}")
    for one in exported.lamps:
        own = f"spectrum--{one.key}"
        blocks += [_spectrum(own, one.radiance[group]), f"{own} light {one.key}\n0\n0\n3 1 1 1"]
        blocks += _polygons(one.surface, one.key, whole=True)
    return "\n\n".join(blocks) + "\n"


def _spectrum(name: str, values: NDArray[np.float64]) -> str:
    half = (_RANGE_NM[0] - _RANGE_NM[1]) / len(values) / 2
    padded = [values[0], *values, values[-1]]
    ends = f"{_RANGE_NM[0] + half:.9g} {_RANGE_NM[1] - half:.9g}"
    return f"void spectrum {name}\n0\n0\n{len(padded) + 2} {ends}\n{' '.join(f'{v:.9g}' for v in padded)}"


def _sphere(surface: Surface, modifier: str) -> list[str]:
    centre, radius = surface.sphere_mm
    numbers = " ".join(repr(float(x)) for x in (*centre, radius))
    return [f"{modifier} sphere {surface.name}\n0\n0\n4 {numbers}"]


def _polygons(surface: Surface, modifier: str, whole: bool = False) -> list[str]:
    """whole : two triangles that make a parallelogram become one polygon.

    Radiance samples a lamp over a parallelogram; of a triangle it loses light (0.7 to 2.3 % in the published box).
    """
    corners = [surface.vertices_mm[face] for face in surface.faces]
    if whole:
        corners = _parallelograms(corners)
    return [
        f"{modifier} polygon {surface.name}.{index}\n0\n0\n{3 * len(polygon)}\n"
        + "\n".join(" ".join(repr(float(x)) for x in corner) for corner in polygon)
        for index, polygon in enumerate(corners)
    ]


def _parallelograms(triangles: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    found: list[NDArray[np.float64]] = []
    for triangle in triangles:
        last = found[-1] if found and len(found[-1]) == 3 else None
        if last is not None and np.array_equal(last[[0, 2]], triangle[[0, 1]]):
            size = np.ptp(last, axis=0).max()
            if np.abs(last[0] + last[2] - last[1] - triangle[2]).max() < 1e-6 * size:
                found[-1] = np.concatenate([last, triangle[2:]])
                continue
        found.append(triangle)
    return found
