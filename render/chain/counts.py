"""The raw frames of a capture as they are expected, without noise and rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["Counts", "with_charge_moved"]


@dataclass(frozen=True, eq=False)
class Counts:
    """Value of the counts stage: the expected raw frames, and their exposures.

    Behind a mosaic the frames are interleaved: a band's frame shows all channels, each in its pixels.
    """

    #: Names of the bands.
    bands: tuple[str, ...]
    #: (band, y, x) frames of the scene, DN, with dark level and flat field, not clipped.
    scene: NDArray[np.float64]
    #: (band, y, x) flat frames, DN, with dark level, not clipped.
    flat: NDArray[np.float64]
    #: (band, y, x) reference frames, DN, with dark level and flat field, not clipped.
    reference: NDArray[np.float64]
    #: (band,) level of dark frames at the exposure of the scene, DN.
    dark_scene: NDArray[np.float64]
    #: (band,) level of dark frames at the exposure of the flats, DN.
    dark_flat: NDArray[np.float64]
    #: (band,) level of dark frames at the exposure of the reference, DN.
    dark_reference: NDArray[np.float64]
    #: (band,) exposure of the scene, s.
    exposure_scene: NDArray[np.float64]
    #: (band,) exposure of the flats, s.
    exposure_flat: NDArray[np.float64]
    #: (band,) exposure of the reference, s.
    exposure_reference: NDArray[np.float64]
    #: (band,) time from the first frame's beginning to the middle of the band's frames, min.
    minutes: NDArray[np.float64]
    #: Largest count, DN.
    full_scale: float


def with_charge_moved(counts: Counts, moved: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Counts:
    """Counts whose charge moves between pixels, in all kinds of frames alike.

    Parameters
    ----------
    counts
        The counts before.
    moved
        Change of (band, y, x) frames above dark, DN, by these frames.

    Returns
    -------
    Counts
        The counts after.
    """

    def after(frames: NDArray[np.float64], dark: NDArray[np.float64]) -> NDArray[np.float64]:
        return frames + moved(frames - dark[:, None, None])

    return replace(
        counts,
        scene=after(counts.scene, counts.dark_scene),
        flat=after(counts.flat, counts.dark_flat),
        reference=after(counts.reference, counts.dark_reference),
    )
