"""pbrt-v4: a scene with the spectral film, whose buckets are the export's channels.

Each channel is a range of whole nanometres within 400 to 700 nm, whatever wavelength it stands for, in which the
spectra are constant: a bucket's mean is then the radiance at one wavelength. pbrt divides a lamp's spectrum by its
luminous integral and multiplies its film by that of the equal-energy spectrum; ``scale`` undoes both.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import OpenEXR
from cboxlab.scenes.scene import Surface
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..neutral import Exported, Layout, exr_pixels, mesh_path
from .renderer import SHELL_SCRIPT, Renderer

__all__ = ["RENDERER"]

#: Integral of the CIE's luminous efficiency, nm, as pbrt's source has it.
_LUMINOUS_INTEGRAL_NM = 106.856895
#: Range in which the channels lie, nm: part of pbrt's 360 to 830, where the luminous efficiency is not near zero.
_RANGE_NM = 400.0, 700.0
#: Reflections where the export has no limit: pbrt needs a number, and its roulette ends paths long before.
_MAX_BOUNCES = 1000
#: Distance of a spectrum's values from the edges of their channel, nm: far below pbrt's step of 1 nm.
_EDGE_NM = 0.001
#: Name of a spectral channel in the files that pbrt writes.
_BUCKET = re.compile(r"S0\.(\d+)[,.](\d+)nm")


def _write(folder: Path, exported: Exported) -> None:
    """Write world.pbrt, a file for each batch that includes it, and run.sh.

    An export of more channels than the range has whole nanometres is refused with an InputError.
    """
    (folder / "world.pbrt").write_text(_world(exported), encoding="ascii")
    lines = ["#!/bin/sh", "# Needs pbrt-v4.", "set -e", 'cd "$(dirname "$0")"', "mkdir -p out"]
    for batch in range(exported.settings.batches):
        (folder / f"batch-{batch}.pbrt").write_text(_batch(exported, batch), encoding="ascii")
        out = f"out/batch-{batch}.exr"
        lines += [
            f"if [ ! -f {out} ]; then",
            f"pbrt batch-{batch}.pbrt",
            f"mv out/part-{batch}.exr {out}",
            "fi",
        ]
    (folder / "run.sh").write_text("\n".join(lines) + "\n", encoding="ascii")


def _read(folder: Path, layout: Layout) -> NDArray[np.float64]:
    """(batch, film y, film x, w) radiance from one spectral EXR file for each batch."""
    radiance = []
    for batch in range(layout.settings.batches):
        path = folder / "out" / f"batch-{batch}.exr"
        names = _buckets(path) if path.is_file() else [""]
        if path.is_file() and len(names) != layout.channels:
            raise InputError(path, f"{len(names)} spectral channels", f"{layout.channels}")
        radiance.append(exr_pixels(path, (layout.film_height_px, layout.film_width_px), names))
    return np.stack(radiance)


def _buckets(path: Path) -> list[str]:
    """Names of a file's spectral channels, in the order of their wavelengths."""
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            matches = [m for m in map(_BUCKET.fullmatch, file.channels()) if m]
    except Exception as error:  # the library raises exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", "an OpenEXR picture") from None
    return [m.group() for m in sorted(matches, key=lambda m: float(f"{m.group(1)}.{m.group(2)}"))]


