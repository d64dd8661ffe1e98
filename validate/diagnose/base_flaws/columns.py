"""Changes of a picture by small flaws of the base, as columns of a linear model.

A corner that is not sharp changes the light near it, on either side. A wall or block that leans or is larger than
surveyed moves its outline and shades its faces. Paint differs slowly over a face, its table slowly over wavelength, and
the sensitivity of the sensor slowly over the picture. All are relative changes or shifts, so that their priors are the
tolerances with which a box is built.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from cboxlab.rendering.perturbation import PatchLight, PatchTransport, Warp
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.sparse import csc_array

from ...predict import sparse_columns
from .lens import soft_corners
from .paints import paints
from .parts import places_of
from .slopes import MIN_FACE_PX, slopes

__all__ = ["FlawColumns", "flaw_columns"]

#: Standard deviations over which reflected light is blurred along a soft corner, px: radii below a pixel, and above.
_BLUR_WIDTHS_PX = (0.7, 1.4)

#: Distance from a corner over which the change of one side falls by e, px.
_SIDE_PX = 0.8

#: Relative change of one side at a corner.
_SIDE_TOLERANCE = 0.02

#: Distance from a corner beyond which it no longer acts, px.
_CREASE_REACH = 5.0

#: Spread of a face's colour over bands, relative to the picture's, from which its light colours a corner.
_COLOURED = 0.1

#: Fewest neighbouring pixels by which two faces meet in the picture.
_MIN_CONTACT_PX = 4

#: Largest distance in space of the points seen by neighbouring pixels of one corner, over the mean distance of
#: neighbours within the faces: more is an outline before something behind.
_MAX_GAP = 4.0

#: Largest order of the waves over the picture.
_FIELD_ORDER = 3


@dataclass(frozen=True, eq=False)
class FlawColumns:
    """Columns of all kinds of flaws."""

    #: (k,) kind of each column, and after a colon its form; the columns of a form have one width.
    kind: NDArray[np.str_]
    #: (n, k) change of the used samples by a column at one standard deviation of its prior, over sigma.
    change: csc_array
    #: (n,) place that a sample lies in, an index of ``PLACES``.
    sample_place: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Picture:
    """Predicted picture, from which the columns are made."""

    signal: NDArray[np.float64]
    used: NDArray[np.bool_]
    face: NDArray[np.int64]
    indirect: NDArray[np.float64]
    reflectance: NDArray[np.float64]

    def level_over(self, warp: Warp) -> float:
        """Signal over that of a warp, DN."""
        return float(self.signal.sum() / max(warp.base.sum(), 1e-30))


#: Standard deviation of the columns of some kinds: edges in px, shading and field over the signal; those of all others
#: are in them already.
_TOLERANCE = {"edges": 0.05, "shading": 0.002, "field": 0.002}


def flaw_columns(
    signal: NDArray[np.float64],
    coverage: NDArray[np.float32],
    used: NDArray[np.bool_],
    sigma: NDArray[np.float64],
    warp: Warp,
    transport: PatchTransport,
    *,
    indirect: NDArray[np.float64],
    reflectance: NDArray[np.float64],
    light: PatchLight,
    blurred: NDArray[np.float64],
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
    sigma
        (n,) standard deviation of the samples, DN.
    warp
        The picture taken apart by faces.
    transport
        Points that the pixels see.
    indirect
        (band, y, x) light that arrives after reflections: its signal over the reflectance, DN.
    reflectance
        (band, y, x) reflectance of what the pixels see, 0 to 1.
    light
        Light of the picture by patch transport.
    blurred
        (band, y, x) change of the signal by a blur of ``CORNER_PX`` everywhere, DN.

    Returns
    -------
    FlawColumns
        Columns of the kinds creases, edges, shading, slopes, paints, lens and field.
    """
    face = np.where(coverage.any(axis=-1), coverage.argmax(axis=-1), -1)
    picture = _Picture(signal, used, face, indirect, reflectance)
    pairs = _meeting_faces(picture.face)
    touching = _touching(pairs, picture.face, transport)
    columns = chain(
        *(_crease(picture, *pair) for pair in touching),
        *(_edge(picture, warp, *pair) for pair in pairs),
        *(_shading(picture, face) for face in np.unique(picture.face[picture.face >= 0])),
        slopes(signal - indirect * reflectance, used, face, transport),
        paints(signal, used, light),
        soft_corners(blurred, used, warp, picture.level_over(warp)),
        _field(picture),
    )
    kinds = list[str]()

    def over_sigma() -> Iterator[NDArray[np.float64]]:
        for kind, change in columns:
            kinds.append(kind)
            yield _TOLERANCE.get(kind.partition(":")[0], 1.0) * change / sigma

    changes = sparse_columns(over_sigma(), len(sigma))
    sample_place = np.broadcast_to(places_of(picture.face, pairs, touching), used.shape)[used]
    return FlawColumns(np.array(kinds, dtype=np.str_), changes, sample_place)


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
    inside = np.concatenate([away[first == second] for first, second, away in steps])
    usual = float(np.nanmedian(inside)) if inside.size else np.inf
    touching = []
    for pair in pairs:
        across = np.concatenate(
            [
                away[((first == pair[0]) & (second == pair[1])) | ((first == pair[1]) & (second == pair[0]))]
                for first, second, away in steps
            ]
        )
        if np.nanmedian(across) < _MAX_GAP * usual:
            touching.append(pair)
    return touching


