"""Cameras of a drawn box, and the reason why a draw is rejected."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from .recipe import CameraTable

__all__ = ["Rejected", "drawn_cameras"]


class Rejected(Exception):
    """A geometry that is drawn again, with the reason."""


def drawn_cameras(table: CameraTable, room: NDArray[np.float64], generator: np.random.Generator) -> dict[str, Camera]:
    """Cameras of a table by name: one, or a grid of one pose.

    Parameters
    ----------
    table
        The table.
    room
        (3,) width, height and depth of the room, mm.
    generator
        Random numbers.

    Returns
    -------
    dict
        The cameras; those of a grid have row and column in their names, from 1.

    Raises
    ------
    Rejected
        If a camera looks along the vertical, or has no rays for a corner of its picture.
    """
    left, up, distance = (d.draw(generator) for d in (table.left_mm, table.up_mm, table.distance_mm))
    position = np.array([room[0] / 2 + left, room[1] / 2 + up, -distance])
    target = room * np.array([d.draw(generator) for d in table.look_at])
    roll, field, k1 = (d.draw(generator) for d in (table.roll_deg, table.field_deg, table.k1))
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    if not right.any():
        raise Rejected("a camera looks along the vertical")
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    right, down = c * right + s * down, c * down - s * right
    cameras = {}
    for row in range(table.down):
        for column in range(table.across):
            shift = (column - (table.across - 1) / 2) * right + (row - (table.down - 1) / 2) * down
            alone = table.across == table.down == 1
            camera = Camera(
                width_px=table.width_px,
                height_px=table.height_px,
                focal_length_px=table.width_px / 2 / float(np.tan(np.radians(field) / 2)),
                principal_point_px=np.array([(table.width_px - 1) / 2, (table.height_px - 1) / 2]),
                k1=k1,
                rotation=np.array([right, down, forward]),
                position_mm=position + table.spacing_mm * shift,
            )
            if np.isnan(camera.directions([0, table.width_px - 1], [0, table.height_px - 1])).any():
                raise Rejected("a lens with k1 below 0 has no rays for the corners of its picture")
            cameras[table.name if alone else f"{table.name}-{row + 1}-{column + 1}"] = camera
    return cameras
