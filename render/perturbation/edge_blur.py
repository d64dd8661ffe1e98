"""Correction for blur that acts on the light before it is integrated over pixels.

A blur of pixel values does not know where an edge lies within a pixel. At 0.2 px it changes all pixels along an edge
similarly, whereas an optical blur changes mainly the pixels whose border is close to the edge. Here the coverages of
the faces, known on a grid of subpixels, are blurred both ways; the difference, times each face's signal at its
edge, is the correction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..image import blur
from ..visibility import pixel_faces
from .warp import Warp

__all__ = ["EdgeBlur", "build_edge_blur"]

#: Subpixels across a pixel.
_ACROSS = 8

#: Camera rays across a subpixel.
_RAYS = 4

#: Pixels per call, which limits memory.
_PIXELS_PER_CALL = 1024

#: Standard deviations, px, at which coverages are blurred; in between the correction is linear in the variance. At the
#: last one it is 0.
_NODES = np.append(0.0, np.geomspace(0.03, 1.3, 22))

#: Margin of pixels around a face for its blurred coverage: five times the widest blur.
_MARGIN = 7


@dataclass(frozen=True, eq=False)
class EdgeBlur(FrozenMappings):
    """Coverages of the faces that have a visible edge, on subpixels."""

    #: The picture by faces.
    warp: Warp
    #: By index into the warp's faces: rows and columns of the blurred coverage, and the coverage there, (subpixel rows,
    #: subpixel columns), 0 to 1.
    faces: Mapping[int, tuple[slice, slice, NDArray]]
    #: Differences of coverage by index into _NODES and by face; computed when needed.
    _beyond: dict[int, dict[int, NDArray]] = field(default_factory=dict, init=False)

    def beyond_pixels(self, sigma_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signals blurred before minus after the integration over pixels.

        Parameters
        ----------
        sigma_px
            (band,) standard deviations of Gaussian blurs, px.

        Returns
        -------
        NDArray
            (band, y, x) differences, in the unit of the warp's signals.
        """
        result = np.zeros(self.warp.base.shape)
        positions = np.interp(np.square(sigma_px), _NODES**2, np.arange(len(_NODES)))
        for band, position in enumerate(positions):
            low = int(position)
            for node, share in ((low, low + 1 - position), (low + 1, position - low)):
                if share > 0 and 0 < node < len(_NODES) - 1:
                    for face, change in self._at(node).items():
                        rows, columns, _ = self.faces[face]
                        result[band, rows, columns] += share * change * self.warp.layers[face][rows, columns, band]
        return result

    def _at(self, node: int) -> dict[int, NDArray]:
        """Coverage of each face blurred on subpixels minus its coverage blurred on pixels."""
        if node not in self._beyond:
            sigma = float(_NODES[node])
            self._beyond[node] = {
                face: _pixels(blur(fine, sigma * _ACROSS)) - blur(_pixels(fine), sigma)
                for face, (_, _, fine) in self.faces.items()
            }
        return self._beyond[node]


def build_edge_blur(warp: Warp) -> EdgeBlur:
    """Coverage of the faces on the subpixels of a picture's border pixels.

    Parameters
    ----------
    warp
        The picture by faces.

    Returns
    -------
    EdgeBlur
        Coverages of the faces with a visible edge.
    """
    camera = warp.camera
    only_face = np.where(warp.coverage.any(axis=-1), warp.coverage.argmax(axis=-1), -1)
    parts = np.array_split(warp.border, len(warp.border) // _PIXELS_PER_CALL + 1)
    rays = _ACROSS * _RAYS
    ray_face = np.concatenate([pixel_faces(warp.tracer, camera, part, rays, seed) for seed, part in enumerate(parts)])
    ray_face = ray_face.reshape(-1, _ACROSS, _RAYS, _ACROSS, _RAYS).swapaxes(2, 3)
    ray_face = ray_face.reshape(-1, _ACROSS, _ACROSS, _RAYS**2)  # the rays of a subpixel together
    rows, columns = np.divmod(warp.border, camera.width_px)
    only_face[rows, columns] = -1
    coverages = {}
    for index, face in enumerate(warp.faces):
        on_border = (ray_face == face).any(axis=(1, 2, 3))
        covered = only_face == face
        covered[rows, columns] = on_border
        if not covered.any():
            continue
        down, across = (_reached(covered.any(axis=axis)) for axis in (1, 0))
        alone = (only_face == face)[down, across]
        fine = np.zeros((alone.shape[0], _ACROSS, alone.shape[1], _ACROSS), np.float32)
        fine += alone[:, None, :, None]
        shares = (ray_face[on_border] == face).mean(axis=-1, dtype=np.float32)
        fine[rows[on_border] - down.start, :, columns[on_border] - across.start, :] = shares
        coverages[index] = (down, across, fine.reshape(_ACROSS * alone.shape[0], -1))
    return EdgeBlur(warp, coverages)


def _reached(covered: NDArray[np.bool_]) -> slice:
    """Range of the places where a face is, with the margin of the widest blur."""
    indices = np.flatnonzero(covered)
    return slice(max(int(indices[0]) - _MARGIN, 0), min(int(indices[-1]) + _MARGIN + 1, len(covered)))


def _pixels(fine: NDArray) -> NDArray:
    """Means over pixels of values on subpixels."""
    height, width = (size // _ACROSS for size in fine.shape)
    return fine.reshape(height, _ACROSS, width, _ACROSS).mean(axis=(1, 3))
