"""Checks by the pattern of the pixels' sensitivities, which all lit frames have in common."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import NORMAL_OVER_MEDIAN
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import convolve, gaussian_filter, median_filter, uniform_filter

from ...correction import DarkLibrary
from .stacks import Stack
from .suspicion import Suspicion

__all__ = [
    "NEIGHBOURHOOD_PX",
    "check_division",
    "check_fingerprint",
    "check_flat_shapes",
    "local_spread",
    "surroundings",
]

#: Smallest correlation at another position or orientation, standard deviations: in 8 orientations with a few thousand
#: shifts each, noise reaches 5.5.
SMALLEST_CORRELATION_ELSEWHERE = 9.0

#: Correlation in place below which the pattern is missing, standard deviations.
SMALLEST_CORRELATION_IN_PLACE = 4.5

#: Smallest median correlation of neighbouring flats, standard deviations: without a pattern nothing can be tested.
SMALLEST_CORRELATION_OF_FLATS = 20.0

#: Largest suspicious factor of the flats' pattern in photographs: 1 where they are as taken, 0 after a division by the
#: flat, -1 after two divisions.
LARGEST_SHARE = 0.5

#: The factor must be below 1 by this many standard deviations: sound captures have 1 within 2.
SHARE_SIGMAS = 5.0

#: Edge of the square in which the spread of details is measured, px: wider than an edge of the picture.
SPREAD_PX = 7

#: Largest weight of a pixel over that of one with the median spread: quiet places say no more of the pattern.
MOST_WEIGHT = 4.0

#: Smallest suspicious rms structure of a flat over 2 to 6 px: flats of a uniform field stay below 1 %.
LARGEST_STRUCTURE = 0.04

#: Smallest flat whose structure is measured, px: smaller ones have too little beyond the filters' borders.
SMALLEST_FLAT_PX = 64

#: Edge of the neighbourhood of a pixel, px.
NEIGHBOURHOOD_PX = 5

#: Pixels darker than this share of the brightest have too much noise.
DARKEST_SHARE = 0.02

#: Details beyond this many standard deviations of their neighbourhood are clipped.
CLIP_SIGMAS = 4

#: Standard deviations of the Gaussians between which structure of a flat is measured, px.
STRUCTURE_PX = (2.0, 6.0)

#: Orientations of a frame other than its own, by the words of the suspicion.
ORIENTATIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "upside down": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "exchanged in rows and columns": lambda image: image.T,
    "turned by 90 degrees": lambda image: np.rot90(image),
    "turned by 270 degrees": lambda image: np.rot90(image, 3),
    "transposed about the other diagonal": lambda image: image[::-1, ::-1].T,
}


@dataclass(frozen=True, eq=False)
class _Patterns(FrozenMappings):
    """Patterns of the lit frames of one place in the mosaic's cell."""

    #: (y, x) DN above dark of each table, by key.
    net: Mapping[str, NDArray[np.float64]]
    #: (y, x) pattern of each table, by key.
    of_table: Mapping[str, NDArray[np.float64]]
    #: The flats.
    flats: Sequence[Stack]
    #: (y, x) mean of the flats' patterns.
    common: NDArray[np.float64]

    def flats_without(self, stack: Stack) -> NDArray[np.float64]:
        """(y, x) mean pattern of all flats other than a stack, of unit variance."""
        count, pattern = len(self.flats), self.of_table[stack.key]
        others = self.common if stack.kind != "flat" else (self.common * count - pattern) / (count - 1)
        return np.asarray(others / others.std(), np.float64)


