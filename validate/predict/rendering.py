"""Rendering until its noise is a stated share of the sensor's noise."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import BandResponse
from cboxlab.rendering.chain import render_bands
from cboxlab.rendering.image import RenderedImage
from cboxlab.utils.progress import NO_PROGRESS, Progress, checkpoint, share
from numpy.typing import NDArray

__all__ = ["BATCHES", "CONVERGENCE", "PILOT_SAMPLES", "Picture", "noise_ratio", "render_to_noise"]

_log = logging.getLogger(__name__)

#: Renders a picture on WAVELENGTH_NM: of samples per batch, first batch, number of batches, and a progress callback.
Picture = Callable[[int, int, int, Progress], RenderedImage]

#: Batches of a rendering. The relative standard deviation of a pixel's variance is then sqrt(2 / 7) = 0.53.
BATCHES = 8

#: Samples per batch of the pilot, and the fewest of any rendering.
PILOT_SAMPLES = 64

#: Most pixels of a picture that is completed by further batches: both together need twice the memory of the picture,
#: half a GB with three materials.
_MAX_COMPLETED_PIXELS = 2**16

#: Most samples per batch: bounds the time where the noise cannot be reached.
_MAX_SAMPLES = 8192

#: Most rays of a picture, in all its batches, at a target of ``_USUAL_NOISE``: half a minute of CPU time. Photographs
#: of many megapixels have so little noise that a third of it would take hours.
_MOST_RAYS = 2**28

#: Share of these rays for a picture that would need more: a diagnosis renders up to ten of them. The noise is 0.18 % of
#: a pixel among 256 x 256, next to 0.15 % by the model's own error.
_SHARE_OUT_OF_REACH = 0.5

#: Target to which ``_MOST_RAYS`` belongs: the default of the settings. The limit grows as another target requires.
_USUAL_NOISE = 0.3

#: The error of scrambled Sobol' points falls as samples^-0.7 in these scenes (benchmarks/measured/history.md).
CONVERGENCE = 0.7


def noise_ratio(rendered: xr.Dataset, sensor_variance: NDArray, used: NDArray) -> float:
    """Median ratio of the rendering's standard deviation to the sensor's.

    Parameters
    ----------
    rendered
        Band images with signal (DN) and variance (DN^2), (band, y, x).
    sensor_variance
        (band, y, x) variance of the sensor, DN^2.
    used
        (band, y, x) True for samples that count.

    Returns
    -------
    float
        Median over the samples with light; 0 without any.
    """
    bright = used & (rendered.signal.values > 0)
    if not bright.any():
        return 0.0
    return float(np.median(np.sqrt(rendered.variance.values / sensor_variance)[bright]))


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
    """Render until the ratio of the rendering's noise to the sensor's is ``noise``.

    The ratio is the median over samples. A pilot with few samples per batch determines their number, and the ratio that
    the first batches reach the number of batches. The time is bounded: the ratio stays larger where the sensor has very
    little noise.

    Parameters
    ----------
    picture
        Renders a picture.
    responses
        Responses of the bands.
    sensor_variance
        Variance of the sensor (DN^2) for expected signals (band, y, x) in DN.
    usable
        (band, y, x) True for samples that count.
    noise
        Target ratio of the standard deviations.
    convergence
        Power of the number of samples by which the error falls.
    pilot
        Ratio that an earlier pilot reached with the same light from nearly the same camera; None renders a pilot.
    progress
        Called with the completed share.

    Returns
    -------
    RenderedImage
        The picture; the pilot's if that is good enough.
    Dataset
        Its band images.
    float
        Ratio that the pilot reached.
    """

    def ratio_of(bands: xr.Dataset) -> float:
        return noise_ratio(bands, sensor_variance(bands.signal.values), usable & (bands.mask.values == 0))

    image = None
    if pilot is None:
        image = picture(PILOT_SAMPLES, 0, BATCHES, share(progress, 0.0, 0.0))
        checkpoint()
        bands = render_bands(image, responses)
        pilot = ratio_of(bands)
        if pilot <= noise:
            _log.info("pilot of %d samples is enough: %.3g of the sensor's noise", PILOT_SAMPLES, pilot)
            return image, bands, pilot
    pixels = usable[0].size
    required = PILOT_SAMPLES * (pilot / noise) ** (1 / convergence)
    most = _MOST_RAYS / pixels * (_USUAL_NOISE / noise) ** (1 / convergence)
    if BATCHES * required > most:
        most *= _SHARE_OUT_OF_REACH
    largest = max(PILOT_SAMPLES, min(_MAX_SAMPLES, most / BATCHES))
    samples = int(2 ** np.floor(np.log2(np.clip(required, PILOT_SAMPLES, largest))))

    def batches_for(ratio: float) -> int:
        return int(min(np.ceil(BATCHES * max(1.0, ratio / noise) ** 2), max(BATCHES, most // samples)))

    batches = batches_for(pilot * (PILOT_SAMPLES / samples) ** convergence)
    is_small = pixels <= _MAX_COMPLETED_PIXELS
    first = BATCHES if is_small else batches
    if image is None or (samples, first) != (PILOT_SAMPLES, BATCHES):
        image = None  # the next picture has as many batches
        image = picture(samples, 0, first, share(progress, 0.0, first / batches))
        checkpoint()
        bands = render_bands(image, responses)
    if is_small and (batches := batches_for(ratio_of(bands))) > BATCHES:
        image = _completed(image, picture(samples, BATCHES, batches - BATCHES, share(progress, BATCHES / batches, 1.0)))
        checkpoint()
        bands = render_bands(image, responses)
    _log.info("%d x %d samples per pixel, for %.3g of the sensor's noise", batches, samples, noise)
    return image, bands, pilot


def _completed(image: RenderedImage, further: RenderedImage) -> RenderedImage:
    """Image with the further batches of the same picture."""
    return replace(image, coefficients=np.concatenate([image.coefficients, further.coefficients]))
