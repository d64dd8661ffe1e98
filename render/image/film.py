"""Assembly of an image from kernel calls on strips of pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.progress import NO_PROGRESS, Progress, checkpoint
from numpy.typing import NDArray

from ..device import device_array, dr, lanes_per_call, mi
from .render_job import BATCH_SEED_STEP, RenderJob

__all__ = ["means_by_strips"]

#: Largest number of lanes of one kernel call, pixels times batches: enough to occupy all processors and to outweigh the
#: time of recording a kernel; few enough for regular progress reports.
_LANES_PER_CALL = 2**16
#: Order of rows: every 16th row, then those below them, and so on. Each thread then has rows from all parts of the
#: image, and all threads take similar times.
_ROWS_APART = 16


def means_by_strips(
    strip: Callable[[mi.UInt32, int, mi.UInt32], list[mi.Float]],
    job: RenderJob,
    progress: Progress = NO_PROGRESS,
) -> NDArray[np.float32]:
    """Means over samples of the sums that a kernel accumulates.

    Parameters
    ----------
    strip
        Kernel. It takes the pixel of each lane (counted along the rows), the number of samples, and the seed of each
        lane. It returns n sums over the samples of each lane.
    job
        Camera, samples, batches and seed.
    progress
        Receives the completed share of all samples after each kernel call.

    Returns
    -------
    NDArray
        (batch, y, x, n) float32 means.
    """
    camera, batches = job.camera, job.batches
    calls = _calls(camera, job.samples, batches)
    total_samples = sum(lane_samples * len(pixels) for lane_samples, pixels, _ in calls)
    done_samples = 0
    pictures = np.empty((batches, camera.height_px * camera.width_px, 0), np.float32)
    for lane_samples, pixels, batch in calls:
        seeds = (job.batch_seed + BATCH_SEED_STEP * (batch + 1)) % 2**32
        sums = strip(device_array(mi.UInt32, pixels), lane_samples, device_array(mi.UInt32, seeds))
        share = dr.opaque(mi.Float, 1 / lane_samples)
        means = dr.zeros(mi.Float, len(pixels) * len(sums))
        first = dr.arange(mi.UInt32, len(pixels)) * len(sums)
        for k, values in enumerate(sums):
            dr.scatter(means, values * share, first + k, mode=dr.ReduceMode.NoConflicts)
        if not pictures.size:
            pictures = np.empty((*pictures.shape[:2], len(sums)), np.float32)
        pictures[batch, pixels] = means.numpy().reshape(len(pixels), len(sums))
        done_samples += lane_samples * len(pixels)
        progress.part(done_samples / total_samples)
    dr.flush_malloc_cache()  # what the strips took
    checkpoint()
    return pictures.reshape(batches, camera.height_px, camera.width_px, -1)


def _calls(
    camera: Camera, samples: int | NDArray[np.integer], batches: int
) -> list[tuple[int, NDArray[np.int64], NDArray[np.int64]]]:
    """Kernel calls: their samples, and for each lane the pixel and the batch.

    Pixels of one call have the same number of samples, and several batches share a call if they fit into it.
    """
    rows = np.argsort(np.arange(camera.height_px) % _ROWS_APART, kind="stable")
    pixels = (rows[:, None] * camera.width_px + np.arange(camera.width_px)).ravel()
    pixel_samples = np.broadcast_to(samples, (camera.height_px, camera.width_px)).ravel()[pixels]
    calls = []
    for count in np.unique(pixel_samples):
        alike = pixels[pixel_samples == count]
        lanes = lanes_per_call(int(count), _LANES_PER_CALL)
        for part in np.array_split(alike, -(-len(alike) // lanes)):
            for start in range(0, batches, lanes // len(part)):
                together = np.arange(start, min(start + lanes // len(part), batches))
                calls.append((int(count), np.tile(part, len(together)), np.repeat(together, len(part))))
    return calls