def check_fingerprint(stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detect frames mirrored, turned or shifted against the flats.

    Parameters
    ----------
    stacks
        All frames. Without two flats of one channel, or without a pattern in them, nothing is tested.
    dark
        Dark frames.

    Yields
    ------
    Suspicion
        For each table whose pattern is elsewhere.
    """
    bright = [s for s in stacks if s.kind in ("band", "flat", "reference")]
    flats = [s for s in bright if s.kind == "flat"]
    lattices = {s.lattice for s in flats}
    if len(flats) < 2 or len(lattices) != 1:
        return
    patterns = _measure_patterns(bright, flats, dark)
    pairs = [
        float(_correlations(patterns.of_table[a.key], patterns.of_table[b.key])[0, 0])
        for a, b in itertools.pairwise(flats)
    ]
    if np.median(pairs) < SMALLEST_CORRELATION_OF_FLATS:
        return
    for stack in bright:
        if stack.lattice not in lattices:
            continue
        pattern, others = patterns.of_table[stack.key], patterns.flats_without(stack)
        correlations = _correlations(pattern, others)
        in_place = float(correlations[0, 0])
        if in_place > SMALLEST_CORRELATION_IN_PLACE:
            continue
        movement = _movement(pattern, others, correlations)
        if movement is not None:
            yield _moved_frames(stack, movement, in_place)


def _measure_patterns(bright: Sequence[Stack], flats: Sequence[Stack], dark: DarkLibrary) -> _Patterns:
    """Patterns of all lit tables and the mean of those of the flats."""
    net = {s.key: s.mean - s.thinned(dark.at(s.exposure_s)) for s in bright}
    of_table = {key: _pattern(image) for key, image in net.items()}
    return _Patterns(net, of_table, flats, np.mean([of_table[s.key] for s in flats], axis=0))


def _moved_frames(stack: Stack, movement: tuple[str, float], in_place: float) -> Suspicion:
    """Suspicion of frames whose pattern is elsewhere. movement : as of ``_movement``."""
    how, strength = movement
    return Suspicion(
        f"the {stack.kind} frames are {how} against the flats",
        f"{stack.key}.frames",
        f"The correlation of the pixels' sensitivities with those of the flats is {strength:.0f} standard "
        f"deviations when they are {how}, {in_place:.1f} as stored.",
    )


def _detail(net: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) relative difference of each pixel from its neighbours, mean 0; edges count less."""
    local = uniform_filter(net, NEIGHBOURHOOD_PX)
    floor = DARKEST_SHARE * max(float(np.percentile(net, 99)), 1e-9)
    high = (net - local) / np.maximum(local, floor)
    high[local < floor] = 0.0
    # Reduce the weight of edges in the picture.
    spread = np.sqrt(np.maximum(uniform_filter(high**2, NEIGHBOURHOOD_PX), 0.0)) + 1e-12
    usual = float(np.median(spread[spread > 1e-9])) if np.any(spread > 1e-9) else 1.0
    clipped = np.clip(high / np.maximum(spread, usual), -CLIP_SIGMAS, CLIP_SIGMAS)
    high = usual * clipped * np.minimum(1.0, (usual / spread) ** 2)
    return np.asarray(high - high.mean(), np.float64)


def _pattern(net: NDArray[np.float64]) -> NDArray[np.float64]:
    """``_detail`` (y, x) with unit variance."""
    detail = _detail(net)
    return np.asarray(detail / max(float(detail.std()), 1e-12), np.float64)


def _correlations(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) circular correlation of two patterns by shift, in standard deviations of noise."""
    product = np.fft.rfft2(a) * np.conj(np.fft.rfft2(b))
    correlations = np.fft.irfft2(product, s=a.shape)
    return np.asarray(correlations / np.sqrt(a.size), np.float64)


def _shift(peak: tuple[int, ...], shape: tuple[int, int]) -> tuple[int, int]:
    """(u, v) shift, px, of a peak (row, column) of a circular correlation."""
    v, u = (int(p) if p <= n // 2 else int(p) - n for p, n in zip(peak, shape, strict=True))
    return u, v


def _movement(
    pattern: NDArray[np.float64], others: NDArray[np.float64], correlations: NDArray[np.float64]
) -> tuple[str, float] | None:
    """Shift or orientation of a pattern relative to others, and its significance; or None."""
    if correlations.max() > SMALLEST_CORRELATION_ELSEWHERE:
        u, v = _shift(np.unravel_index(int(correlations.argmax()), correlations.shape), pattern.shape)  # type: ignore[arg-type]
        return f"moved by ({u}, {v}) px", float(correlations.max())
    for how, turn in ORIENTATIONS.items():
        turned = turn(pattern)
        if turned.shape == others.shape:
            other = _correlations(turned, others)
            if other.max() > SMALLEST_CORRELATION_ELSEWHERE:
                return how, float(other.max())
    return None


def _quadratic_weights() -> NDArray[np.float64]:
    """(5, 5) weights of a pixel's neighbours in the quadratic surface fitted to them."""
    reach = NEIGHBOURHOOD_PX // 2
    v, u = (axis.ravel() for axis in np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float))
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    neighbours = np.flatnonzero((u != 0) | (v != 0))
    weights = np.zeros(u.size)
    weights[neighbours] = np.linalg.pinv(design[neighbours])[0]
    return weights.reshape(NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX)


