"""Rendering down to a stated part of the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import BandResponse
from cboxlab.rendering.chain import render_bands
from cboxlab.rendering.image import RenderedImage
from cboxlab.utils.progress import NO_PROGRESS, Progress, share
from numpy.typing import NDArray

__all__ = ["BATCHES", "CONVERGENCE", "PILOT_SAMPLES", "Picture", "noise_ratio", "render_to_noise"]

#: Makes a picture on WAVELENGTH_NM of so many samples a batch, so many batches, and tells how far it is.
Picture = Callable[[int, int, Progress], RenderedImage]

BATCHES = 8
PILOT_SAMPLES = 64
_MOST_SAMPLES = 8192

#: The error of scrambled Sobol' points falls as samples^-0.7 in these scenes (measured: docs/measurements.md).
CONVERGENCE = 0.7


def noise_ratio(rendered: xr.Dataset, sensor_variance: NDArray, used: NDArray) -> float:
    """Median over used pixels and bands with light of the render's standard deviation over the sensor's."""
    lit = used & (rendered.signal.values > 0)
    if not lit.any():
        return 0.0
    return float(np.median(np.sqrt(rendered.variance.values / sensor_variance)[lit]))


def render_to_noise(
    picture: Picture,
    responses: tuple[BandResponse, ...],
    sensor_variance: Callable[[NDArray], NDArray],
    usable: NDArray,
    *,
    noise: float,
    convergence: float,
    pilot: float | None = None,
    progress: Progress = NO_PROGRESS,
) -> tuple[RenderedImage, xr.Dataset, float]:
    """Render until the median ratio of the render's to the sensor's standard deviation is ``noise``.

    A pilot of few samples tells how many it takes. sensor_variance : from expected signals (band, y, x) to DN^2.
    usable : (band, y, x) pixels that count. convergence : the power of the samples by which the error falls.
    pilot : the ratio that a pilot reached before, of the same light from nearly the same camera; None renders one.
    Returns the image, its band signals, and the pilot's ratio.
    """

    def rendered(samples: int, batches: int, report: Progress) -> tuple[RenderedImage, xr.Dataset]:
        image = picture(samples, batches, report)
        return image, render_bands(image, responses)

    if pilot is None:
        image, bands = rendered(PILOT_SAMPLES, BATCHES, share(progress, 0.0, 0.0))
        pilot = noise_ratio(bands, sensor_variance(bands.signal.values), usable & (bands.mask.values == 0))
        if pilot <= noise:
            return image, bands, pilot
        del image, bands  # the next picture has as many batches
    wanted = PILOT_SAMPLES * (pilot / noise) ** (1 / convergence)
    samples = int(np.clip(2 ** np.floor(np.log2(wanted)), PILOT_SAMPLES, _MOST_SAMPLES))
    expected = pilot * (PILOT_SAMPLES / samples) ** convergence
    return *rendered(samples, int(np.ceil(BATCHES * max(1.0, expected / noise) ** 2)), progress), pilot
