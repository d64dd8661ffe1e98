"""Rendering to a stated relative error, in passes that can be interrupted and resumed."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
from cboxlab.utils.distributions import student_quantile
from cboxlab.utils.files import load_checked, store_checked
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from ..image import RenderedImage, RenderJob
from .passes import combined, distributed, render_pass

__all__ = [
    "BATCHES",
    "MOST_PASSES",
    "PILOT_SAMPLES",
    "fireflies",
    "relative_error",
    "relative_errors",
    "render_passes",
    "render_to_precision",
]

#: Number of passes of a picture, whose scatter gives its error.
BATCHES = 8
#: Samples of a pixel in a pass of the pilot, from which the number of samples of the proper passes is estimated.
PILOT_SAMPLES = 64
#: Exponent q of the error, which decreases as samples^-q: 0.7 for scrambled Sobol' points in these scenes (measured:
#: benchmarks/measured/history.md).
CONVERGENCE = 0.7
#: Largest number of samples of a pixel in a pass.
MOST_SAMPLES = 2**15
#: Largest number of passes of a picture.
MOST_PASSES = 64
#: Number of wavelengths at which the error is evaluated: every n-th of the image, n = max(1, w // 30).
_ERROR_WAVELENGTHS = 30
#: Probability that one image without fireflies has any marked.
_FALSE_ALARMS = 1e-3


def relative_error(image: RenderedImage, percentile: float = 50.0) -> float:
    """Percentile of the relative standard error, over pixels and wavelengths.

    Pixels that show surfaces count, at about 30 wavelengths.

    Parameters
    ----------
    image
        Image of several batches.
    percentile
        0 to 100; 50 is the median.

    Returns
    -------
    float
        Standard error of the mean over the mean; 0 for an image without light.
    """
    return relative_errors(image, (percentile,))[0]


def relative_errors(image: RenderedImage, percentiles: Sequence[float]) -> list[float]:
    """Several percentiles as of ``relative_error``, from one projection of the image.

    Parameters
    ----------
    image
        Image of several batches.
    percentiles
        0 to 100 each.

    Returns
    -------
    list of float
        Standard error of the mean over the mean at each percentile; 0 for an image without light.
    """
    relative = _relative_variance(image)
    valid = np.isfinite(relative)
    if not valid.any():
        return [0.0] * len(percentiles)
    return [float(value) for value in np.percentile(np.sqrt(relative[valid]), percentiles)]


def _relative_variance(image: RenderedImage) -> NDArray[np.float64]:
    """(y, x, q) variance of the mean over the mean's square.

    NaN where no surface is visible, or no light.
    """
    every = max(1, image.wavelength_nm.size // _ERROR_WAVELENGTHS)
    mean, variance = image.project(np.eye(image.wavelength_nm.size)[:, ::every])
    valid = (mean > 0) & image.sees_surfaces[..., None]
    return np.divide(variance, mean**2, out=np.full_like(mean, np.nan), where=valid)


def fireflies(image: RenderedImage) -> NDArray[np.bool_]:
    """Pixels with one batch that differs significantly: their standard error is too small.

    Tests the radiance of each batch, summed over wavelengths, against mean and scatter of the others by Student's t.
    The level is divided by the number of tests (Bonferroni), so one picture in a thousand has a false alarm.

    Parameters
    ----------
    image
        Image of at least three batches; with fewer, no pixel is marked.

    Returns
    -------
    NDArray
        (y, x) True for a firefly.
    """
    summed = image.spectra.sum(axis=1)
    # batch by batch, since all of them in double precision would need twice the picture's memory
    values = np.stack([batch @ summed for batch in image.coefficients])
    count = len(values)
    if count < 3:
        return np.zeros(values.shape[1:], bool)
    total, squares = values.sum(axis=0), (values**2).sum(axis=0)
    others = (total - values) / (count - 1)
    variance = np.maximum(squares - values**2 - (count - 1) * others**2, 0) / (count - 2)
    limit = student_quantile(0.5 * _FALSE_ALARMS / values.size, count - 2)
    # the second term allows for rounding errors
    scale = np.sqrt(variance * count / (count - 1)) + 1e-6 * np.abs(others)
    return np.asarray((np.abs(values - others) > limit * scale).any(axis=0))


def render_to_precision(
    job: RenderJob,
    error: float,
    *,
    progress: Progress = NO_PROGRESS,
    percentile: float = 50.0,
    checkpoint: Path | None = None,
    scheduler: str | None = None,
    pictures: int = 1,
) -> RenderedImage:
    """Render until a percentile of the pixels' relative standard errors is at most `error`.

    A pilot of BATCHES passes of PILOT_SAMPLES samples gives an error e. The proper picture has as many passes, of
    PILOT_SAMPLES (e / error)^(1 / CONVERGENCE) samples, rounded up to a power of two. Where `percentile` is above
    50, a pixel has the samples that its own error requires, between those of the median pixel and of the
    percentile's. If the passes do not suffice, more follow, up to MOST_PASSES.

    Parameters
    ----------
    job
        The image to render; its samples and number of batches do not count, they follow from the error.
    error
        Largest permitted relative standard error.
    progress
        Receives the stages "rendering with few samples" and "rendering", and the completed share of the passes.
    percentile
        Percentile over pixels and wavelengths for which `error` holds, 0 to 100; 50 is the median.
    checkpoint
        File to which each finished pass is saved. A later call with the same arguments resumes from it. The caller
        removes it. None to save nothing.
    scheduler
        Address of a Dask scheduler, whose workers share the passes; None to render in this process.
    pictures
        Number of pictures that share the rays: the job's wavelengths are those of each in turn, and `error` holds for
        every one.

    Returns
    -------
    RenderedImage
        Image with one batch per pass: the pilot's if they suffice.

    Raises
    ------
    InputError
        If no scheduler answers.
    """
    progress.stage("rendering with few samples")
    pilot = replace(job, samples=PILOT_SAMPLES, batches=BATCHES)
    rough = render_passes(pilot, share(progress, 0.0, 0.0))
    pilot_error = _largest_error(rough, percentile, pictures)
    if pilot_error <= error:
        progress.part(1.0)
        return rough
    required = PILOT_SAMPLES * (pilot_error / error) ** (1 / CONVERGENCE)
    samples = int(min(2 ** np.ceil(np.log2(required)), MOST_SAMPLES))
    halvings = _halvings(rough, percentile, samples // PILOT_SAMPLES)
    final = replace(pilot, samples=samples if halvings is None else samples >> halvings.astype(np.int32))
    passes = _read(checkpoint, final, rough)
    total = max(BATCHES, len(passes))
    progress.part(len(passes) / total)
    progress.stage("rendering")
    while True:
        numbers = range(job.first_batch, job.first_batch + total)
        jobs = [final.batch(number) for number in numbers if number not in passes]
        images = _passes(jobs, progress, total) if scheduler is None else distributed(jobs, scheduler)
        for single, image in images:
            passes[single.first_batch] = image
            _write(checkpoint, final, passes)
            progress.part(len(passes) / total)
        result = combined([passes[number] for number in sorted(passes)])
        reached = _largest_error(result, percentile, pictures)
        if reached <= error or total >= MOST_PASSES:
            return result
        total = int(min(max(total + 1, np.ceil(total * (reached / error) ** 2)), MOST_PASSES))


def _largest_error(image: RenderedImage, percentile: float, pictures: int) -> float:
    """Largest of the relative errors of pictures whose wavelengths follow one another."""
    if pictures == 1:
        return relative_error(image, percentile)
    parts = zip(np.split(image.spectra, pictures, axis=1), np.split(image.wavelength_nm, pictures), strict=True)
    return max(relative_error(replace(image, spectra=s, wavelength_nm=w), percentile) for s, w in parts)


def _halvings(rough: RenderedImage, percentile: float, most: int) -> NDArray[np.uint8] | None:
    """(y, x) number of times that a pixel's samples are halved; None if nowhere.

    The percentile's pixel has all samples. `rough` is the pilot and `most` the largest factor by which samples are
    reduced. A pixel counts with the larger of two errors in the pilot, its own and the rms of its 3 x 3 neighbourhood:
    few batches estimate its own only roughly.
    """
    relative = _relative_variance(rough)
    valid = np.isfinite(relative)
    variance = np.where(valid, relative, 0).sum(axis=-1) / np.maximum(valid.sum(axis=-1), 1)
    visible = np.asarray(valid.any(axis=-1))
    around = uniform_filter(variance, 3) / np.maximum(uniform_filter(visible.astype(float), 3), 1e-9)
    error = np.sqrt(np.where(visible, np.maximum(variance, around), 0))
    if not visible.any():
        return None
    middle, top = np.percentile(error[visible], [50.0, max(percentile, 50.0)])
    if not middle < top:
        return None
    fewer = np.clip((top / np.clip(error, middle, top)) ** (1 / CONVERGENCE), 1, most)
    return np.floor(np.log2(fewer)).astype(np.uint8)


def render_passes(job: RenderJob, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """Image of a job, each batch rendered as a pass.

    Parameters
    ----------
    job
        The image to render.
    progress
        Receives the completed share of the passes.

    Returns
    -------
    RenderedImage
        Image with the job's batches.
    """
    jobs = [job.batch(job.first_batch + number) for number in range(job.batches)]
    return combined([image for _, image in _passes(jobs, progress, job.batches)])


def _passes(jobs: list[RenderJob], progress: Progress, total: int) -> Iterator[tuple[RenderJob, RenderedImage]]:
    """The jobs with their images, rendered in this process one after another.

    They are the last of `total` passes, for the progress.
    """
    for number, job in enumerate(jobs, total - len(jobs)):
        yield job, render_pass(job, share(progress, number / total, (number + 1) / total))


def _key(job: RenderJob) -> str:
    """Key of a checkpoint: the hash of everything on which its passes depend."""
    return hashlib.sha256(pickle.dumps(job)).hexdigest()


def _read(checkpoint: Path | None, job: RenderJob, like: RenderedImage) -> dict[int, RenderedImage]:
    """Finished passes of this picture by number, from the checkpoint.

    Empty if the file is missing, damaged or of another picture. `like` is any image of the same scene and camera.
    """
    stored = None if checkpoint is None else load_checked(checkpoint, _key(job))
    if stored is None:
        return {}
    with np.load(BytesIO(stored), allow_pickle=False) as content:
        parts = zip(content["numbers"], content["coefficients"], content["spectra"], strict=True)
        return {int(n): replace(like, coefficients=c[None], spectra=s) for n, c, s in parts}


def _write(checkpoint: Path | None, job: RenderJob, passes: dict[int, RenderedImage]) -> None:
    """Save the finished passes, if there is a checkpoint."""
    if checkpoint is None:
        return
    stream = BytesIO()
    np.savez(
        stream,
        numbers=list(passes),
        coefficients=[p.coefficients[0] for p in passes.values()],
        spectra=[p.spectra for p in passes.values()],
    )
    store_checked(checkpoint, _key(job), stream.getvalue())