def surroundings(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Expected values of pixels by their neighbours alone.

    A quadratic surface is fitted to the neighbours of each pixel: gradients of light are in it, a pixel's own
    sensitivity and charge are not.

    Parameters
    ----------
    image
        (y, x) picture.

    Returns
    -------
    NDArray
        (y, x) in the picture's unit.
    """
    return np.asarray(convolve(image, _quadratic_weights(), mode="mirror"), np.float64)


def local_spread(detail: NDArray[np.float64]) -> NDArray[np.float64]:
    """Robust standard deviation of a detail nearby.

    Parameters
    ----------
    detail
        (y, x) differences of pixels from their surroundings.

    Returns
    -------
    NDArray
        (y, x) in the same unit; large at edges of the picture.
    """
    return np.asarray(NORMAL_OVER_MEDIAN * median_filter(np.abs(detail), SPREAD_PX), np.float64)


def check_division(stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detect photographs that do not show the pixels' sensitivities which the flats show.

    The flats' pattern is in a photograph as taken with a factor of 1. After a division by the flat the factor is 0, and
    -1 after two. Halves of the flats have independent noise, so that it does not lower the factor.

    Parameters
    ----------
    stacks
        All frames. Without four flats of one channel nothing is tested.
    dark
        Dark frames.

    Yields
    ------
    Suspicion
        One for all photographs, or for single ones.
    """
    flats = [s for s in stacks if s.kind == "flat"]
    lattices = {s.lattice for s in flats}
    bands = [s for s in stacks if s.kind == "band" and s.lattice in lattices]
    if len(flats) < 4 or len(lattices) != 1 or not bands:
        return
    halves = [np.mean([_relative_detail(flat, dark) for flat in flats[k::2]], axis=0) for k in (0, 1)]
    details = [_relative_detail(band, dark) for band in bands]
    noise = [1 / max(float(np.median(np.abs(detail))), 1e-9) ** 2 for detail in details]
    factor, sigma = _pattern_factor(np.average(details, axis=0, weights=noise), halves)
    without = [band.key for band in bands] if _is_suspicious(factor, sigma) else []
    for band, detail in zip(bands, details, strict=True) if not without else ():
        of_band = _pattern_factor(detail, halves)
        if _is_suspicious(*of_band):
            without.append(band.key)
            factor, sigma = of_band
    if without:
        yield Suspicion(
            "the photographs do not show the pixels' sensitivities that the flats show (already divided by a flat, or "
            "another sensor)",
            ", ".join(without),
            f"The flats' pattern is in them with a factor of {factor:.2f} +- {sigma:.2f}. It is 1 as taken, 0 after a "
            "division by the flat, and -1 after two.",
        )


def _is_suspicious(factor: float, sigma: float) -> bool:
    """Whether a factor of the flats' pattern is not that of a photograph as taken."""
    return factor < LARGEST_SHARE and factor + SHARE_SIGMAS * sigma < 1.0


def _relative_detail(stack: Stack, dark: DarkLibrary) -> NDArray[np.float64]:
    """(y, x) relative difference of each pixel from its surroundings."""
    net = stack.mean - stack.thinned(dark.at(stack.exposure_s))
    expected = surroundings(net)
    floor = DARKEST_SHARE * max(float(np.percentile(net, 99)), 1e-9)
    return np.asarray((net - expected) / np.maximum(expected, floor), np.float64)


def _pattern_factor(detail: NDArray[np.float64], halves: Sequence[NDArray[np.float64]]) -> tuple[float, float]:
    """Factor of a pattern in a detail, and its standard deviation.

    The factors at all other shifts show what chance gives. NaN and infinity without a pattern.

    detail : (y, x). halves : two patterns (y, x) of independent noise.
    """
    spread = local_spread(detail)
    weight = 1 / np.maximum(spread, float(np.median(spread)) / np.sqrt(MOST_WEIGHT)) ** 2
    clipped = np.clip(detail, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)
    common = float(np.sum(weight * halves[0] * halves[1]))
    if not (np.isfinite(common) and common > 0):
        return float("nan"), float("inf")
    products = _correlations(weight * clipped, np.mean(halves, axis=0)) * np.sqrt(detail.size)
    reach = NEIGHBOURHOOD_PX // 2
    elsewhere = np.roll(products, (reach, reach), axis=(0, 1)).copy()
    elsewhere[:NEIGHBOURHOOD_PX, :NEIGHBOURHOOD_PX] = np.nan
    return float(products[0, 0]) / common, float(np.nanstd(elsewhere)) / common


def _mean_nearby(image: NDArray[np.float64], usable: NDArray[np.bool_], sigma_px: float) -> NDArray[np.float64]:
    """Gaussian mean (y, x) over usable pixels nearby; the median of the image where none are."""
    if usable.all():
        return np.asarray(gaussian_filter(image, sigma_px), np.float64)
    weight = gaussian_filter(usable.astype(float), sigma_px)
    total = gaussian_filter(np.where(usable, image, 0.0), sigma_px)
    return np.where(weight > 1e-6, total / np.maximum(weight, 1e-6), np.median(image))


def check_flat_shapes(stacks: Sequence[Stack], dark: DarkLibrary, saturation_dn: float) -> Iterator[Suspicion]:
    """Detect flats and references with structure, which a uniform field does not have.

    Parameters
    ----------
    stacks
        All frames.
    dark
        Dark frames.
    saturation_dn
        Count from which a pixel is saturated, DN: hot pixels of long exposures are no structure.

    Yields
    ------
    Suspicion
        For each flat or reference. The border is left out: a filter seen obliquely darkens the corners steeply.
    """
    narrow, wide = STRUCTURE_PX
    for stack in stacks:
        if stack.kind not in ("flat", "reference") or min(stack.mean.shape) < SMALLEST_FLAT_PX:
            continue
        net = stack.mean - stack.thinned(dark.at(stack.exposure_s))
        usable = stack.counts.max(axis=0) < saturation_dn
        level = float(np.median(net))
        if level <= 0:
            continue
        smooth, broad = (_mean_nearby(net, usable, width) for width in (narrow, wide))
        inner = tuple(slice(n // 5, n - n // 5) for n in net.shape)
        detail = ((smooth - broad) / np.maximum(broad, 0.1 * level))[inner]
        structure = float(np.sqrt(np.mean(detail**2)))
        if structure > LARGEST_STRUCTURE:
            yield Suspicion(
                f"the {stack.kind} frames of {stack.band} show a picture, not a uniform field",
                f"{stack.key}.frames",
                f"They vary by {structure:.0%} (rms) over 2 to 6 px; flats of a uniform field stay below 1%.",
            )
