"""Flat calibration targets: subpixel positions of their points in an image.

``rows`` and ``columns`` count the located points: the disks of a circle grid, the inner corners of a chessboard or
ChArUco board (which has one more square each way).
"""

from __future__ import annotations

import cv2
import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = ["KINDS", "TargetView", "detect_target"]

#: Kinds of flat targets: the values of `kind` of a `[[target]]` table.
KINDS = ("chessboard", "circles", "charuco")

#: Points of a flat target (n, 3), z = 0, in mm, and their image positions (n, 2), pixel (u, v).
TargetView = tuple[NDArray[np.float64], NDArray[np.float64]]

#: Width of a ChArUco board's markers relative to its squares, which the format does not state. It only predicts
#: where corners are searched: values from 0.6 to 0.8 find the same corners.
MARKER_SHARE = 0.75

#: Smallest area of a disk, in pixels.
SMALLEST_DISK_PX = 12


def detect_target(
    image: NDArray[np.floating] | NDArray[np.integer],
    kind: str,
    rows: int,
    columns: int,
    pitch_mm: float,
    source: str = "target image",
) -> TargetView:
    """Points of a flat target and their image positions.

    A symmetric pattern has no origin: its axes may differ by 180 degrees between images.

    The centroid of a disk's image differs from the image of its centre: for a disk of radius r at distance d, tilted by
    the angle t, by about focal_length_px (r / d)^2 sin t (Heikkila & Silven 1997).

    Parameters
    ----------
    image
        (y, x) linear image in any unit; of a mosaic, one channel (the caller converts its pixel positions).
    kind
        One of KINDS.
    rows, columns
        Number of points down and across, at least two each.
    pitch_mm
        Distance of neighbouring points, mm.
    source
        Name of the image in messages.

    Returns
    -------
    TargetView
        Positions on the target (n, 3), mm, and in the image (n, 2), px. n is rows times columns, or fewer for a partly
        visible ChArUco board.

    Raises
    ------
    InputError
        If the pattern is not in view completely; a ChArUco board needs six corners. Also for an unknown kind, an
        invalid grid or an image that is not (y, x) and finite.
    """
    if kind not in KINDS:
        raise InputError(f"{source}: target.kind", f"'{kind}'", f"one of {', '.join(KINDS)}")
    if rows < 2 or columns < 2 or not pitch_mm > 0:
        raise InputError(
            f"{source}: target",
            f"{rows} x {columns} at {pitch_mm:g} mm",
            "at least two rows and columns, a pitch above 0",
        )
    values = np.asarray(image, np.float64)
    if values.ndim != 2 or not np.all(np.isfinite(values)):
        raise InputError(source, f"an image of shape {values.shape}", "a finite image (y, x) of one channel")
    grid = np.stack([*np.meshgrid(np.arange(columns), np.arange(rows)), np.zeros((rows, columns))], -1)
    object_mm: NDArray[np.float64] = pitch_mm * grid.reshape(-1, 3).astype(np.float64)
    if kind == "charuco":
        numbers, corners = _charuco(_eight_bit(values), rows, columns)
        object_mm = object_mm[numbers]
    elif kind == "chessboard":
        corners = _chessboard(values, rows, columns)
    else:
        corners = _circles(values, rows, columns)
    if len(corners) < (6 if kind == "charuco" else rows * columns):
        raise InputError(
            source,
            f"no {kind} of {rows} x {columns} points",
            "the whole target in view, sharp",
            "rows and columns count disks, or the inner corners between squares",
        )
    return object_mm, corners


