"""Assembles a picture from kernel calls on strips of rows and divides the sums of each pixel by the samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.progress import QUIET, Progress
from numpy.typing import NDArray

from ..device import device_array, dr, mi

__all__ = ["means_by_strips"]

#: Pixels of one kernel call: enough to occupy all processors, few enough for regular progress reports.
_LANES_PER_CALL = 2**16
#: The order of rows: every 16th row, then those below them, and so on. Each thread then has rows from the whole
#: picture, and all threads take similar times.
_ROWS_APART = 16


def means_by_strips(
    strip: Callable[[mi.UInt32, int], list[mi.Float]],
    camera: Camera,
    samples: int,
    batches: int,
    seed: int,
    progress: Progress = QUIET,
) -> NDArray[np.float32]:
    """(batch, y, x, n) means over ``samples`` of the sums of ``strip``.

    strip : takes pixel indices (counted along the rows) and a seed, returns n sums with one lane per pixel.
    """
    order = np.argsort(np.arange(camera.height_px) % _ROWS_APART, kind="stable")
    calls = np.array_split(order, -(-camera.height_px * camera.width_px // _LANES_PER_CALL))
    columns = np.arange(camera.width_px)
    share = dr.opaque(mi.Float, 1 / samples)
    pictures = np.empty((batches, camera.height_px, camera.width_px, 0), np.float32)
    for batch in range(batches):
        for done, rows in enumerate(calls, 1):
            pixels = (rows[:, None] * camera.width_px + columns).ravel()
            sums = strip(device_array(mi.UInt32, pixels), seed + 7919 * (batch + 1))
            means = dr.zeros(mi.Float, len(pixels) * len(sums))
            first = dr.arange(mi.UInt32, len(pixels)) * len(sums)
            for k, values in enumerate(sums):
                dr.scatter(means, values * share, first + k, mode=dr.ReduceMode.NoConflicts)
            if not pictures.size:
                pictures = np.empty((*pictures.shape[:3], len(sums)), np.float32)
            pictures[batch, rows] = means.numpy().reshape(len(rows), -1, len(sums))
            progress.part((batch + done / len(calls)) / batches)
    dr.flush_malloc_cache()  # what the strips took
    return pictures
