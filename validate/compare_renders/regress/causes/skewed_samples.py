"""Bright samples cut off, or sampling that stops early."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter

from .cause import Cause, Pictures, Trial

__all__ = ["CAUSE"]

#: Pixels a side of the window in which the noise is averaged.
_WINDOW_PX = 5


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Light in proportion to the variance over the radiance is missing."""
    total = np.maximum(pictures.baseline.sum(axis=-1), 1e-3 * max(float(pictures.baseline.sum(axis=-1).mean()), 1e-300))
    relative = uniform_filter(pictures.variance / total**2, _WINDOW_PX)
    mean = float(relative.mean())
    if not mean > 0:
        return
    template = -pictures.baseline * (relative / mean)[..., None]
    yield Trial(lambda a: {"missing_at_mean_noise": float(a[0])} if a[0] > 0 else None, (template,))


CAUSE = Cause(
    "cut-samples",
    "Noisy pixels are darker: bright samples are clamped, or adaptive sampling stops early.",
    _trials,
)
