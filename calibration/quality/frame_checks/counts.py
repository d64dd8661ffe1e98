"""Checks of the counts: saturation, gaps, and levels relative to full scale, dark and black."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ...capture import Capture, channel_mask
from ...correction import ROUNDING_VARIANCE, DarkLibrary, NoiseModel, VarianceSamples, samples_of_repeats
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_black_levels", "check_counts", "check_level_of_darks"]

#: Fewest pixels at the largest count of a table that are a saturation.
FEWEST_PILED_PIXELS = 12

#: Smallest ratio of the pixels at the largest count to the mean of the counts below it.
PILE_RATIO = 12.0

#: Number of counts below the largest one that it is compared with.
PILE_NEIGHBOURS = 20

#: Smallest ratio of the number of different counts to that expected from a smooth histogram.
SMALLEST_CODE_SHARE = 0.6

#: Fewest counts of a histogram in which gaps can be detected.
FEWEST_CODES = 25

#: Window by which a histogram is smoothed, DN.
SMOOTHING_DN = 65

#: Largest share of saturated pixels by kind of frame: photographs show the lamp, fields are even.
LARGEST_SATURATED_SHARE = {"band": 0.3, "flat": 0.1, "reference": 0.1}

#: Frames show no light if their bright pixels exceed the dark level by less than this many standard deviations.
NO_LIGHT_SIGMAS = 3

#: The same, in addition, as a share of the dark level.
NO_LIGHT_SHARE = 0.02

#: Dark level over the standard deviation of reading, below which frames cannot be darker than it.
LOWEST_LEVEL_SIGMAS = 10

#: Smallest suspicious error of a stated black level, DN: levels of files are whole counts.
SMALLEST_BLACK_ERROR_DN = 2.0

#: The same over the level: counts that bend by 6 % at full scale imitate a tenth of it.
SMALLEST_BLACK_ERROR_SHARE = 0.12

#: The same in standard deviations: chance exceeds it in one of a million channels.
BLACK_ERROR_SIGMAS = 5.0

#: Most pixels of a table whose variance is used: more would be slow.
MOST_BLACK_PIXELS = 100_000

#: Rounds of the fit of variance against counts; it changes by less than a hundredth of its sigma in the last ones.
BLACK_ROUNDS = 12

#: Variance of a pixel over the expected one beyond which it is a cosmic ray: 5.5 standard deviations of one difference.
LARGEST_VARIANCE_RATIO = 30.0

#: Pixels of similar light whose mean variance bounds the expected one: it has an error of a tenth.
SIMILAR_PIXELS = 200

#: Smallest expected variance over that mean: a line that falls below it would have all the weight.
LOWEST_SHARE_OF_SIMILAR = 0.5

#: Standard deviation of the bending of counts at full scale: sensors are linear within 1 to 3 %.
USUAL_BENDING = 0.03

#: Variance at the black level over that of the stated read noise, below which the level is too low: half the noise.
LOWEST_START_SHARE = 0.25

#: Frames are darker than the dark frames if their dark pixels lack this share of the dark level.
DARKER_SHARE = 0.5


def check_counts(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Check saturation, gaps between counts, and levels relative to full scale and dark.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        The capture's noise of reading.

    Yields
    ------
    Suspicion
        One for a saturation, one for gaps, one for each table without light or with too much of it.
    """
    yield from _check_codes(capture, stacks)
    yield from _check_levels(capture, stacks, dark, noise)


