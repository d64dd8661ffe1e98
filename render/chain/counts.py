"""The raw frames of a capture as they are expected, without noise and rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Counts"]


@dataclass(frozen=True, eq=False)
class Counts:
    """What the counts stage changes: the expected raw frames, and what is known of their taking.

    scene, flat, reference : (band, y, x) DN, dark and flat field included, not clipped.
    dark_scene, dark_flat, dark_reference : (band,) DN, the dark frames' level at these exposures.
    exposure_scene, exposure_flat, exposure_reference : (band,) s. minutes : (band,) from the first frame's
    beginning to the middle of the band's frames. full_scale : DN.
    """

    bands: tuple[str, ...]
    scene: NDArray[np.float64]
    flat: NDArray[np.float64]
    reference: NDArray[np.float64]
    dark_scene: NDArray[np.float64]
    dark_flat: NDArray[np.float64]
    dark_reference: NDArray[np.float64]
    exposure_scene: NDArray[np.float64]
    exposure_flat: NDArray[np.float64]
    exposure_reference: NDArray[np.float64]
    minutes: NDArray[np.float64]
    full_scale: float
