"""Rendering down to a stated part of the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.radiometry import BandResponse
from cboxlab.render.chain import render_bands
from cboxlab.render.image import RenderedImage
from cboxlab.render.radiosity import LightField
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.progress import QUIET, Progress, share
from numpy.typing import NDArray

from .picture_cache import cached_picture

__all__ = ["BATCHES", "CONVERGENCE", "PILOT_SAMPLES", "noise_ratio", "render_to_noise"]

BATCHES = 8
PILOT_SAMPLES = 64
_MOST_SAMPLES = 8192

#: The error of scrambled Sobol' points falls as samples^-0.7 in these scenes (measured: docs/measurements.md).
CONVERGENCE = 0.7


def noise_ratio(rendered: xr.Dataset, sensor_variance: NDArray, used: NDArray) -> float:
    """Median over used pixels and bands of the render's standard deviation over the sensor's."""
    return float(np.median(np.sqrt(rendered.variance.values / sensor_variance)[used]))


def render_to_noise(
    light: LightField,
    camera: Camera,
    responses: tuple[BandResponse, ...],
    sensor_variance: Callable[[NDArray], NDArray],
    usable: NDArray,
    *,
    noise: float,
    seed: int = 0,
    progress: Progress = QUIET,
    cache: Path | None = None,
) -> tuple[RenderedImage, xr.Dataset]:
    """Gather until the median ratio of the render's to the sensor's standard deviation is ``noise``.

    A pilot of few samples tells how many it takes. light : solved on WAVELENGTH_NM. sensor_variance : from
    expected signals (band, y, x) to DN^2. usable : (band, y, x) pixels that count. cache : the folder in
    which pictures are kept, None for none; it changes no bit. Returns the image and its band signals.
    """

    def rendered(samples: int, batches: int, report: Progress) -> tuple[RenderedImage, xr.Dataset]:
        image = cached_picture(cache, light, camera, samples, batches, seed, report)
        return image, render_bands(image, responses)

    image, bands = rendered(PILOT_SAMPLES, BATCHES, share(progress, 0.0, 0.0))
    ratio = noise_ratio(bands, sensor_variance(bands.signal.values), usable & (bands.mask.values == 0))
    if ratio <= noise:
        return image, bands
    wanted = PILOT_SAMPLES * (ratio / noise) ** (1 / CONVERGENCE)
    samples = int(np.clip(2 ** np.floor(np.log2(wanted)), PILOT_SAMPLES, _MOST_SAMPLES))
    expected = ratio * (PILOT_SAMPLES / samples) ** CONVERGENCE
    return rendered(samples, int(np.ceil(BATCHES * max(1.0, expected / noise) ** 2)), progress)
