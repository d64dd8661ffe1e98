"""Correction for blur that acts on the light before it is integrated over pixels.

A blur of pixel values does not know where an edge lies within a pixel. At 0.2 px it changes all pixels along an edge
similarly, whereas an optical blur changes mainly the pixels whose border is close to the edge. Here the coverages of
the faces, known on a grid of subpixels, are blurred both ways; the difference, times each face's signal beside its
edge, is the correction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray

from ..image import blur
from ..visibility import pixel_faces
from .warp import Warp

__all__ = ["EdgeBlur", "build_edge_blur"]

#: Subpixels across a pixel, and camera rays across a subpixel.
_ACROSS, _RAYS = 8, 4

#: Pixels per call, which limits memory.
_PIXELS_PER_CALL = 1024

#: Standard deviations, px, at which coverages are blurred; in between the correction is linear in the variance. At the
#: last one it is 0.
_NODES = np.append(0.0, np.geomspace(0.03, 1.3, 22))

#: Margin of pixels around a face for its blurred coverage: five times the widest blur.
_MARGIN = 7


@dataclass(frozen=True, eq=False)
class EdgeBlur(OwnMappings):
    """faces : by index into the warp's faces, for each with a visible edge, the rows and columns of its blurred
    coverage, and its coverage there, (subpixel rows, subpixel columns), 0 to 1.
    """

    warp: Warp
    faces: Mapping[int, tuple[slice, slice, NDArray]]
    _beyond: dict[int, dict[int, NDArray]] = field(default_factory=dict, init=False)

    def beyond_pixels(self, sigma_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """(band, y, x) signals blurred by Gaussians of ``sigma_px`` (band,) before minus after pixel integration."""
        result = np.zeros(self.warp.base.shape)
        places = np.interp(np.square(sigma_px), _NODES**2, np.arange(len(_NODES)))
        for band, place in enumerate(places):
            low = int(place)
            for node, share in ((low, low + 1 - place), (low + 1, place - low)):
                if share > 0 and 0 < node < len(_NODES) - 1:
                    for face, change in self._at(node).items():
                        rows, columns, _ = self.faces[face]
                        result[band, rows, columns] += share * change * self.warp.layers[face][rows, columns, band]
        return result

    def _at(self, node: int) -> dict[int, NDArray]:
        """For each face, its coverage blurred on subpixels minus its coverage blurred on pixels."""
        if node not in self._beyond:
            sigma = float(_NODES[node])
            self._beyond[node] = {
                face: _pixels(blur(fine, sigma * _ACROSS)) - blur(_pixels(fine), sigma)
                for face, (_, _, fine) in self.faces.items()
            }
        return self._beyond[node]


def build_edge_blur(warp: Warp) -> EdgeBlur:
    """Find the coverage of the faces on the subpixels of a picture's border pixels."""
    camera = warp.camera
    whole = np.where(warp.coverage.any(axis=-1), warp.coverage.argmax(axis=-1), -1)
    parts = np.array_split(warp.border, len(warp.border) // _PIXELS_PER_CALL + 1)
    rays = _ACROSS * _RAYS
    seen = np.concatenate([pixel_faces(warp.tracer, camera, part, rays, seed) for seed, part in enumerate(parts)])
    seen = seen.reshape(-1, _ACROSS, _RAYS, _ACROSS, _RAYS).swapaxes(2, 3)
    seen = seen.reshape(-1, _ACROSS, _ACROSS, _RAYS**2)  # the rays of a subpixel together
    rows, columns = np.divmod(warp.border, camera.width_px)
    whole[rows, columns] = -1
    found = {}
    for index, face in enumerate(warp.faces):
        own = (seen == face).any(axis=(1, 2, 3))
        here = whole == face
        here[rows, columns] = own
        if not here.any():
            continue
        down, across = (_reached(here.any(axis=axis)) for axis in (1, 0))
        alone = (whole == face)[down, across]
        fine = np.zeros((alone.shape[0], _ACROSS, alone.shape[1], _ACROSS), np.float32)
        fine += alone[:, None, :, None]
        shares = (seen[own] == face).mean(axis=-1, dtype=np.float32)
        fine[rows[own] - down.start, :, columns[own] - across.start, :] = shares
        found[index] = (down, across, fine.reshape(_ACROSS * alone.shape[0], -1))
    return EdgeBlur(warp, found)


def _reached(here: NDArray[np.bool_]) -> slice:
    places = np.flatnonzero(here)
    return slice(max(int(places[0]) - _MARGIN, 0), min(int(places[-1]) + _MARGIN + 1, len(here)))


def _pixels(fine: NDArray) -> NDArray:
    height, width = (size // _ACROSS for size in fine.shape)
    return fine.reshape(height, _ACROSS, width, _ACROSS).mean(axis=(1, 3))
