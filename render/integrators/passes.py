"""Images rendered one batch at a time ("passes"), in sequence or on several machines."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress

from ..device import variant
from ..image import RenderedImage, RenderJob
from ..radiosity import LightField, gather, solve_light
from .choice import render_image

__all__ = ["TIMEOUT_S", "combined", "distributed", "render_pass"]

#: Held by the pass that is rendered: the threads of a worker render one after another.
_RENDER_LOCK = threading.Lock()
#: Time that a scheduler has to answer, s.
TIMEOUT_S = 10.0


def render_pass(job: RenderJob, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """Image of a job by the default integrator, with the radiosity solution kept for others.

    Parameters
    ----------
    job
        The image to render, usually of one batch. Jobs that differ in camera, samples and batches alone share the last
        radiosity solution.
    progress
        Receives the completed share of this job.

    Returns
    -------
    RenderedImage
        The same image as that of `render_image`, on any machine.
    """
    with _RENDER_LOCK:
        if job.scene.diffuse and variant.compiled():
            light = _light(pickle.dumps((job.scene, job.wavelength_nm, job.max_bounces, job.seed)))
            return gather(light, job.camera, job.samples, job.batches, job.batch_seed, progress)
        return render_image(job, progress=progress)


@lru_cache(maxsize=1)
def _light(pickled: bytes) -> LightField:
    """Radiosity solution for a pickled scene, wavelengths, limit of bounces and seed.

    They are pickled since bytes compare by value.
    """
    scene, wavelengths, max_bounces, seed = pickle.loads(pickled)
    return solve_light(scene, wavelengths, max_bounces, seed=seed)


def combined(images: list[RenderedImage]) -> RenderedImage:
    """One image of all batches of the passes of one picture.

    The spectral basis of another machine may differ by signs and rounding. Coefficients c of basis S are then
    converted to the first image's basis S0 by least squares, c S S0^+ (pseudoinverse).

    Parameters
    ----------
    images
        Images of the same scene, camera and wavelengths, at least one.

    Returns
    -------
    RenderedImage
        Image with the batches of all images in their order, and everything else of the first.
    """
    first = images[0]
    parts = []
    for image in images:
        same = np.array_equal(image.spectra, first.spectra)
        change = None if same else image.spectra @ np.linalg.pinv(first.spectra)
        parts.append(image.coefficients if change is None else image.coefficients @ change)
    return replace(first, coefficients=np.concatenate(parts, dtype=np.float32))


def distributed(jobs: list[RenderJob], scheduler: str) -> Iterator[tuple[RenderJob, RenderedImage]]:
    """Render jobs on the workers of a Dask scheduler.

    The scheduler repeats the jobs of a failed worker on another one.

    Parameters
    ----------
    jobs
        The passes to render.
    scheduler
        Address such as ``tcp://host:8786``.

    Yields
    ------
    tuple[RenderJob, RenderedImage]
        Each job with its image, in order of completion.

    Raises
    ------
    InputError
        If Dask is not installed or no scheduler answers.
    """
    try:
        import distributed as dask
    except ImportError:
        raise InputError("scheduler", "Dask is not installed", "Dask", "pip install 'cboxlab[distributed]'") from None
    try:
        client: Any = dask.Client(scheduler, timeout=TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise InputError("scheduler", f"no answer from {scheduler} ({error})", "a Dask scheduler") from None
    with client:
        futures = {client.submit(render_pass, job, pure=False): job for job in jobs}
        for future in dask.as_completed(list(futures)):
            yield futures.pop(future), future.result()
