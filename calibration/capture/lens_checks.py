"""Checks of the keys that describe the lens and boards at a stated place."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError

from .manifest import TargetTable
from .whole_manifest import Manifest

__all__ = ["lens_faults"]

#: Numbers of coefficients of a polynomial, and of a fisheye.
_COEFFICIENTS = {None: 5, "fisheye": 4}

#: Largest deviation of a unit vector's length from 1, and of the cosine between two from 0: 0.06 degrees.
_AXIS_TOLERANCE = 1e-3


def lens_faults(path: Path, manifest: Manifest) -> Iterator[InputError]:
    """Find contradictions among the keys of [lens], and in the place of boards.

    Parameters
    ----------
    path
        The capture.toml, for messages.
    manifest
        Its content.

    Yields
    ------
    InputError
        One per fault.
    """
    lens = manifest.lens
    if lens.fy_px is not None and lens.fx_px is None:
        yield InputError(f"{path}: lens.fy_px", "no fx_px with it", "both, or fx_px alone for square pixels")
    count = _COEFFICIENTS[lens.model]
    if lens.distortion is not None and len(lens.distortion) != count:
        order = "k1, k2, k3, k4 of a fisheye" if lens.model == "fisheye" else "k1, k2, p1, p2, k3"
        yield InputError(
            f"{path}: lens.distortion",
            f"{len(lens.distortion)} numbers",
            f"{count}: {order}",
            "Write 0.0 for a term that the lens does not have.",
        )
    for index, target in enumerate(manifest.target):
        yield from _place_faults(f"{path}: target[{index}]", target)


def _place_faults(where: str, target: TargetTable) -> Iterator[InputError]:
    """Missing or wrong keys of a board's place."""
    keys = {"origin_mm": target.origin_mm, "right": target.right, "down": target.down}
    present = [key for key, value in keys.items() if value is not None]
    if not present:
        return
    if target.right is None or target.down is None or target.origin_mm is None:
        missing = [key for key in keys if key not in present]
        yield InputError(where, f"{', '.join(present)} without {', '.join(missing)}", "all three, or none")
        return
    for key, axis in (("right", target.right), ("down", target.down)):
        length = float(np.linalg.norm(axis))
        if abs(length - 1) > _AXIS_TOLERANCE:
            yield InputError(f"{where}.{key}", f"a vector of length {length:.4g}", "a unit vector in the box's axes")
            return
    angle = float(np.degrees(np.arccos(np.clip(np.dot(target.right, target.down), -1, 1))))
    if abs(np.dot(target.right, target.down)) > _AXIS_TOLERANCE:
        yield InputError(
            f"{where}.down",
            f"an angle of {angle:.2f} degrees to right",
            "90 degrees",
            "Rows cross columns at right angles.",
        )
