"""Positions of the scene's corners in a capture's photograph, as the page marks them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.geometry import SurveyedPoints
from cboxlab.scenes import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import NDArray

from ...compare import Corner, locate_corners, scene_corners
from ...report.viewer import encoded
from .photographs import CaptureInView, add_table, load_photograph

__all__ = ["Picker"]

#: File of surveyed points in the folder of a capture.
_FILE = "points.csv"


@dataclass(frozen=True, eq=False)
class _Picture:
    """Photograph of a capture with its scene."""

    folder: Path
    photograph: NDArray[np.float64]
    scene: Scene
    corners: tuple[Corner, ...]


class Picker:
    """Marked corners of captures below a folder.

    Parameters
    ----------
    root
        Folder below which captures are opened.
    """

    def __init__(self, root: Path) -> None:
        self._pictures = CaptureInView(root, partial(_load, root))

    def picture(self, capture: str) -> dict[str, Any]:
        """Photograph and corners of a capture; its surveyed points are not needed.

        Parameters
        ----------
        capture
            Folder of the capture, below the root folder.

        Returns
        -------
        dict
            Ready for JSON.

        Raises
        ------
        InputError
            If the capture is faulty, outside the root folder, reduced, or has no scene.
        """
        picture = self._pictures.of(capture, again=True)
        height, width = picture.photograph.shape
        corners = [{"id": c.id, "name": c.name, "position_mm": c.position_mm.tolist()} for c in picture.corners]
        return {"width": width, "height": height, "photograph": encoded(picture.photograph), "corners": corners}

    def locate(self, capture: str, marks: Sequence[Any], by_edges: bool) -> dict[str, Any]:
        """Positions and residuals of marked corners, and where the camera sees the others.

        Parameters
        ----------
        capture
            Folder of the capture.
        marks
            Records with ``id`` of a corner and position ``u``, ``v``, px.
        by_edges
            Whether to refine the positions by the edges.

        Returns
        -------
        dict
            Ready for JSON.

        Raises
        ------
        InputError
            For marks of unknown corners or without a position in the picture.
        """
        picture = self._pictures.of(capture)
        points = _points(picture, marks)
        located = locate_corners(picture.photograph, picture.scene, points, by_edges=by_edges)
        residuals = [[None, None]] * len(points.ids) if located.fit is None else located.fit.residuals_px.tolist()
        expected: dict[str, list[float]] = {}
        if located.fit is not None:
            image = located.fit.camera.project(np.array([corner.position_mm for corner in picture.corners]))
            height, width = picture.photograph.shape
            inside = np.all((image > -0.5) & (image < (width - 0.5, height - 0.5)), axis=1)
            expected = {
                c.id: at.tolist() for c, at, is_inside in zip(picture.corners, image, inside, strict=True) if is_inside
            }
        return {
            "points": [
                {
                    "id": name,
                    "u": float(position[0]),
                    "v": float(position[1]),
                    "by_edges": bool(refined),
                    "error_px": None if math.isnan(sigma) else float(sigma),
                    "residual_px": residual,
                    "why": why,
                }
                for name, position, refined, sigma, residual, why in zip(
                    points.ids,
                    located.points.image_px,
                    located.by_edges,
                    located.sigma_px,
                    residuals,
                    located.reasons,
                    strict=True,
                )
            ],
            "expected": expected,
            "rms_px": None if located.fit is None else located.fit.reprojection_rms_px,
            "reason": located.reason,
        }

    def write(self, capture: str, marks: Sequence[Any]) -> dict[str, Any]:
        """Write the marked corners to points.csv and name it in capture.toml.

        An existing points.csv stays, and so does a capture.toml with a table of geometry.

        Parameters
        ----------
        capture, marks
            As of ``locate``.

        Returns
        -------
        dict
            Path of the file, the lines that capture.toml needs to use it, and whether they were added there.

        Raises
        ------
        InputError
            As of ``locate``, and if the file exists.
        """
        picture = self._pictures.of(capture)
        points = _points(picture, marks)
        path = picture.folder / _FILE
        if path.exists() or path.is_symlink():
            raise InputError(path, "a file that exists already", "no such file", "Move it away to write another one.")
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(("id", "x_mm", "y_mm", "z_mm", "u_px", "v_px"))
        for name, position_mm, image in zip(points.ids, points.points_mm, points.image_px, strict=True):
            rows.writerow((name, *(f"{value:.2f}" for value in position_mm), *(f"{value:.3f}" for value in image)))
        with replacing(path) as temporary:
            temporary.write_text(text.getvalue(), encoding="utf-8")
        lines = f'[geometry]\npoints = "{_FILE}"'
        return {
            "path": str(path),
            "lines": lines,
            "added": add_table(picture.folder / "capture.toml", "geometry", lines),
        }


def _load(root: Path, name: str) -> _Picture:
    """Photograph of a capture with its scene."""
    photograph = load_photograph(root, name, with_scene=True)
    scene = photograph.calibration.capture.scene
    if scene is None:
        raise AssertionError(name)
    return _Picture(photograph.folder, photograph.values, scene, scene_corners(scene))


def _points(picture: _Picture, marks: Sequence[Any]) -> SurveyedPoints:
    """Marked corners; InputError for others."""
    corners = {corner.id: corner for corner in picture.corners}
    positions: dict[str, tuple[float, float]] = {}
    height, width = picture.photograph.shape
    for mark in marks:
        name = mark.get("id") if isinstance(mark, Mapping) else None
        if not isinstance(name, str) or name not in corners or name in positions:
            raise InputError("points", repr(mark)[:80], "corners of the scene, each once")
        position = [mark.get(key) for key in ("u", "v")]
        numbers = [value for value in position if isinstance(value, int | float) and not isinstance(value, bool)]
        if len(numbers) != len(position):
            raise InputError(f"points, {name}", repr(position)[:80], "u and v, px")
        u, v = numbers  # an integer may be too large for a float
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            fault = ", ".join(map(str, numbers))[:80]
            raise InputError(f"points, {name}", fault, f"a position in the picture of {width} x {height} px")
        positions[name] = float(u), float(v)
    if not positions:
        raise InputError("points", "none", "at least one marked corner")
    places_mm = np.array([corners[name].position_mm for name in positions])
    return SurveyedPoints(tuple(positions), places_mm, np.array(list(positions.values())), "the marked corners")
