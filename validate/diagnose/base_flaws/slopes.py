"""Changes of direct light on walls that lean or bulge.

A normal n that turns by a small vector t along its face changes the light that a lamp in the direction w brings by
(t . w) / (n . w), in all bands alike. A face that leans has one t everywhere. Where it bulges, t grows in proportion to
the distance from the middle of what the picture shows. A wall is a surface of one face. A body of several keeps its
form.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.rendering.perturbation import PatchTransport
from numpy.typing import NDArray

__all__ = ["MIN_FACE_PX", "slopes"]

#: Smallest cosine of incidence by which light is divided: lamps have a size.
_GRAZING = 0.1

#: Fewest pixels of a face for its slopes.
MIN_FACE_PX = 20

#: Turn of a wall that leans, radians: a millimetre over the wall of the published box.
_LEAN = 0.002

#: Turn at the border of a wall that bulges, radians: by half a millimetre in its middle.
_BULGE = 0.004


def slopes(
    direct: NDArray[np.float64],
    used: NDArray[np.bool_],
    face: NDArray[np.int64],
    transport: PatchTransport,
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Changes of the used samples by each wall's slopes, one standard deviation each.

    Parameters
    ----------
    direct
        (band, y, x) part of it that comes from the lamps without any reflection before, DN.
    used
        (band, y, x) True for the n samples.
    face
        (y, x) face that most of a pixel shows, -1 for none.
    transport
        Points that the pixels see.

    Returns
    -------
    Iterator of tuple
        Form, "slopes:lean" or "slopes:bulge", and (n,) change, DN.
    """
    order = np.argsort(transport.coverage)
    pixel = transport.pixel[order]
    position, normal = np.zeros((2, face.size, 3))
    position[pixel], normal[pixel] = transport.position[order], transport.normal[order]
    strength = transport.direct.sum(axis=0)
    lamp = np.average([each.centre for each in transport.light.lamps], axis=0, weights=np.maximum(strength, 1e-12))
    of_surface = transport.light.tracer.facet_surface
    is_wall = np.bincount(of_surface)[of_surface] == 1
    for index in np.unique(face[face >= 0]):
        where = (face == index).ravel()
        if not is_wall[index] or where.sum() < MIN_FACE_PX:
            continue
        points = position[where]
        to_lamp = lamp - points
        to_lamp /= np.maximum(np.linalg.norm(to_lamp, axis=1, keepdims=True), 1e-9)
        cosine = np.maximum(np.abs(np.sum(to_lamp * normal[where], axis=1)), _GRAZING)
        away = points - (points.min(axis=0) + points.max(axis=0)) / 2
        for along in np.linalg.svd(normal[where].mean(axis=0)[None])[2][1:]:
            turned = to_lamp @ along / cosine
            reach = away @ along / max(float(np.abs(away @ along).max()), 1e-9)
            for form, turn in (("lean", _LEAN), ("bulge", _BULGE * reach)):
                relative = np.zeros(face.size)
                relative[where] = turn * turned
                yield f"slopes:{form}", (relative.reshape(face.shape) * direct)[used]
