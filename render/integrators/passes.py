"""A picture split into passes with different random numbers, rendered in sequence or on several machines."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from ..device import variant
from ..image import RenderedImage
from ..radiosity import LightField, gather, solve_light
from .choice import render

__all__ = ["PILOT_SAMPLES", "Job", "combined", "distributed", "render_pass"]

#: Samples of a pass of the pilot that tells how many are needed.
PILOT_SAMPLES = 64
_RENDER_LOCK = threading.Lock()
#: Time allowed for a scheduler to answer.
TIMEOUT_S = 10.0


@dataclass(frozen=True, eq=False)
class Job:
    """One pass of a picture. seed : of the picture. number : of the pass; passes share no random numbers.

    samples : of a pixel. halvings : (y, x) how many times they are halved in each; None for nowhere. All passes of a
    picture share one radiosity solution, which depends on the picture's seed.
    """

    scene: Scene
    camera: Camera
    wavelength_nm: NDArray[np.float64]
    samples: int = PILOT_SAMPLES
    seed: int = 0
    max_bounces: int | None = None
    number: int = 0
    halvings: NDArray[np.uint8] | None = None

    @property
    def samples_of_pixels(self) -> int | NDArray[np.int64]:
        """Samples of all pixels, or (y, x) of each."""
        return self.samples if self.halvings is None else self.samples >> self.halvings.astype(np.int64)

    def numbered(self, number: int) -> Job:
        """Another pass of the same picture."""
        return replace(self, number=number)


def render_pass(job: Job, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """One pass with the default integrator: an image of one batch. Repeatable on any machine."""
    with _RENDER_LOCK:
        own_seed = job.seed + 7919 * job.number
        if job.scene.diffuse and variant.compiled():
            light = _light(pickle.dumps((job.scene, job.wavelength_nm, job.max_bounces, job.seed)))
            return gather(light, job.camera, job.samples_of_pixels, 1, own_seed, progress)
        return render(
            job.scene,
            job.camera,
            job.wavelength_nm,
            job.samples_of_pixels,
            1,
            seed=own_seed,
            max_bounces=job.max_bounces,
            progress=progress,
        )


@lru_cache(maxsize=1)
def _light(pickled: bytes) -> LightField:
    scene, wavelengths, max_bounces, seed = pickle.loads(pickled)
    return solve_light(scene, wavelengths, max_bounces, seed=seed)


def combined(images: list[RenderedImage]) -> RenderedImage:
    """All batches of the passes of one picture as one image.

    The spectral basis of another machine may differ by signs and rounding: coefficients are converted to the first.
    """
    first = images[0]
    parts = []
    for image in images:
        same = np.array_equal(image.spectra, first.spectra)
        change = None if same else image.spectra @ np.linalg.pinv(first.spectra)
        parts.append(image.coefficients if change is None else image.coefficients @ change)
    return replace(first, coefficients=np.concatenate(parts, dtype=np.float32))


def distributed(jobs: list[Job], scheduler: str) -> Iterator[tuple[Job, RenderedImage]]:
    """The jobs with their images, in order of completion, from the workers of a Dask scheduler.

    scheduler : an address such as tcp://host:8786. Dask repeats the pass of a failed worker on another one. Raises
    InputError if Dask is not installed or no scheduler answers.
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
