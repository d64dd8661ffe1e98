"""Changes of a picture by small flaws of the base, as columns of a linear model.

A corner that is not sharp changes the light near it, on either side. A wall or block that leans or is larger than
surveyed moves its outline and shades its faces. Paint differs slowly over a face, and the sensitivity of the sensor
slowly over the picture. All are relative changes or shifts, so that their priors are the tolerances with which a box
is built.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.perturbation import PatchTransport, Warp
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

__all__ = ["FlawColumns", "flaw_columns"]

#: Distances from a corner over which its softness changes the light, px: a radius below a pixel, and what it reflects.
_CREASE_WIDTHS_PX = (0.7, 1.6)

#: Pixels of a face beyond which a corner no longer acts, in widths.
_CREASE_REACH = 4.0

#: Fewest neighbouring pixels by which two faces meet in the picture.
_MIN_CONTACT_PX = 4

#: Fewest pixels of a face for fields over it.
_MIN_FACE_PX = 20

#: Largest distance in space of the points seen by neighbouring pixels of one corner, over the mean distance of
#: neighbours within the faces: more is an outline before something behind.
_MAX_GAP = 4.0

#: Largest order of the waves over the picture.
_FIELD_ORDER = 3


@dataclass(frozen=True, eq=False)
class FlawColumns:
    """Columns of all kinds of flaws."""

    #: (k,) kind of each column.
    kind: NDArray[np.str_]
    #: (k, n) change of the used samples by each column at one standard deviation of its prior, DN.
    change: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Picture:
    """What the columns are made of."""

    signal: NDArray[np.float64]
    coverage: NDArray[np.float32]
    used: NDArray[np.bool_]
    face: NDArray[np.int64]


#: Standard deviation of each kind's columns: creases and shading relative to the signal, edges in px, field relative.
TOLERANCE = {"creases": 0.02, "edges": 0.05, "shading": 0.002, "field": 0.002}


def flaw_columns(
    signal: NDArray[np.float64],
    coverage: NDArray[np.float32],
    used: NDArray[np.bool_],
    warp: Warp,
    transport: PatchTransport,
) -> FlawColumns:
    """Columns of the flaws that a picture may show.

    Parameters
    ----------
    signal
        (band, y, x) predicted signal, DN.
    coverage
        (y, x, face) share of each pixel that a face covers, 0 to 1.
    used
        (band, y, x) True for the n samples.
    warp
        The picture taken apart by faces.
    transport
        Points that the pixels see.

    Returns
    -------
    FlawColumns
        Of the kinds creases, edges, shading and field.
    """
    picture = _Picture(signal, coverage, used, np.where(coverage.any(axis=-1), coverage.argmax(axis=-1), -1))
    pairs = _meeting_faces(picture.face)
    touching = _touching(pairs, picture.face, transport)
    kinds, columns = [], []
    for kind, change in (
        *(("creases", c) for pair in touching for c in _crease(picture, *pair)),
        *(("edges", c) for pair in pairs for c in _edge(picture, warp, *pair)),
        *(("shading", c) for face in np.unique(picture.face[picture.face >= 0]) for c in _shading(picture, face)),
        *(("field", c) for c in _field(picture)),
    ):
        kinds.append(kind)
        columns.append((TOLERANCE[kind] * change).astype(np.float32))
    return FlawColumns(np.array(kinds), np.array(columns, np.float32).reshape(len(columns), int(used.sum())))


def _meeting_faces(face: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Pairs of faces that meet in the picture along a few pixels."""
    across = [(face[:, 1:], face[:, :-1]), (face[1:], face[:-1])]
    meeting = np.concatenate([np.sort(np.stack([a[a != b], b[a != b]], axis=1), axis=1) for a, b in across])
    meeting = meeting[(meeting >= 0).all(axis=1)]
    if not len(meeting):
        return []
    pairs, count = np.unique(meeting, axis=0, return_counts=True)
    return [(int(a), int(b)) for (a, b), number in zip(pairs, count, strict=True) if number >= _MIN_CONTACT_PX]


