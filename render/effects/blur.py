"""Light blurred by Gaussians, band by band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..chain import Light
from ..image import blur

__all__ = ["blurred"]


def blurred(light: Light, sigma_px: NDArray[np.float64]) -> Light:
    """Each band's light blurred by a Gaussian of ``sigma_px`` (band,). Beyond the border its pixels are repeated."""
    signal = np.stack([blur(image, sigma) for image, sigma in zip(light.signal, sigma_px, strict=True)])
    return light.with_signal(signal if light.beyond_pixels is None else signal + light.beyond_pixels(sigma_px))
