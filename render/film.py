"""A picture from its strips: every batch row by row of kernel calls, each pixel's sums to its means."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

__all__ = ["exposed"]

#: Pixels of one kernel call: enough to fill the processors, few enough for a progress bar to move.
_LANES_PER_CALL = 2**15


def exposed(
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
    shape = batches, camera.height_px, camera.width_px
    result = np.empty((*shape, 0), np.float32)
    for batch in range(batches):
        for start in range(0, camera.height_px, rows):
            height = min(rows, camera.height_px - start)
            sums = strip(start, height, seed + 7919 * (batch + 1))
            dr.eval(sums)
            if result.shape[-1] != len(sums):
                result = np.empty((*shape, len(sums)), np.float32)
            lanes = result[batch, start : start + height].reshape(-1, len(sums))
            for column, values in zip(lanes.T, sums, strict=True):
                np.multiply(values.numpy(), np.float32(1 / samples), out=column)
            if progress:
                progress((batch + (start + height) / camera.height_px) / batches)
    return result
