"""Images of a capture, one per band, with their variance and a mask of excluded pixels."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntFlag

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

__all__ = ["Mask", "band_images"]


class Mask(IntFlag):
    """Reasons for excluding a pixel; 0 means it is used."""

    SATURATED = 1
    LAMP = 2
    DEAD = 4
    HOT = 8
    VIGNETTED = 16
    OTHER_CHANNEL = 32
    EXCLUDED = 64

    @property
    def is_defect(self) -> bool:
        """False for the pixels of a mosaic's other channels, which are left out by design."""
        return Mask.OTHER_CHANNEL not in self


def band_images(
    bands: Sequence[str], signal: ArrayLike, variance: ArrayLike, mask: ArrayLike | None = None
) -> xr.Dataset:
    """Dataset of band images with dimensions (band, y, x).

    Parameters
    ----------
    bands
        Identifiers of the bands, which become the coordinate ``band``.
    signal
        (band, y, x) signal after dark and flat correction, at the band's exposure, DN.
    variance
        (band, y, x) variance of the independent noise of each pixel, DN^2.
    mask
        (band, y, x) ``Mask`` flags, uint8; 0 (every pixel is used) where left out.

    Returns
    -------
    Dataset
        Variables ``signal``, ``variance`` and ``mask`` with their units.

    Raises
    ------
    ValueError
        If the shapes differ or do not fit the number of bands.
    """
    signal = np.asarray(signal, np.float64)
    variance = np.asarray(variance, np.float64)
    flags = np.zeros(signal.shape, np.uint8) if mask is None else np.asarray(mask, np.uint8)
    if not (signal.shape == variance.shape == flags.shape) or signal.ndim != 3 or len(bands) != signal.shape[0]:
        raise ValueError(
            f"band images need equal (band, y, x) shapes, got {signal.shape}, {variance.shape}, {flags.shape}"
        )
    dims = ("band", "y", "x")
    return xr.Dataset(
        {
            "signal": (dims, signal, {"units": "DN"}),
            "variance": (dims, variance, {"units": "DN^2"}),
            "mask": (dims, flags, {"flags": ", ".join(f"{m.name}={m.value}" for m in Mask)}),
        },
        coords={"band": list(bands)},
    )
