"""A picture split into passes that differ by their random numbers: here one after another, or on many machines."""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from . import variant
from .final_gather import LightField, gather, solve_light
from .image import RenderedImage
from .integrators import render

__all__ = ["Job", "combined", "distributed", "render_pass"]

_ONE_AT_A_TIME = threading.Lock()
#: How long a scheduler may take to answer.
PATIENCE_S = 10.0


@dataclass(frozen=True, eq=False)
class Job:
    """What a pass renders. seed : of the picture; ``number`` tells passes apart, which share no random numbers.

    All passes of a picture share one radiosity solution, which goes by the picture's seed.
    """

    scene: Scene
    camera: Camera
    wavelength_nm: NDArray[np.float64]
    samples: int
    seed: int = 0
    max_bounces: int | None = None
    number: int = 0

    def numbered(self, number: int) -> Job:
        """Another pass of the same picture."""
        return replace(self, number=number)


def render_pass(job: Job, progress: Callable[[float], None] | None = None) -> RenderedImage:
    """One pass by the default estimator: an image of one batch. Repeatable on any machine."""
    with _ONE_AT_A_TIME:
        if mi.variant() is None:  # Mitsuba's variant is a thread's own
            variant.use(os.environ.get("CBOX_DEVICE", "cpu"))
        own_seed = job.seed + 7919 * job.number
        if job.scene.diffuse and variant.compiled():
            light = _light(pickle.dumps((job.scene, job.wavelength_nm, job.max_bounces, job.seed)))
            return gather(light, job.camera, job.samples, 1, own_seed, progress)
        return render(
            job.scene, job.camera, job.wavelength_nm, job.samples, 1, own_seed, job.max_bounces, progress
        )


@lru_cache(maxsize=1)
def _light(pickled: bytes) -> LightField:
    scene, wavelengths, max_bounces, seed = pickle.loads(pickled)
    return solve_light(scene, wavelengths, max_bounces, seed=seed)


def combined(images: list[RenderedImage]) -> RenderedImage:
    """All batches of passes of one picture as one image.

    Another machine's basis of spectra may differ by signs and rounding: its coefficients are brought to the first's.
    """
    first = images[0]
    parts = []
    for image in images:
        same = np.array_equal(image.spectra, first.spectra)
        change = None if same else image.spectra @ np.linalg.pinv(first.spectra)
        parts.append(image.coefficients if change is None else image.coefficients @ change)
    return replace(first, coefficients=np.concatenate(parts).astype(np.float32))


def distributed(jobs: list[Job], scheduler: str) -> Iterator[tuple[Job, RenderedImage]]:
    """The jobs with their images as they come, from the workers of a Dask scheduler (an address such as tcp://host:8786).

    Dask runs the pass of a worker that died again on another. Raises InputError where Dask is missing or no
    scheduler answers.
    """
    try:
        import distributed as dask
    except ImportError:
        raise InputError(
            "--scheduler", "no Dask here", "it installed", "pip install 'cboxlab[distributed]'"
        ) from None
    try:
        client: Any = dask.Client(scheduler, timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        raise InputError("--scheduler", f"no answer from {scheduler} ({error})", "a Dask scheduler") from None
    with client:
        futures = {client.submit(render_pass, job, pure=False): job for job in jobs}
        for future in dask.as_completed(list(futures)):
            yield futures.pop(future), future.result()