def _eight_bit(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(y, x) image scaled from the 0.5th to the 99.5th percentile, which ignores hot pixels."""
    low, high = np.percentile(values, [0.5, 99.5])
    return np.round(255 * np.clip((values - low) / max(high - low, 1e-30), 0, 1)).astype(np.uint8)


def _chessboard(values: NDArray[np.float64], rows: int, columns: int) -> NDArray[np.float64]:
    """(n, 2) corners by OpenCV's sector detector, refined from the gradients around them."""
    succeeded, corners = cv2.findChessboardCornersSB(
        _eight_bit(values), (columns, rows), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    if not succeeded:
        return np.empty((0, 2))
    grid = np.asarray(corners).reshape(rows, columns, 2)
    spacing = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
    half = max(2, int(0.3 * spacing))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    refined = cv2.cornerSubPix(values.astype(np.float32), np.asarray(corners), (half, half), (-1, -1), stop)
    return np.asarray(refined).reshape(-1, 2).astype(np.float64)


def _charuco(image: NDArray[np.uint8], rows: int, columns: int) -> tuple[NDArray[np.int_], NDArray[np.float64]]:
    """Indices and positions of the corners, for the dictionary and layout that detect the most."""
    best: tuple[NDArray[np.int_], NDArray[np.float64]] = np.empty(0, int), np.empty((0, 2))
    for name in ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000"):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        if cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)[1] is None:
            continue
        for legacy in (False, True):
            board = cv2.aruco.CharucoBoard((columns + 1, rows + 1), 1.0, MARKER_SHARE, dictionary)
            board.setLegacyPattern(legacy)
            corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
            if corners is not None and len(corners) > len(best[1]):
                best = np.asarray(numbers).ravel().astype(int), np.asarray(corners, float).reshape(-1, 2)
    return best


def _circles(values: NDArray[np.float64], rows: int, columns: int) -> NDArray[np.float64]:
    """(n, 2) centres of dark disks on white, or white on dark, in the order of the grid."""
    for signed in (values, -values):
        centres = _disk_centres(signed)
        if len(centres) < rows * columns:
            continue
        for method in (0, cv2.CALIB_CB_CLUSTERING):
            # Without a detector, the first argument is a list of centres, which OpenCV's type hints omit.
            succeeded, ordered = cv2.findCirclesGrid(  # type: ignore[call-overload]
                centres.astype(np.float32).reshape(-1, 1, 2),
                (columns, rows),
                cv2.CALIB_CB_SYMMETRIC_GRID | method,
                None,
                cv2.CirclesGridFinderParameters(),
            )
            if succeeded:
                # Use only the order from OpenCV: its positions are rounded to single precision (1e-5 px).
                distances = np.linalg.norm(ordered.reshape(-1, 1, 2) - centres[None], axis=2)
                return centres[np.argmin(distances, axis=1)]
    return np.empty((0, 2))


def _disk_centres(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) centroids of the dark disks in the image, without those cut by the edge."""
    smooth = cv2.GaussianBlur(_eight_bit(values), (0, 0), 1.0)
    # Morphological closing removes dark regions smaller than its kernel: the shaded background remains.
    kernel = np.ones((min(values.shape) // 3,) * 2, np.uint8)
    background = np.maximum(cv2.morphologyEx(smooth, cv2.MORPH_CLOSE, kernel), 1)
    relative = smooth / background
    # Half way between disks and background; Otsu's threshold needs disks that fill much of the image.
    dark = (relative < (np.percentile(relative, 0.5) + np.median(relative)) / 2).astype(np.uint8)
    labels, boxes = (np.asarray(table) for table in cv2.connectedComponentsWithStats(dark)[1:3])
    x, y, width, height, area = boxes.T
    uncut = (x > 0) & (y > 0) & (x + width < values.shape[1]) & (y + height < values.shape[0])
    # An ellipse parallel to its bounding box fills pi / 4 of it; a slanted one fills a different share.
    filled = area / (np.pi / 4 * width * height)
    disks = np.flatnonzero(uncut & (area >= SMALLEST_DISK_PX) & (filled > 0.7) & (filled < 1.25))
    disks = disks[disks > 0]
    if disks.size == 0:
        return np.empty((0, 2))
    alike = np.abs(np.log(area[disks] / np.median(area[disks]))) < np.log(3)
    return np.array([_centroid(values, labels, boxes[disk], disk) for disk in disks[alike]])


def _centroid(values: NDArray[np.float64], labels: NDArray, box: NDArray, label: int) -> NDArray[np.float64]:
    """(u, v) centroid of one disk, weighted by the difference of each pixel from the background.

    The background is a plane fitted to the ring around the disk, so that shading causes no bias. The weights extend
    beyond the blurred edge and are not clipped, so that noise causes no bias either.
    """
    x, y, width, height = box[:4]
    edge = max(2, round(0.15 * max(width, height)))
    ring = 2 * edge
    window = (
        slice(max(y - ring, 0), min(y + height + ring, values.shape[0])),
        slice(max(x - ring, 0), min(x + width + ring, values.shape[1])),
    )
    disk = (labels[window] == label).astype(np.uint8)
    others = ((labels[window] > 0) & (labels[window] != label)).astype(np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * edge + 1, 2 * edge + 1))
    inside = cv2.dilate(disk, kernel) > 0
    background = ~inside & (cv2.dilate(others, kernel) == 0)
    v, u = np.mgrid[window]
    terms = np.stack([np.ones(u.shape), u - x, v - y], -1)
    plane = np.linalg.lstsq(terms[background], values[window][background], rcond=None)[0]
    expected = terms @ plane
    weights = (expected - values[window])[inside]
    if expected.min() > 0:
        # Shading is multiplicative: divide by the background, so that it does not weight the disk.
        weights /= expected[inside]
    return np.array([np.average(u[inside], weights=weights), np.average(v[inside], weights=weights)])
