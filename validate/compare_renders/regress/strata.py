"""The parts of a picture that are judged on their own: surfaces, edges, lamp, image border, a grid of blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.image import high_pass
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter, median_filter, minimum_filter

from .noise import local_range
from .sides import SurfaceMap

__all__ = ["BLOCKS", "Strata", "strata_of"]

#: Blocks along each side of the picture.
BLOCKS = 8
#: Brighter than the 97th percentile by so much is the lamp, where no surface map tells.
_LAMP_FACTOR = 4.0
#: A pixel whose neighbourhood spans this part of its level, and so many standard deviations, lies at an edge.
_EDGE_STEP, _EDGE_SIGMA = 0.25, 8.0


@dataclass(frozen=True, eq=False)
class Strata(OwnMappings):
    """Masks (y, x). used : shows anything. lamp : sees the lamp, or touches a pixel that does. edges, border, smooth
    : parts of the rest. surfaces : by name, away from edges. block : (y, x) number of the block, 0 to 63.
    """

    used: NDArray[np.bool_]
    lamp: NDArray[np.bool_]
    edges: NDArray[np.bool_]
    border: NDArray[np.bool_]
    smooth: NDArray[np.bool_]
    surfaces: Mapping[str, NDArray[np.bool_]]
    block: NDArray[np.int64]
    mapped: bool

    @property
    def body(self) -> NDArray[np.bool_]:
        """(y, x) everything but the lamp and what shows nothing."""
        return self.used & ~self.lamp


def strata_of(level: NDArray[np.float64], surfaces: SurfaceMap | None) -> Strata:
    """level : (y, x) radiance summed over wavelengths, of the baseline."""
    used = level > 1e-9 * max(float(level.max()), 1e-300)
    quiet = median_filter(level, 3, mode="nearest")
    span = local_range(level)
    edges = _sharp(quiet, span, level)
    if surfaces is None:
        bright = quiet > _LAMP_FACTOR * np.percentile(quiet[used], 97) if used.any() else np.zeros_like(used)
        names: dict[str, NDArray[np.bool_]] = {}
    else:
        bright = surfaces.lamp
        index = surfaces.index
        edges = edges | (maximum_filter(index, 3) != minimum_filter(index, 3))
    lamp = binary_dilation(bright, np.ones((3, 3)))
    border = np.zeros(level.shape, bool)
    border[[0, -1], :] = border[:, [0, -1]] = True
    smooth = used & ~lamp & ~edges & ~border
    if surfaces is not None:
        names = {n: (index == i) & smooth for i, n in enumerate(surfaces.names) if ((index == i) & smooth).any()}
    rows, columns = (np.arange(size) * BLOCKS // size for size in level.shape)
    block = rows[:, None] * BLOCKS + columns
    return Strata(
        used, lamp, used & ~lamp & edges & ~border, border & used & ~lamp, smooth, names, block, surfaces is not None
    )


def _sharp(quiet: NDArray, span: NDArray, level: NDArray) -> NDArray[np.bool_]:
    """(y, x) next to a step of the radiance that noise does not explain."""
    scale = np.maximum(quiet, 1e-6 * max(float(quiet.max()), 1e-300))
    noise = 1.4826 * np.median(np.abs(high_pass(level) / scale))
    return span > np.maximum(_EDGE_STEP, min(_EDGE_SIGMA * noise, 1.0)) * scale
