"""Assembles a picture from kernel calls on strips of pixels and divides the sums of each pixel by its samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from .render_job import BATCH_SEED_STEP, RenderJob

__all__ = ["means_by_strips"]

#: Lanes of one kernel call, pixels times batches: enough to occupy all processors and to outweigh the time that
#: recording a kernel takes; few enough for regular progress reports.
_LANES_PER_CALL = 2**16
#: The order of rows: every 16th row, then those below them, and so on. Each thread then has rows from the whole
#: picture, and all threads take similar times.
_ROWS_APART = 16


def means_by_strips(
    strip: Callable[[mi.UInt32, int, mi.UInt32], list[mi.Float]],
    job: RenderJob,
    progress: Progress = NO_PROGRESS,
) -> NDArray[np.float32]:
    """(batch, y, x, n) means over samples of the sums of ``strip``.

    strip : takes the pixel of each lane (counted along the rows), samples, and the seed of each lane; returns n sums.
    samples : of all pixels, or (y, x) of each.
    """
    camera, batches = job.camera, job.batches
    calls = _calls(camera, job.samples, batches)
    whole = sum(own * len(pixels) for own, pixels, _ in calls)
    done = 0
    pictures = np.empty((batches, camera.height_px * camera.width_px, 0), np.float32)
    for own, pixels, batch in calls:
        seeds = (job.batch_seed + BATCH_SEED_STEP * (batch + 1)) % 2**32
        sums = strip(device_array(mi.UInt32, pixels), own, device_array(mi.UInt32, seeds))
        share = dr.opaque(mi.Float, 1 / own)
        means = dr.zeros(mi.Float, len(pixels) * len(sums))
        first = dr.arange(mi.UInt32, len(pixels)) * len(sums)
        for k, values in enumerate(sums):
            dr.scatter(means, values * share, first + k, mode=dr.ReduceMode.NoConflicts)
        if not pictures.size:
            pictures = np.empty((*pictures.shape[:2], len(sums)), np.float32)
        pictures[batch, pixels] = means.numpy().reshape(len(pixels), len(sums))
        done += own * len(pixels)
        progress.part(done / whole)
    dr.flush_malloc_cache()  # what the strips took
    return pictures.reshape(batches, camera.height_px, camera.width_px, -1)


def _calls(
    camera: Camera, samples: int | NDArray[np.integer], batches: int
) -> list[tuple[int, NDArray[np.int64], NDArray[np.int64]]]:
    """Of each kernel call: samples, and of each lane the pixel and the batch."""
    rows = np.argsort(np.arange(camera.height_px) % _ROWS_APART, kind="stable")
    pixels = (rows[:, None] * camera.width_px + np.arange(camera.width_px)).ravel()
    own = np.broadcast_to(samples, (camera.height_px, camera.width_px)).ravel()[pixels]
    calls = []
    for count in np.unique(own):
        alike = pixels[own == count]
        for part in np.array_split(alike, -(-len(alike) // _LANES_PER_CALL)):
            for start in range(0, batches, _LANES_PER_CALL // len(part)):
                together = np.arange(start, min(start + _LANES_PER_CALL // len(part), batches))
                calls.append((int(count), np.tile(part, len(together)), np.repeat(together, len(part))))
    return calls