def _edges(channels: int) -> NDArray[np.float64]:
    """(channels + 1,) limits of the channels, halfway between whole nanometres."""
    width = int((_RANGE_NM[1] - _RANGE_NM[0]) // channels)
    if width < 1:
        raise InputError("wavelengths", f"{channels}", f"at most {_RANGE_NM[1] - _RANGE_NM[0]:g} for pbrt")
    return np.asarray(_RANGE_NM[0] - 0.5 + width * np.arange(channels + 1), np.float64)


def _steps(values: NDArray[np.float64]) -> str:
    """Spectrum that is constant in each channel."""
    edges = _edges(len(values))
    pairs = [
        f"{nm:.9g} {value:.9g}"
        for low, high, value in zip(edges, edges[1:], values, strict=False)
        for nm in (low + _EDGE_NM, high - _EDGE_NM)
    ]
    return "[ " + " ".join(pairs) + " ]"


def _scale(values: NDArray[np.float64]) -> float:
    """Luminous integral of the lamp over that of the equal-energy spectrum."""
    import colour  # slow to import (1 s), and only needed here

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    edges = _edges(len(values))
    nm = np.arange(np.ceil(edges[0]), np.floor(edges[-1]) + 1)
    luminous = np.interp(nm, observer.wavelengths, observer.values[:, 1])
    return float(luminous @ values[np.searchsorted(edges, nm) - 1] / _LUMINOUS_INTEGRAL_NM)


def _batch(exported: Exported, batch: int) -> str:
    """Camera, film and sampler of one batch."""
    film, camera, bounces = exported.film, exported.camera, exported.max_bounces
    edges = _edges(exported.settings.wavelength_nm.size)
    view = np.eye(4)
    view[:3, :3] = np.diag([1.0, -1.0, 1.0]) @ camera.rotation
    view[:3, 3] = -view[:3, :3] @ camera.position_mm
    high = film.low + film.size / film.scale
    window = [film.low[0], high[0], -high[1], -film.low[1]]
    lines = [
        f"Transform [ {_numbers(view.T.ravel())} ]",
        f'Camera "perspective" "float fov" 90 "float screenwindow" [ {_numbers(window)} ]',
        f'Film "spectral" "integer xresolution" {int(film.size[0])} "integer yresolution" {int(film.size[1])} '
        f'"integer nbuckets" {len(edges) - 1} "float lambdamin" {float(edges[0])!r} '
        f'"float lambdamax" {float(edges[-1])!r} '
        f'"bool savefp16" false "string filename" "out/part-{batch}.exr"',
        'PixelFilter "box" "float xradius" 0.5 "float yradius" 0.5',
        f'Sampler "independent" "integer pixelsamples" {exported.film_samples} "integer seed" {batch + 1}',
        f'Integrator "path" "integer maxdepth" {_MAX_BOUNCES if bounces is None else bounces}',
        "WorldBegin",
        'Include "world.pbrt"',
    ]
    return "\n".join(lines) + "\n"


def _world(exported: Exported) -> str:
    """Materials, surfaces and lamps."""
    lines = []
    for (name, _), values in zip(exported.scene.materials.items(), exported.reflectances, strict=True):
        spectrum = f'"spectrum reflectance" {_steps(values)}'
        lines.append(f'MakeNamedMaterial "{name}" "string type" "diffuse" {spectrum}')
    for surface in exported.scene.surfaces:
        lines += [f'NamedMaterial "{surface.material}"', *_shape(surface)]
    for lamp in exported.lamps:
        reflectance = _steps(lamp.reflectance)
        lines += [
            f'MakeNamedMaterial "{lamp.key}--" "string type" "diffuse" "spectrum reflectance" {reflectance}',
            "AttributeBegin",
            f'NamedMaterial "{lamp.key}--"',
            f'AreaLightSource "diffuse" "spectrum L" {_steps(lamp.radiance)} "float scale" {_scale(lamp.radiance)!r}',
            *_shape(lamp.surface),
            "AttributeEnd",
        ]
    return "\n".join(lines) + "\n"


def _shape(surface: Surface) -> list[str]:
    """Lines of a mesh or a sphere."""
    if not surface.ball:
        return [f'Shape "plymesh" "string filename" "../{mesh_path(surface)}"']
    centre, radius = surface.sphere_mm
    translation = f"Translate {_numbers(centre)}"
    return ["AttributeBegin", translation, f'Shape "sphere" "float radius" {radius!r}', "AttributeEnd"]


def _numbers(values: NDArray[np.float64] | list[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


RENDERER = Renderer("pbrt", "pbrt-v4", _write, _read, SHELL_SCRIPT, "film", programs=("pbrt",))
