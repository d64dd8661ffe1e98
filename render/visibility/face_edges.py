"""Pixels crossed by the edge of a face, by projection.

All other pixels show one face or none.
"""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

__all__ = ["face_edges", "pixels_on_edges"]

#: Largest distance between points along an edge, px, if distortion changes lengths by less than a factor of 2.
_STEP_PX = 0.25


def face_edges(vertices: NDArray, facet: NDArray) -> NDArray[np.float64]:
    """Edges of triangles that are not between two triangles of one face.

    Parameters
    ----------
    vertices
        (t, 3, 3) corners of triangles, mm.
    facet
        (t,) flat face of each triangle.

    Returns
    -------
    NDArray
        (n, 2, 3) ends, mm.
    """
    points, corner = np.unique(vertices.reshape(-1, 3), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    ends = np.sort(np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, which, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    owners = np.repeat(facet, 3)
    low, high = np.full(len(edges), facet.max()), np.zeros(len(edges), int)
    np.minimum.at(low, which.ravel(), owners)
    np.maximum.at(high, which.ravel(), owners)
    return points[edges[(uses == 1) | (low < high)]]


def pixels_on_edges(camera: Camera, edges: NDArray) -> NDArray[np.bool_]:
    """Pixels that an edge, visible or not, crosses or nearly touches.

    Points along the projected edges are marked, with a margin of half their distance.

    Parameters
    ----------
    camera
        Camera of the image.
    edges
        (n, 2, 3) ends, mm.

    Returns
    -------
    NDArray
        (y, x) True for pixels on an edge.
    """
    ends = _clipped(camera, edges)
    flat = ends[..., :2] / ends[..., 2:]
    length_px = np.linalg.norm(flat[:, 1] - flat[:, 0], axis=-1) * camera.focal_length_px
    steps = np.ceil(2 * length_px / _STEP_PX).astype(int) + 1
    which = np.repeat(np.arange(len(ends)), steps + 1)
    along = (np.arange(len(which)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)) / steps[which]
    xy = flat[which, 0] + along[:, None] * (flat[which, 1] - flat[which, 0])
    xy = camera.at_slopes(xy)
    crossed = np.zeros((camera.height_px, camera.width_px), bool)
    for side in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        column, row = np.rint(xy + np.array(side) * _STEP_PX / 2).astype(int).T
        inside = (column >= 0) & (column < camera.width_px) & (row >= 0) & (row < camera.height_px)
        crossed[row[inside], column[inside]] = True
    return crossed


def _clipped(camera: Camera, edges: NDArray) -> NDArray[np.float64]:
    """(m, 2, 3) segments in camera coordinates, clipped to a pyramid around the field of view.

    The pyramid |x| < r_x z, |y| < r_y z contains the rays of all pixels of the border and of one more row and column on
    each side. Segments outside are left out.
    """
    local = (edges - camera.position_mm) @ camera.rotation.T
    rows, columns = (np.arange(-1, size + 1) for size in (camera.height_px, camera.width_px))
    outline = [(columns, rows[0]), (columns, rows[-1]), (columns[0], rows), (columns[-1], rows)]
    directions = np.concatenate([camera.directions(*pixels) for pixels in outline]) @ camera.rotation.T
    reach = np.nanmax(np.abs(directions[:, :2] / directions[:, 2:]), axis=0)
    inside = np.concatenate([reach * local[..., 2:] - local[..., :2], reach * local[..., 2:] + local[..., :2]], -1)
    start, end = np.moveaxis(inside, 1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start / (start - end)
    first = np.where(start < 0, crossing, 0.0).max(axis=-1)
    last = np.where(end < 0, crossing, 1.0).min(axis=-1)
    visible = first < last
    a, b = local[visible, 0], local[visible, 1]
    part = np.stack([first[visible], last[visible]], axis=-1)[..., None]
    return a[:, None] + part * (b - a)[:, None]
