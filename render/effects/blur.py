"""Blur of each band by a Gaussian, shared by two effects.

Light between edges within a pixel is blurred too, if the scene behind the rendering is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..chain import Light
from ..image import blur

__all__ = ["blurred"]


def blurred(light: Light, sigma_px: NDArray[np.float64]) -> Light:
    """Light with each band blurred by a Gaussian.

    Parameters
    ----------
    light
        Light on the pixels. Beyond the border the outermost pixels are repeated.
    sigma_px
        (band,) standard deviations, px; 0 leaves a band as it is.

    Returns
    -------
    Light
        The blurred light. It includes the blur of edges within pixels where the light knows them.
    """
    signal = np.stack([blur(image, sigma) for image, sigma in zip(light.signal, sigma_px, strict=True)])
    return light.with_signal(signal if light.beyond_pixels is None else signal + light.beyond_pixels(sigma_px))
