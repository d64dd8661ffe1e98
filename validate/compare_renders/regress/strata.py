"""Parts of a picture that are judged separately: surfaces, edges, lamp, border, blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.image import high_pass
from cboxlab.utils.distributions import robust_sigma
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter, median_filter, minimum_filter

from .noise import local_range
from .sides import SurfaceIndices

__all__ = ["BLOCKS", "Strata", "strata_of"]

#: Blocks along each side of the picture: small enough to show a shadow, large enough for a mean.
BLOCKS = 8
#: Percentile of the radiance above which the lamp is looked for where there is no map of surfaces.
_LAMP_PERCENTILE = 97
#: Radiance over that percentile, from which a pixel shows the lamp: paints differ less.
_LAMP_FACTOR = 4.0
#: Range of the radiance in 3 x 3 pixels over its level, from which a pixel lies at an edge: gradients are smaller.
_EDGE_STEP = 0.25
#: The same range in standard deviations of noise, which must be exceeded too.
_EDGE_SIGMAS = 8.0


@dataclass(frozen=True, eq=False)
class Strata(FrozenMappings):
    """Parts of a picture, as masks (y, x)."""

    #: Pixels with light.
    used: NDArray[np.bool_]
    #: Pixels that see the lamp, or touch one that does.
    lamp: NDArray[np.bool_]
    #: Pixels next to a step of the radiance or a change of surface, without lamp and border.
    edges: NDArray[np.bool_]
    #: The outermost pixels, without the lamp.
    border: NDArray[np.bool_]
    #: All other pixels with light.
    smooth: NDArray[np.bool_]
    #: Smooth pixels by surface; none without a map of surfaces.
    surfaces: Mapping[str, NDArray[np.bool_]]
    #: Number of each pixel's block, 0 to 63, row by row.
    block: NDArray[np.int64]
    #: Whether there is a map of surfaces.
    mapped: bool

    @property
    def body(self) -> NDArray[np.bool_]:
        """(y, x) pixels with light, without the lamp."""
        return self.used & ~self.lamp


def strata_of(
    level: NDArray[np.float64],
    surfaces: SurfaceIndices | None,
    other: NDArray[np.float64] | None = None,
    missing: NDArray[np.bool_] | None = None,
) -> Strata:
    """Parts of a picture.

    Parameters
    ----------
    level
        (y, x) radiance of the baseline, summed over wavelengths.
    surfaces
        Map of surfaces; None where unknown. Lamp and edges then follow from the radiance alone.
    other
        (y, x) radiance of the candidate: pixels count that are lit in either picture, or few samples would bias them.
    missing
        (y, x) pixels that are not numbers, which belong to no part.

    Returns
    -------
    Strata
        The parts.
    """
    used = level > 1e-9 * max(float(level.max()), 1e-300)
    if other is not None:
        used |= other > 1e-9 * max(float(level.max()), 1e-300)
    if missing is not None:
        used &= ~missing
    quiet = median_filter(level, 3, mode="nearest")
    span = local_range(level)
    edges = _sharp(quiet, span, level)
    bright = _bright(quiet, used)
    names: dict[str, NDArray[np.bool_]] = {}
    if surfaces is not None:
        index = surfaces.index
        edges = edges | (maximum_filter(index, 3) != minimum_filter(index, 3))
        if surfaces.lamp is None:
            edges = edges | (index < 0)
        else:
            bright = surfaces.lamp
    lamp = binary_dilation(bright, np.ones((3, 3)))
    if missing is not None:
        lamp &= ~missing
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


def _bright(quiet: NDArray, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(y, x) pixels so much brighter than all others that they show a lamp."""
    if not used.any():
        return np.zeros_like(used)
    return np.asarray(quiet > _LAMP_FACTOR * np.percentile(quiet[used], _LAMP_PERCENTILE))


def _sharp(quiet: NDArray, span: NDArray, level: NDArray) -> NDArray[np.bool_]:
    """(y, x) pixels next to a step of the radiance that noise does not explain."""
    scale = np.maximum(quiet, 1e-6 * max(float(quiet.max()), 1e-300))
    noise = robust_sigma(high_pass(level) / scale)
    return span > np.maximum(_EDGE_STEP, min(_EDGE_SIGMAS * noise, 1.0)) * scale
