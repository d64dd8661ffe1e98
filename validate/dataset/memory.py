"""Memory that the pictures of a recipe need, and that of this machine."""

from __future__ import annotations

import os
from pathlib import Path

from cboxlab.rendering.dataset import REFLECTIONS, CameraTable, Recipe
from cboxlab.utils.errors import InputError

from .picture import STRIP_PIXELS
from .tasks import MOST_BOXES

__all__ = ["require_memory"]

#: Memory of a process without its pictures, bytes: libraries, kernels and a strip (measured: 0.6 to 0.8 GB).
_PROCESS_BYTES = 0.8e9

#: Further copies of a picture while strips are joined and checked (measured: 1.3).
_COPIES = 2

#: Bytes of a number in single precision.
_NUMBER_BYTES = 4

#: Numbers of a pixel for each wavelength by truth; every picture has the radiance and its error.
_SPECTRAL = {"albedo": 1, "irradiance": 1, "specular": 1, "effects_light": 1, "reflections": len(REFLECTIONS)}

#: Numbers of a pixel without wavelengths: labels, coverage of some twenty surfaces, point, normal, colour, shadows.
_PLAIN = 32


def require_memory(recipe: Recipe, path: Path, processes: int) -> None:
    """Raise InputError for pictures that do not fit into the memory of this machine.

    Parameters
    ----------
    recipe
        The recipe.
    path
        Its file, for the error.
    processes
        Number of processes that render on this machine.

    Raises
    ------
    InputError
        If a picture is too large. The message names the camera.
    """
    available = _memory_bytes()
    for index, camera in enumerate(recipe.camera):
        needed = processes * (_PROCESS_BYTES + _picture_bytes(recipe, camera))
        if needed > available:
            size = f"pictures of {camera.width_px} x {camera.height_px} pixels, about {needed / 1e9:.1f} GB of memory"
            hint = "Use fewer processes, or smaller pictures, fewer wavelengths, truths or boxes_per_geometry."
            at_most = f"at most the {available / 1e9:.1f} GB of this machine"
            raise InputError(f"{path}: camera[{index}]", f"{size} in {processes} processes", at_most, hint)


def _picture_bytes(recipe: Recipe, camera: CameraTable) -> float:
    """Largest memory of the pictures that a process holds by one camera."""
    pixels = camera.width_px * camera.height_px
    spectral = 2 + sum(count for name, count in _SPECTRAL.items() if name in recipe.picture.truths)
    frames = sum(len(sensor.exposures) for sensor in recipe.sensor)
    numbers = spectral * recipe.picture.wavelength_nm.size + _PLAIN + 4 * frames  # raw and developed ones
    boxes = min(MOST_BOXES, recipe.boxes_per_geometry) if pixels > STRIP_PIXELS else 1
    return float((boxes + _COPIES) * pixels * numbers * _NUMBER_BYTES)


def _memory_bytes() -> float:
    """Memory of this machine, bytes; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")
