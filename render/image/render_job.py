"""The arguments that all integrators share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

__all__ = ["BATCH_SEED_STEP", "RenderJob"]

#: Step between the seeds of consecutive batches: a prime, so that small seeds of pictures give no common batches.
BATCH_SEED_STEP = 7919


@dataclass(frozen=True, eq=False)
class RenderJob:
    """An image to render, for any integrator.

    The image has `batches` independent randomisations, whose scatter gives its standard error. Batch n depends on
    `seed` and n alone, so the batches of a job may be rendered one by one, in any order and on several machines.
    """

    #: Geometry, reflectances, lamps and medium.
    scene: Scene
    #: Pose, resolution and distortion.
    camera: Camera
    #: (w,) wavelengths at which reflectances and lamps are evaluated, nm; stored as float64.
    wavelength_nm: NDArray[np.float64]
    #: Samples (paths) of a pixel in one batch: one number for all pixels, or (y, x) integers.
    samples: int | NDArray[np.integer] = 256
    #: Number of batches.
    batches: int = 4
    #: Seed of the random numbers; the same job gives the same image.
    seed: int = 0
    #: Largest number of reflections between lamp and camera: 0 for the visible lamp, 1 for direct light; None for no
    #: limit.
    max_bounces: int | None = None
    #: Number of the first batch. Jobs that differ in it alone share a radiosity solution, which depends on `seed`.
    first_batch: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "wavelength_nm", np.asarray(self.wavelength_nm, float))

    @property
    def batch_seed(self) -> int:
        """Seed from which the integrators derive those of the batches.

        The i-th batch of the job, from 0, has the seed `batch_seed` + (i + 1) BATCH_SEED_STEP, modulo 2^32.
        """
        return self.seed + BATCH_SEED_STEP * self.first_batch

    def batch(self, number: int) -> RenderJob:
        """The job of one batch of the same picture.

        Parameters
        ----------
        number
            Number of the batch, counted from that of seed `seed`; it may lie outside this job's own batches.

        Returns
        -------
        RenderJob
            A job of `batches` 1 and `first_batch` `number`.
        """
        return replace(self, batches=1, first_batch=number)