def _touching(
    pairs: list[tuple[int, int]], face: NDArray[np.int64], transport: PatchTransport
) -> list[tuple[int, int]]:
    """Those pairs whose neighbouring pixels see points close in space: corners, not outlines."""
    position = np.full((face.size, 3), np.nan)
    order = np.argsort(transport.coverage)
    position[transport.pixel[order]] = transport.position[order]
    points = position.reshape(*face.shape, 3)
    steps = [
        (face[:, 1:], face[:, :-1], np.linalg.norm(points[:, 1:] - points[:, :-1], axis=-1)),
        (face[1:], face[:-1], np.linalg.norm(points[1:] - points[:-1], axis=-1)),
    ]
    inside = np.concatenate([away[one == other] for one, other, away in steps])
    usual = float(np.nanmedian(inside)) if inside.size else np.inf
    found = []
    for pair in pairs:
        across = np.concatenate(
            [
                away[((one == pair[0]) & (other == pair[1])) | ((one == pair[1]) & (other == pair[0]))]
                for one, other, away in steps
            ]
        )
        if np.nanmedian(across) < _MAX_GAP * usual:
            found.append(pair)
    return found


def _crease(picture: _Picture, one: int, other: int) -> Iterator[NDArray[np.float64]]:
    """(n,) changes by a soft corner of two faces, on either side of it, alike in all bands or in the other's colour."""
    for side, opposite in ((one, other), (other, one)):
        away = distance_transform_edt(picture.face != opposite)
        for width in _CREASE_WIDTHS_PX:
            near = np.where((picture.face == side) & (away < _CREASE_REACH * width), np.exp(-away / width), 0.0)
            if not near.any():
                continue
            yield (near * picture.signal)[picture.used]
        colour = _colour(picture, opposite)
        if colour.std() > 0.1:
            near = np.where(picture.face == side, np.exp(-away / _CREASE_WIDTHS_PX[-1]), 0.0)
            yield (near * (colour - colour.mean())[:, None, None] * picture.signal)[picture.used]


def _colour(picture: _Picture, face: int) -> NDArray[np.float64]:
    """(band,) signal of a face over the picture's, mean 1."""
    where = picture.face == face
    level = picture.signal[:, where].mean(axis=1) / np.maximum(picture.signal.mean(axis=(1, 2)), 1e-9)
    return np.asarray(level / max(level.mean(), 1e-9))


def _edge(picture: _Picture, warp: Warp, one: int, other: int) -> Iterator[NDArray[np.float64]]:
    """(n,) changes by a shift of the border of two faces by a pixel, and by its turn."""
    index = {int(face): i for i, face in enumerate(warp.faces)}
    if one not in index or other not in index:
        return
    shares = warp.coverage[..., [one, other]]
    on_border = np.minimum(1.0, 6 * shares[..., 0] * shares[..., 1])
    rows, columns = np.nonzero(on_border)
    if len(rows) < _MIN_CONTACT_PX:
        return
    apart = np.stack([rows - rows.mean(), columns - columns.mean()])
    along = np.linalg.eigh(apart @ apart.T)[1][:, -1] @ apart
    place = np.zeros(on_border.shape)
    place[rows, columns] = along / max(np.abs(along).max(), 1e-9)
    step = np.moveaxis(warp.layers[index[one]] - warp.layers[index[other]], -1, 0) * on_border
    level = picture.signal.sum() / max(warp.base.sum(), 1e-30)
    for shape in (np.ones_like(place), place):
        yield (level * shape * step)[picture.used]


def _shading(picture: _Picture, face: int) -> Iterator[NDArray[np.float64]]:
    """(n,) slow relative changes over a face, alike in all bands or rising with the band."""
    where = picture.face == face
    if where.sum() < _MIN_FACE_PX:
        return
    rows, columns = np.nonzero(where)
    v, u = (2 * (x - x.mean()) / max(np.ptp(x), 1) for x in (rows, columns))
    slope = np.linspace(-1, 1, len(picture.signal))[:, None, None]
    for number, shape in enumerate((np.ones_like(u), u, v, u * u - 1 / 3, u * v, v * v - 1 / 3)):
        over_face = np.zeros(picture.face.shape)
        over_face[rows, columns] = shape
        yield (over_face * picture.signal)[picture.used]
        if number < 3:
            yield (over_face * slope * picture.signal)[picture.used]


def _field(picture: _Picture) -> Iterator[NDArray[np.float64]]:
    """(n,) slow relative changes over the picture, alike in all bands."""
    height, width = picture.face.shape
    v, u = (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width
    for down in range(_FIELD_ORDER + 1):
        for across in range(_FIELD_ORDER + 1):
            if down or across:
                wave = np.cos(np.pi * down * v)[:, None] * np.cos(np.pi * across * u)
                yield (wave * picture.signal)[picture.used]
