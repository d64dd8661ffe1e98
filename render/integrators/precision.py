"""Rendering to a stated relative error, in passes that can be interrupted and resumed."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
from cboxlab.utils.files import keep, kept
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.stats import t as student

from ..image import RenderedImage
from .passes import Job, combined, distributed, render_pass

__all__ = ["BATCHES", "MOST_PASSES", "fireflies", "relative_error", "render_passes", "render_to_precision"]

#: Number of passes of a picture, whose scatter gives its error.
BATCHES = 8
#: The error of scrambled Sobol' points decreases as samples^-0.7 in these scenes (measured: docs/measurements.md).
CONVERGENCE = 0.7
#: The most samples of a pass, and the most passes.
MOST_SAMPLES = 2**15
MOST_PASSES = 64


def relative_error(image: RenderedImage, percentile: float = 50.0) -> float:
    """Percentile of the relative standard error, over pixels that see surfaces and about 30 wavelengths."""
    relative = _relative_variance(image)
    known = np.isfinite(relative)
    return float(np.percentile(np.sqrt(relative[known]), percentile)) if known.any() else 0.0


def _relative_variance(image: RenderedImage) -> NDArray[np.float64]:
    """(y, x, q) of the mean at about 30 wavelengths; NaN where no surface is seen or no light."""
    every = max(1, image.wavelength_nm.size // 30)
    mean, variance = image.project(np.eye(image.wavelength_nm.size)[:, ::every])
    lit = (mean > 0) & image.sees_surfaces[..., None]
    return np.divide(variance, mean**2, out=np.full_like(mean, np.nan), where=lit)


def fireflies(image: RenderedImage) -> NDArray[np.bool_]:
    """(y, x) True where one batch differs significantly from the others: the standard error is then too small.

    Tests each batch's radiance, summed over wavelengths, against the mean and scatter of the others (Student's t; in
    one picture of a thousand there is a false alarm). All False with fewer than three batches.
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
    limit = student.isf(0.5e-3 / values.size, count - 2)
    # allows for rounding errors
    scale = np.sqrt(variance * count / (count - 1)) + 1e-6 * np.abs(others)
    return np.asarray((np.abs(values - others) > limit * scale).any(axis=0))


def render_to_precision(
    pilot: Job,
    error: float,
    *,
    progress: Progress = NO_PROGRESS,
    percentile: float = 50.0,
    checkpoint: Path | None = None,
    scheduler: str | None = None,
) -> RenderedImage:
    """Render until a percentile (default: the median) of the pixels' relative standard errors is at most ``error``.

    pilot : the picture's first pass with few samples. BATCHES such passes determine the samples of as many proper ones,
    in each pixel those that its own error asks for, between those of the median pixel and of the percentile's; if the
    passes do not suffice, more follow, up to MOST_PASSES. checkpoint : a file that keeps finished passes; a later call
    with the same arguments resumes from it. The caller removes it. scheduler : address of a Dask scheduler, whose
    workers share the passes.
    """
    progress.stage("rendering a pilot")
    rough = render_passes(pilot, BATCHES, share(progress, 0.0, 0.0))
    found = relative_error(rough, percentile)
    if found <= error:
        progress.part(1.0)
        return rough
    wanted = pilot.samples * (found / error) ** (1 / CONVERGENCE)
    samples = int(min(2 ** np.ceil(np.log2(wanted)), MOST_SAMPLES))
    job = replace(pilot, samples=samples, halvings=_halvings(rough, percentile, samples // pilot.samples))
    passes = _read(checkpoint, job, rough)
    total = max(BATCHES, len(passes))
    progress.part(len(passes) / total)
    progress.stage("rendering")
    while True:
        numbers = range(pilot.number, pilot.number + total)
        jobs = [job.numbered(number) for number in numbers if number not in passes]
        done = _passes(jobs, progress, total) if scheduler is None else distributed(jobs, scheduler)
        for one, image in done:
            passes[one.number] = image
            _write(checkpoint, job, passes)
            progress.part(len(passes) / total)
        result = combined([passes[number] for number in sorted(passes)])
        reached = relative_error(result, percentile)
        if reached <= error or total >= MOST_PASSES:
            return result
        total = int(min(max(total + 1, np.ceil(total * (reached / error) ** 2)), MOST_PASSES))


def _halvings(rough: RenderedImage, percentile: float, most: int) -> NDArray[np.uint8] | None:
    """How many times fewer samples than the percentile's a pixel needs, by halves, at most ``most``; None if nowhere.

    A pixel's error in the pilot is the larger one of its own and of the rms about it: few batches tell it roughly.
    """
    relative = _relative_variance(rough)
    known = np.isfinite(relative)
    own = np.where(known, relative, 0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
    seen = np.asarray(known.any(axis=-1))
    around = uniform_filter(own, 3) / np.maximum(uniform_filter(seen.astype(float), 3), 1e-9)
    error = np.sqrt(np.where(seen, np.maximum(own, around), 0))
    if not seen.any():
        return None
    middle, top = np.percentile(error[seen], [50.0, max(percentile, 50.0)])
    if not middle < top:
        return None
    fewer = np.clip((top / np.clip(error, middle, top)) ** (1 / CONVERGENCE), 1, most)
    return np.floor(np.log2(fewer)).astype(np.uint8)


def render_passes(first: Job, count: int, progress: Progress = NO_PROGRESS) -> RenderedImage:
    """The picture that ``count`` passes make up, from the first on."""
    jobs = [first.numbered(first.number + number) for number in range(count)]
    return combined([image for _, image in _passes(jobs, progress, count)])


def _passes(jobs: list[Job], progress: Progress, total: int) -> Iterator[tuple[Job, RenderedImage]]:
    """The jobs, the last of ``total``, with their images, rendered here one after another."""
    for number, job in enumerate(jobs, total - len(jobs)):
        yield job, render_pass(job, share(progress, number / total, (number + 1) / total))


def _key(job: Job) -> str:
    return hashlib.sha256(pickle.dumps(job)).hexdigest()


def _read(checkpoint: Path | None, job: Job, like: RenderedImage) -> dict[int, RenderedImage]:
    """The finished passes of this picture by number; empty if the file is missing, damaged or of another picture."""
    stored = None if checkpoint is None else kept(checkpoint, _key(job))
    if stored is None:
        return {}
    with np.load(BytesIO(stored), allow_pickle=False) as content:
        parts = zip(content["numbers"], content["coefficients"], content["spectra"], strict=True)
        return {int(n): replace(like, coefficients=c[None], spectra=s) for n, c, s in parts}


def _write(checkpoint: Path | None, job: Job, passes: dict[int, RenderedImage]) -> None:
    if checkpoint is None:
        return
    stream = BytesIO()
    np.savez(
        stream,
        numbers=list(passes),
        coefficients=[p.coefficients[0] for p in passes.values()],
        spectra=[p.spectra for p in passes.values()],
    )
    keep(checkpoint, _key(job), stream.getvalue())