def _crease(picture: _Picture, first: int, second: int) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """(n,) changes by a soft corner of two faces.

    Reflected light is blurred along it, and either side changes by itself.
    """
    apart = [distance_transform_edt(picture.face != face) for face in (first, second)]
    both = (picture.face == first) | (picture.face == second)
    near = both & (np.maximum(*apart) < _CREASE_REACH)
    if not near.any():
        return
    for width in _BLUR_WIDTHS_PX:
        spread = (0, width, width)
        even = gaussian_filter(picture.indirect * both, spread, mode="nearest")
        even /= np.maximum(gaussian_filter(both.astype(float), width, mode="nearest"), 1e-3)
        change = np.where(near, (even - picture.indirect) * picture.reflectance, 0.0)
        yield "creases:blur", change[picture.used]
    for side, opposite, away in ((first, second, apart[1]), (second, first, apart[0])):
        falloff = np.where((picture.face == side) & (away < _CREASE_REACH), np.exp(-away / _SIDE_PX), 0.0)
        yield "creases:side", (_SIDE_TOLERANCE * falloff * picture.signal)[picture.used]
        colour = _colour(picture, opposite)
        if colour.std() > _COLOURED:
            coloured = falloff * (colour - colour.mean())[:, None, None]
            yield "creases:colour", (_SIDE_TOLERANCE * coloured * picture.signal)[picture.used]


def _colour(picture: _Picture, face: int) -> NDArray[np.float64]:
    """(band,) signal of a face over the picture's, mean 1."""
    where = picture.face == face
    level = picture.signal[:, where].mean(axis=1) / np.maximum(picture.signal.mean(axis=(1, 2)), 1e-9)
    return np.asarray(level / max(level.mean(), 1e-9))


def _edge(picture: _Picture, warp: Warp, first: int, second: int) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """(n,) changes by a shift of the border of two faces by a pixel, and by its turn."""
    index = {int(face): i for i, face in enumerate(warp.faces)}
    if first not in index or second not in index:
        return
    shares = warp.coverage[..., [first, second]]
    on_border = np.minimum(1.0, 6 * shares[..., 0] * shares[..., 1])
    rows, columns = np.nonzero(on_border)
    if not len(rows):
        return
    apart = np.stack([rows - rows.mean(), columns - columns.mean()])
    along = np.linalg.eigh(apart @ apart.T)[1][:, -1] @ apart
    position = np.zeros(on_border.shape)
    position[rows, columns] = along / max(np.abs(along).max(), 1e-9)
    step = np.moveaxis(warp.layers[index[first]] - warp.layers[index[second]], -1, 0) * on_border
    level = picture.level_over(warp)
    for part, shape in (("shift", np.ones_like(position)), ("turn", position)):
        yield f"edges:{part}", (level * shape * step)[picture.used]


def _shading(picture: _Picture, face: int) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """(n,) slow relative changes over a face, alike in all bands or rising with the band."""
    where = picture.face == face
    if where.sum() < MIN_FACE_PX:
        return
    rows, columns = np.nonzero(where)
    v, u = (2 * (x - x.mean()) / max(np.ptp(x), 1) for x in (rows, columns))
    slope = np.linspace(-1, 1, len(picture.signal))[:, None, None]
    for number, shape in enumerate((np.ones_like(u), u, v, u * u - 1 / 3, u * v, v * v - 1 / 3)):
        over_face = np.zeros(picture.face.shape)
        over_face[rows, columns] = shape
        order = 0 if number == 0 else 1 if number < 3 else 2
        yield f"shading:{order}", (over_face * picture.signal)[picture.used]
        if number < 3:
            yield "shading:colour", (over_face * slope * picture.signal)[picture.used]


def _field(picture: _Picture) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """(n,) slow relative changes over the picture, alike in all bands."""
    height, width = picture.face.shape
    v, u = (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width
    for down in range(_FIELD_ORDER + 1):
        for across in range(_FIELD_ORDER + 1):
            if down or across:
                wave = np.cos(np.pi * down * v)[:, None] * np.cos(np.pi * across * u)
                yield "field", (wave * picture.signal)[picture.used]