def _check_codes(capture: Capture, stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Saturation below full scale, and gaps between the counts that occur."""
    full = capture.full_scale_dn
    subtracted = isinstance(capture.manifest.dark, str)  # full scale less each pixel's own dark level
    piled, stepped = [], []
    step, most_codes = 0, 0
    for stack in stacks:
        if stack.kind == "dark":
            continue
        histogram = np.bincount(stack.counts.ravel())
        occurring = np.flatnonzero(histogram)
        step, most_codes = int(np.gcd.reduce(occurring, initial=step)), max(most_codes, occurring.size)
        top = histogram.size - 1
        if top < full and not subtracted and _piled_pixels(histogram):
            piled.append((stack, top, _piled_pixels(histogram)))
        codes, expected = _different_counts(histogram)
        if expected > FEWEST_CODES and codes < SMALLEST_CODE_SHARE * expected:
            stepped.append((stack, codes, expected))
    is_shifted = step > 1 and most_codes > FEWEST_CODES
    if is_shifted:
        piled = [(stack, top, pixels) for stack, top, pixels in piled if top <= full - step]
        yield Suspicion(
            f"all counts are multiples of {step}: counts of fewer bits, moved to the upper ones",
            "camera.bit_depth",
            f"Divide them by {step}, and state the bits of the rest; gain and read noise are then the camera's own.",
        )
    if piled:
        stack, top, pixels = piled[0]
        yield Suspicion(
            "saturation below full scale: a wrong bit depth, clipped or rescaled frames",
            "camera.bit_depth" if len(piled) > len(stacks) / 4 else f"{stack.key}.frames",
            f"{pixels} pixels of {stack.key} have exactly {top} DN and none more (so in {len(piled)} tables); full "
            f"scale is {full} DN.",
        )
    if stepped and not is_shifted:
        stack, codes, expected = stepped[0]
        yield Suspicion(
            "counts have gaps: frames were rescaled, gamma-encoded or reduced in bits",
            f"{stack.key}.frames",
            f"Only {codes:.0f} different counts occur where {expected:.0f} are expected (so in {len(stepped)} tables).",
        )


def _piled_pixels(histogram: NDArray[np.int64]) -> int:
    """Number of pixels at the largest count; 0 if the histogram is continuous there."""
    top = int(np.flatnonzero(histogram)[-1])
    near = histogram[max(top - PILE_NEIGHBOURS, 0) : top]
    expected = float(near.mean()) if near.size else 0.0
    return int(histogram[top]) if histogram[top] > max(FEWEST_PILED_PIXELS, PILE_RATIO * expected) else 0


def _different_counts(histogram: NDArray[np.int64]) -> tuple[float, float]:
    """Number of different counts in the darker half of the pixels: measured and expected.

    A smooth histogram has the expected number.
    """
    share = np.cumsum(histogram) / histogram.sum()
    low, high = np.searchsorted(share, [0.02, 0.5])
    part = histogram[low : high + 1].astype(float)
    if part.size < FEWEST_CODES:
        return 0.0, 0.0
    density = uniform_filter1d(part, min(SMOOTHING_DN, part.size), mode="nearest")
    return float(np.count_nonzero(part)), float(np.sum(1 - np.exp(-density)))


def _check_levels(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Levels of the frames relative to saturation and dark level."""
    full = capture.saturation_dn
    sigma = float(np.sqrt(noise.floor_dn2))
    for stack in stacks:
        if stack.kind in ("dark", "bracket"):
            continue
        saturated = float(np.mean(stack.counts >= full))
        is_bracketed = stack.kind == "band" and stack.band is not None and bool(capture.brackets(stack.band))
        if not is_bracketed and saturated > LARGEST_SATURATED_SHARE[stack.kind]:
            yield Suspicion(
                f"the {stack.kind} frames are overexposed",
                f"{stack.key}.frames",
                f"{saturated:.0%} of the pixels are saturated.",
            )
        level = stack.thinned(dark.at(stack.exposure_s))
        net = stack.mean - level
        if np.percentile(net, 99) < NO_LIGHT_SIGMAS * sigma + NO_LIGHT_SHARE * abs(float(np.median(level))):
            yield Suspicion(
                f"the {stack.kind} frames show no light (lens cap on, or dark frames)",
                f"{stack.key}.frames",
                f"99 of 100 pixels lie within {np.percentile(net, 99):.2g} DN of the dark level of "
                f"{np.median(level):.4g} DN.",
            )


def check_level_of_darks(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Detect frames that are darker than the dark frames.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        The capture's noise of reading.

    Yields
    ------
    Suspicion
        At most one.
    """
    sigma = float(np.sqrt(noise.floor_dn2))
    below = []
    for stack in stacks:
        if stack.kind in ("dark", "bracket"):
            continue
        level = stack.thinned(dark.at(stack.exposure_s))
        lowest, middle = float(np.percentile(stack.mean - level, 0.5)), float(np.median(level))
        if middle > LOWEST_LEVEL_SIGMAS * sigma and lowest < -DARKER_SHARE * middle:
            below.append((stack, lowest, middle))
    if below:
        stack, lowest, middle = below[0]
        yield Suspicion(
            "frames are darker than the dark frames: the dark was subtracted before, or the dark frames hold light",
            f"{stack.key}.frames" if len(below) == 1 else "dark",
            f"A part of {stack.key} is {-lowest:.0f} DN below the dark level of {middle:.0f} DN (so in {len(below)} "
            "tables).",
        )


def check_black_levels(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Detect a stated black level that does not suit the noise, by photon transfer.

    The variance between repeats increases with the light. Extended to the stated black level it must be that of
    reading, the same in all channels, and not negative. A curve that all channels share allows for counts that bend.

    Parameters
    ----------
    capture
        A capture; with dark frames, which measure the level, nothing is checked.
    stacks
        All its frames.
    dark
        The stated black level.
    noise
        Gain and read noise by its frames.

    Yields
    ------
    Suspicion
        At most one: for the channel that deviates most, or for a level of all that is too low.
    """
    if dark.exposure_s.size or capture.manifest.camera.black_level_dn is None or noise.shot_dn <= 0:
        return
    samples = _variances(capture, stacks, dark, noise)
    if not samples:
        return
    starts, covariance, slope = _starts(list(samples.values()), noise, capture.full_scale_dn)
    if not slope > 0:
        return
    smallest = max(SMALLEST_BLACK_ERROR_DN, SMALLEST_BLACK_ERROR_SHARE * float(np.median(dark.bias)))
    weight = 1 / np.diag(covariance)
    errors = []
    for index, channel in enumerate(samples):
        contrast = np.delete(weight, index) / max(np.delete(weight, index).sum(), 1e-300)
        contrast = np.insert(contrast, index, -1.0)
        error, sigma = float(contrast @ starts) / slope, float(np.sqrt(contrast @ covariance @ contrast)) / slope
        errors.append((abs(error) / sigma, error, sigma, channel))
    largest, error, sigma, channel = max(errors)
    key, record = "camera.black_level_dn", "Photograph with the lens covered: such frames are its [[dark]]."
    if len(samples) > 1 and largest > BLACK_ERROR_SIGMAS and abs(error) > smallest:
        yield Suspicion(
            f"the black level of {channel} is too {'low' if error > 0 else 'high'}",
            f"{key} ({channel})",
            f"By its noise, compared with that of the other channels, it is {-error:+.3g} +- {sigma:.2g} DN from the "
            f"right one. {record}",
        )
        return
    camera, common = capture.manifest.camera, weight / weight.sum()
    read_dn = (camera.read_noise_e or 0.0) / (camera.gain_e_per_dn or np.inf)
    start, sigma = float(common @ starts), float(np.sqrt(common @ covariance @ common))
    lacking = read_dn**2 + ROUNDING_VARIANCE - start
    if start < LOWEST_START_SHARE * read_dn**2 and lacking > BLACK_ERROR_SIGMAS * sigma and lacking / slope > smallest:
        yield Suspicion(
            "the black level is too low",
            key,
            f"By the noise of the counts it is {-lacking / slope:.3g} +- {sigma / slope:.2g} DN from the right one, if "
            f"reading has the stated noise. {record}",
        )


def _variances(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> dict[str, list[VarianceSamples]]:
    """Variances between repeats against counts above black, by channel; "" without a mosaic."""
    samples: dict[str, list[VarianceSamples]] = {}
    pattern = None if capture.manifest.mosaic is None else capture.manifest.mosaic.pattern
    line = np.array([noise.floor_dn2, noise.shot_dn])
    for stack in stacks:
        if stack.kind == "dark" or len(stack.paths) < 2:
            continue
        of_channel = np.ones(capture.shape, bool)
        if stack.channel is not None and pattern is not None:
            of_channel = channel_mask(pattern, capture.shape, stack.channel)
        pixels = np.flatnonzero(of_channel)
        pixels = pixels[:: -(-pixels.size // MOST_BLACK_PIXELS)]
        counts = stack.frames.reshape(len(stack.frames), -1, 1)[:, pixels]
        level = dark.at(stack.exposure_s).reshape(-1, 1)[pixels]
        part = samples_of_repeats(counts, level, capture.saturation_dn, line=line)
        if part.charge.size > SIMILAR_PIXELS:
            samples.setdefault(stack.channel or "", []).append(part)
    return samples


def _starts(
    samples: Sequence[Sequence[VarianceSamples]], noise: NoiseModel, full_scale_dn: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Variance at the black level of each channel with its covariance, and the slope.

    One slope and one curvature are common to all channels. Weights are those of `fit_noise_line`.
    """
    charge = np.concatenate([part.charge for parts in samples for part in parts])
    variance = np.concatenate([part.variance for parts in samples for part in parts])
    degrees = np.concatenate([np.full(part.charge.size, float(part.degrees)) for parts in samples for part in parts])
    channel = np.repeat(np.arange(len(samples)), [sum(part.charge.size for part in parts) for parts in samples])
    lowest = LOWEST_SHARE_OF_SIMILAR * np.concatenate([_of_similar(part) for parts in samples for part in parts])
    of_channel = (channel[:, None] == np.arange(len(samples))).astype(float)
    # the variance of counts that bend by b at full scale grows by 3 b
    curvature = 3 * charge**2 * noise.shot_dn / full_scale_dn
    design = np.column_stack([of_channel, charge, curvature])
    prior = np.zeros(design.shape[1])
    prior[-1] = USUAL_BENDING**-2.0
    fit = np.array([*[noise.floor_dn2] * len(samples), noise.shot_dn, 0.0])
    covariance = np.eye(fit.size)
    for _ in range(BLACK_ROUNDS):
        expected = np.maximum(design @ fit, lowest)
        weight = (variance < LARGEST_VARIANCE_RATIO * expected) * degrees / (2 * expected**2)
        covariance = np.linalg.pinv(design.T @ (weight[:, None] * design) + np.diag(prior))
        fit = covariance @ (design.T @ (weight * variance))
    return fit[: len(samples)], covariance[: len(samples), : len(samples)], float(fit[-2])


def _of_similar(part: VarianceSamples) -> NDArray[np.float64]:
    """(n,) mean variance of pixels of similar light."""
    order = np.argsort(part.charge)
    means = uniform_filter1d(part.variance[order], SIMILAR_PIXELS, mode="nearest")
    result = np.empty_like(means)
    result[order] = means
    return result
