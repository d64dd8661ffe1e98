"""Surveyed points: their file, and the test that their arrangement determines a camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_rows, separator_hint
from cboxlab.utils.numbers import number_of
from numpy.typing import NDArray

from ..capture import Capture

__all__ = [
    "FEWEST_POINTS",
    "SURVEY_HINT",
    "SurveyedPoints",
    "capture_points",
    "read_points",
    "require_determined",
]

#: Columns of points.csv.
COLUMNS = ("id", "x_mm", "y_mm", "z_mm", "u_px", "v_px")

#: Ten parameters, two coordinates per point: five points would leave no degrees of freedom.
FEWEST_POINTS = 6

#: Smallest thickness of a non-coplanar set of points, relative to its size.
FLATTEST = 2e-3

#: Smallest extent of the points in the image, relative to its diagonal.
SMALLEST_EXTENT = 0.1

#: Next step in messages about points that do not determine a camera.
SURVEY_HINT = "Survey more points, at several depths and spread over the whole image"


@dataclass(frozen=True, eq=False)
class SurveyedPoints:
    """Points with measured positions in the box and in the image."""

    #: n unique names.
    ids: tuple[str, ...]
    #: (n, 3) positions in the box's axes, mm.
    points_mm: NDArray[np.float64]
    #: (n, 2) positions (u, v) in the image, px.
    image_px: NDArray[np.float64]
    #: File that was read, for messages.
    source: str = "surveyed points"


def read_points(path: Path) -> SurveyedPoints:
    """Surveyed points from points.csv.

    The header is ``id,x_mm,y_mm,z_mm,u_px,v_px`` in any order; one row per point.

    Parameters
    ----------
    path
        CSV file.

    Returns
    -------
    SurveyedPoints
        All points of the file, in its order.

    Raises
    ------
    InputError
        For an unreadable file, a missing or unknown column, a cell that is not a finite number, a duplicate id, or
        fewer than six points.
    """
    lines = read_rows(path, "a CSV file of surveyed points")
    header = [name.strip() for name in lines[0][1]] if lines else []
    if sorted(header) != sorted(COLUMNS):
        missing = [name for name in COLUMNS if name not in header]
        fault = f"no column {', '.join(missing)}" if missing else f"the columns {', '.join(header)}"
        hint = separator_hint(header[0]) if header else ""
        raise InputError(path, fault, f"the columns {','.join(COLUMNS)}, each once", hint)
    ids: dict[str, None] = {}
    table = np.empty((len(lines) - 1, 5))
    for index, (number, row) in enumerate(lines[1:]):
        if len(row) != len(header):
            raise InputError(f"{path}: line {number}", f"{len(row)} cells", f"{len(header)} as in the header")
        cells = dict(zip(header, (cell.strip() for cell in row), strict=True))
        if not cells["id"] or cells["id"] in ids:
            raise InputError(
                f"{path}: line {number}, id",
                f"'{cells['id']}'" + (" again" if cells["id"] else ""),
                "a unique name",
            )
        ids[cells["id"]] = None
        for column, name in enumerate(COLUMNS[1:]):
            table[index, column] = number_of(cells[name])
            if not np.isfinite(table[index, column]):
                raise InputError(f"{path}: line {number}, {name}", f"'{cells[name]}'", "a finite number")
    points = SurveyedPoints(tuple(ids), table[:, :3], table[:, 3:], str(path))
    _require_enough(points, len(ids))
    return points


def capture_points(capture: Capture) -> SurveyedPoints | None:
    """Surveyed points of a capture, in the pixels in use.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    SurveyedPoints | None
        None without [geometry].

    Raises
    ------
    InputError
        See ``read_points``.
    """
    geometry, reduction = capture.manifest.geometry, capture.reduction
    if geometry is None:
        return None
    points = read_points(capture.folder / geometry.points)
    return points if reduction is None else replace(points, image_px=reduction.positions(points.image_px))


def _require_enough(points: SurveyedPoints, count: int) -> None:
    if count < FEWEST_POINTS:
        raise InputError(points.source, f"{count} usable points", f"at least {FEWEST_POINTS} points", SURVEY_HINT)


def require_determined(points: SurveyedPoints, in_use: NDArray[np.bool_], width_px: int, height_px: int) -> None:
    """Raise InputError if the arrangement of the points in use cannot determine a camera.

    Parameters
    ----------
    points
        Surveyed points.
    in_use
        (n,) True for the points in use.
    width_px, height_px
        Size of the image, px.

    Raises
    ------
    InputError
        For fewer than six points in use, fewer than half of all, points in one plane, or points within a small part of
        the image.
    """
    count = int(in_use.sum())
    _require_enough(points, count)
    if count < len(in_use) / 2:
        raise InputError(
            points.source,
            f"{len(in_use) - count} of {len(in_use)} points inconsistent with any camera",
            "a few outliers at most",
            "Are u and v, or the axes of the box, exchanged?",
        )
    singular = np.linalg.svd(points.points_mm[in_use] - points.points_mm[in_use].mean(0), compute_uv=False)
    if singular[2] < FLATTEST * singular[0]:
        raise InputError(
            points.source,
            f"{count} points in one plane",
            "points at several depths",
            "One view of a plane does not separate focal length from distance. " + SURVEY_HINT,
        )
    extent = float(np.linalg.norm(np.ptp(points.image_px[in_use], axis=0)))
    diagonal = float(np.hypot(width_px, height_px))
    if extent < SMALLEST_EXTENT * diagonal:
        raise InputError(
            points.source,
            f"points within {extent:.1f} px of an image of {diagonal:.0f} px diagonal",
            f"points over at least {SMALLEST_EXTENT:.0%} of the diagonal",
            SURVEY_HINT,
        )
