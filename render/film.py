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
#: Lanes take every 16th row, then those below them, and so on: each thread's share of a call has rows from all of the
#: picture, and takes as long as another's.
_ROWS_APART = 16


def means_by_strips(
    strip: Callable[[mi.UInt32, int], list[mi.Float]],
    camera: Camera,
    samples: int,
    batches: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float32]:
    """(batch, y, x, n) means over ``samples`` of what ``strip`` sums up.

    strip : from pixels, counted along the rows, and a seed to n sums, a lane per pixel.
    """
    order = np.argsort(np.arange(camera.height_px) % _ROWS_APART, kind="stable")
    calls = np.array_split(order, -(-camera.height_px * camera.width_px // _LANES_PER_CALL))
    columns = np.arange(camera.width_px)
    pictures: list[NDArray[np.float32]] = []
    for batch in range(batches):
        for done, rows in enumerate(calls, 1):
            pixels = (rows[:, None] * camera.width_px + columns).astype(np.uint32).ravel()
            sums = strip(mi.UInt32(pixels), seed + 7919 * (batch + 1))
            dr.eval(sums)
            if done == 1:
                pictures.append(np.empty((camera.height_px, camera.width_px, len(sums)), np.float32))
            for mean, values in zip(np.moveaxis(pictures[batch], -1, 0), sums, strict=True):
                mean[rows] = values.numpy().reshape(len(rows), -1) * np.float32(1 / samples)
            if progress:
                progress((batch + done / len(calls)) / batches)
    return np.stack(pictures)
