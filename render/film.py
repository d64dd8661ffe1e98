"""A picture from its strips: every batch row by row of kernel calls, each pixel's sums to its means."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

__all__ = ["means_by_strips"]

#: Pixels of one kernel call: enough to fill the processors, few enough for a progress bar to move.
_LANES_PER_CALL = 2**16


def means_by_strips(
    strip: Callable[[int, int, int], list[mi.Float]],
    camera: Camera,
    samples: int,
    batches: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float32]:
    """(batch, y, x, n) means over ``samples`` of what ``strip`` sums up.

    strip : from first row, number of rows and seed to n sums, a lane per pixel, counted along the rows.
    """
    rows = max(1, min(camera.height_px, _LANES_PER_CALL // camera.width_px))
    strips = []
    for batch in range(batches):
        for start in range(0, camera.height_px, rows):
            height = min(rows, camera.height_px - start)
            sums = strip(start, height, seed + 7919 * (batch + 1))
            dr.eval(sums)
            means = np.empty((height * camera.width_px, len(sums)), np.float32)
            for column, values in zip(means.T, sums, strict=True):
                np.multiply(values.numpy(), np.float32(1 / samples), out=column)
            strips.append(means)
            if progress:
                progress((batch + (start + height) / camera.height_px) / batches)
    return np.concatenate(strips).reshape(batches, camera.height_px, camera.width_px, -1)
