"""Checks of flats and references for their light, and of all frames for defective lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ...capture import Capture, channel_mask, pattern_rows, split_channel
from ...correction import DarkLibrary
from ...radiometry import counts_over_constant
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_fields", "check_lines", "check_pattern"]

#: Smallest suspicious range of reference over flat in the picture: sound captures have less than 0.5 %, and the sphere
#: or panel of a laboratory is even to 1 %.
SMALLEST_RANGE = 0.03

#: The range must be larger than its standard deviation by this factor.
RANGE_SIGMAS = 8

#: Rows and columns of the blocks whose means are compared.
BLOCKS = 8

#: Smallest picture, px: blocks of smaller ones have fewer than 16 pixels.
SMALLEST_PICTURE_PX = 32

#: Smallest share of the bands that differ in the same way: one band alone may have another flat.
SMALLEST_SHARE = 0.5

#: A surface varies in one way if its range along rows is larger than that along columns by this factor, or the reverse.
ONE_WAY = 3

#: Places of the picture, by thirds of its rows and columns.
PLACES = (
    ("at the upper left", "at the top", "at the upper right"),
    ("at the left", "in the middle", "at the right"),
    ("at the lower left", "at the bottom", "at the lower right"),
)

#: Smallest suspicious difference of a pixel's level in even light from that of its channel, over the brightest pixel's.
#: Unlike greens differ by 3 %, and tables of another copy of a camera by 5 %.
SMALLEST_LEVEL_ERROR = 0.1

#: Largest such difference with the right pattern.
LARGEST_RIGHT_ERROR = 0.04

#: Rows or columns whose median is the expected light of the one in their middle: two defective neighbours do not count.
LINES = 5

#: Share of a line's pixels that must be defective: a lamp, a window or an object covers a part of it.
DEFECTIVE_SHARE = 0.95

#: Largest light of a dead line over that of its neighbours: black paint reflects more.
LARGEST_DEAD_LIGHT = 0.02

#: Smallest light over the brightest at which a dead line is visible.
BRIGHT_LIGHT = 0.1

#: Smallest share of a line's pixels that must have this light nearby.
BRIGHT_SHARE = 0.5

#: Smallest excess of a hot line over its neighbours, over full scale: columns of sound sensors differ by a few counts.
SMALLEST_HOT_EXCESS = 0.01

#: Smallest picture in which lines are judged, px.
SMALLEST_LINES_PX = 24


def check_pattern(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, channels: Mapping[str, str] | None
) -> Iterator[Suspicion]:
    """Detect a mosaic that begins at another pixel than stated.

    In even light the pixels of a channel have one level, and the levels are as the stated sensitivities say.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    channels
        Channel of each band; None without a mosaic.

    Yields
    ------
    Suspicion
        If these levels fit a shifted pattern, and not the stated one.
    """
    if capture.manifest.mosaic is None or channels is None:
        return
    cell = np.array([[*row] for row in pattern_rows(capture.manifest.mosaic.pattern)])
    kind = "reference" if capture.manifest.reference else "flat"
    fields = {stack.paths: stack for stack in stacks if stack.kind == kind}
    even = {paths: _levels(stack, dark, cell.shape) for paths, stack in fields.items()}
    if not even:
        return
    units = {paths: _expected(capture, paths, channels) for paths in even}
    errors = {}
    for pattern in _other_patterns(cell):
        error = max(_level_error(levels, pattern, units[paths]) for paths, levels in even.items())
        errors[pattern.tobytes()] = error, pattern
    smallest, present = min(error for error, _ in errors.values()), errors[cell.tobytes()][0]
    if present < SMALLEST_LEVEL_ERROR or smallest > LARGEST_RIGHT_ERROR:
        return
    right = [shifted for error, shifted in errors.values() if error <= LARGEST_RIGHT_ERROR]
    between = "" if cell.shape == (2, 2) else " "
    names = " or ".join(f'"{between.join("".join(row) for row in shifted)}"' for shifted in right)
    exchanged = _exchanged_letters(cell, right)
    tables = f", or the sensitivities of {exchanged} are exchanged" if exchanged else ""
    yield Suspicion(
        f"the mosaic begins at another pixel: the pattern is {names}{tables}",
        "mosaic.pattern",
        f"In even light pixels differ from the level of their channel by up to {present:.0%} of the brightest level; "
        f"with that pattern by {smallest:.1%}.",
    )


def _other_patterns(cell: NDArray[np.str_]) -> Iterator[NDArray[np.str_]]:
    """Stated pattern, patterns from every other pixel on, and with two channels exchanged."""
    for shift in product(*(range(side) for side in cell.shape)):
        yield np.roll(cell, shift, (0, 1))
    for first, second in combinations(sorted(set(cell.ravel().tolist())), 2):
        yield np.where(cell == first, second, np.where(cell == second, first, cell))


def _exchanged_letters(cell: NDArray[np.str_], right: Sequence[NDArray[np.str_]]) -> str:
    """Two channels, "R and B", whose exchange gives a right pattern; empty without any."""
    letters = sorted(set(cell.ravel().tolist()))
    for first, second in combinations(letters, 2):
        exchanged = np.where(cell == first, second, np.where(cell == second, first, cell))
        if any(np.array_equal(exchanged, pattern) for pattern in right):
            return f"{first} and {second}"
    return ""


def _levels(stack: Stack, dark: DarkLibrary, repeat: tuple[int, ...]) -> NDArray[np.float64]:
    """Level of each pixel of the mosaic's repeat in even light, relative to the brightest."""
    net = stack.frames.mean(axis=0) - dark.at(stack.exposure_s)
    levels = np.empty(repeat)
    for row, column in np.ndindex(*repeat):
        levels[row, column] = np.median(net[row :: repeat[0], column :: repeat[1]])
    return levels / max(float(levels.max()), 1.0)


def _expected(capture: Capture, paths: tuple[str, ...], channels: Mapping[str, str]) -> dict[str, float] | None:
    """Counts of each channel over C, by the stated sensitivities; None if one is unknown."""
    units = {}
    for table in capture.manifest.reference:
        if table.frames == paths:
            unit = counts_over_constant(capture, table, table.radiance, channels[table.band])
            if unit is None:
                return None
            units[split_channel(channels[table.band])[0]] = unit
    return units


def _level_error(levels: NDArray[np.float64], cell: NDArray[np.str_], units: Mapping[str, float] | None) -> float:
    """Largest difference of a pixel's level from that of its channel."""
    letters = sorted(set(cell.ravel().tolist()))
    if units and set(letters) <= set(units):
        expected = np.vectorize(units.__getitem__, otypes=[np.float64])(cell)
        expected *= np.sum(levels * expected) / np.sum(expected**2)
    else:
        expected = np.zeros_like(levels)
        for letter in letters:
            expected[cell == letter] = levels[cell == letter].mean()
    return float(np.abs(levels - expected).max())


def check_fields(capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detect flats and references that show fields of different shape.

    A quadratic surface is fitted to reference over flat. Bands whose flat has another f-number or image distance than
    the reference are left out, because the lens then changes the shape.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.

    Yields
    ------
    Suspicion
        One for the capture if most bands have such fields, else one for each of them.
    """
    by_band = {band: _surface(capture, stacks, dark, band) for band in capture.band_ids}
    surfaces = {band: surface for band, surface in by_band.items() if surface is not None}
    uneven_bands = [
        band
        for band, (surface, sigma) in surfaces.items()
        if _range(surface) > max(SMALLEST_RANGE, RANGE_SIGMAS * sigma)
    ]
    uneven = [surfaces[band][0] for band in uneven_bands]
    if len(uneven) < SMALLEST_SHARE * len(surfaces):
        yield from _check_single_fields({band: surfaces[band][0] for band in uneven_bands}, len(surfaces))
        return
    if not uneven:
        return
    ranges = [_range(surface) for surface in uneven]
    brightest, darkest = _extremes(np.mean(uneven, axis=0))
    yield Suspicion(
        "flats and references show fields of different shape (an uneven flat field or reference, or light from aside)",
        "flat, reference",
        f"Reference over flat is higher by {min(ranges):.1%} to {max(ranges):.1%} {brightest} than {darkest} in "
        f"{len(uneven)} of {len(surfaces)} bands; fields of one shape agree within 1%.",
    )


def _check_single_fields(uneven: Mapping[str, NDArray[np.float64]], bands: int) -> Iterator[Suspicion]:
    """Bands whose reference over flat is uneven, while that of most bands is even.

    uneven : (BLOCKS, BLOCKS) fitted ratio by band. bands : number of all bands that were compared.
    """
    for band, surface in uneven.items():
        brightest, darkest = _extremes(surface)
        yield Suspicion(
            f"the flat of {band} has another fall-off than its reference (another aperture, focus or position)",
            f"flat ({band}), reference ({band})",
            f"Reference over flat is higher by {_range(surface):.1%} {brightest} than {darkest}; it is even in "
            f"{bands - len(uneven)} of {bands} bands.",
        )


def _surface(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, band: str
) -> tuple[NDArray[np.float64], float] | None:
    """Fitted reference over flat of a band, and the standard deviation of its range.

    (BLOCKS, BLOCKS), median about 1. None without comparable frames.
    """
    flats, references = capture.flats(band), capture.references(band)
    if not flats or not references:
        return None
    settings = {(capture.f_number(table), capture.image_distance_mm(table)) for table in (flats[0], references[0])}
    tables = flats[0], references[0]
    flat, reference = (next((s for s in stacks if s.paths == table.frames), None) for table in tables)
    if flat is None or reference is None or len(settings) > 1 or min(capture.shape) < SMALLEST_PICTURE_PX:
        return None
    pattern = None if capture.manifest.mosaic is None else capture.manifest.mosaic.pattern
    saturated, of_channel = capture.saturation_dn, np.ones(capture.shape, bool)
    if pattern is not None and flat.channel is not None:
        of_channel = channel_mask(pattern, capture.shape, flat.channel)
    usable = (flat.frames.max(axis=0) < saturated) & (reference.frames.max(axis=0) < saturated) & of_channel
    net = [np.where(usable, s.frames.mean(axis=0) - dark.at(s.exposure_s), 0.0) for s in (reference, flat)]
    above, below = (_block_sums(image) for image in net)
    if not np.all(below > 0) or not np.all(above > 0):
        return None
    ratio = above / below
    ratio = ratio / np.median(ratio)
    v, u = (axis.ravel() for axis in np.mgrid[-1 : 1 : BLOCKS * 1j, -1 : 1 : BLOCKS * 1j])
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    fit, *_ = np.linalg.lstsq(design, ratio.ravel(), rcond=None)
    residual = ratio.ravel() - design @ fit
    scatter = float(np.sqrt(np.sum(residual**2) / (residual.size - design.shape[1])))
    # The variance of a fitted value is, in the mean, that of a block times parameters over blocks.
    sigma = scatter * float(np.sqrt(2 * design.shape[1] / residual.size))
    return (design @ fit).reshape(BLOCKS, BLOCKS), sigma


def _block_sums(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """(BLOCKS, BLOCKS) sums of an image (y, x) over blocks, without rows and columns left over."""
    height, width = (n // BLOCKS for n in image.shape)
    cut = image[: height * BLOCKS, : width * BLOCKS]
    return np.asarray(cut.reshape(BLOCKS, height, BLOCKS, width).sum(axis=(1, 3)), np.float64)


def _range(surface: NDArray[np.float64]) -> float:
    """Difference of the largest and the smallest value."""
    return float(np.ptp(surface))


def _extremes(surface: NDArray[np.float64]) -> tuple[str, str]:
    """Words for the places of the largest and the smallest mean over thirds of the picture.

    A surface that varies along rows much more than along columns, or the reverse, has them at its sides.
    """
    means = np.array([[part.mean() for part in np.array_split(row, 3, axis=1)] for row in np.array_split(surface, 3)])
    by_row, by_column = means.mean(axis=1), means.mean(axis=0)
    if np.ptp(by_column) > ONE_WAY * np.ptp(by_row):
        return PLACES[1][int(by_column.argmax())], PLACES[1][int(by_column.argmin())]
    if np.ptp(by_row) > ONE_WAY * np.ptp(by_column):
        return PLACES[int(by_row.argmax())][1], PLACES[int(by_row.argmin())][1]
    largest, smallest = (divmod(int(index), 3) for index in (means.argmax(), means.argmin()))
    return PLACES[largest[0]][largest[1]], PLACES[smallest[0]][smallest[1]]


def check_lines(stacks: Sequence[Stack], dark: DarkLibrary, saturation_dn: float) -> Iterator[Suspicion]:
    """Detect dead and hot rows and columns of the sensor.

    A line is dead if it has no light between bright neighbours, in all photographs or in all flats. It is hot if it
    exceeds its neighbours in all dark frames. A line that is brighter in photographs alone may be a ceiling.

    Parameters
    ----------
    stacks
        All frames.
    dark
        Dark frames.
    saturation_dn
        Count of saturated pixels, DN.

    Yields
    ------
    Suspicion
        At most one for rows, one for columns.
    """
    smallest = SMALLEST_HOT_EXCESS * saturation_dn
    large = [stack for stack in stacks if min(stack.mean.shape) >= SMALLEST_LINES_PX]
    for name, axes in (("row", (0, 1)), ("column", (1, 0))):
        dead: set[int] = set()
        for kind, lattice in dict.fromkeys((stack.kind, stack.lattice) for stack in large):
            alike = [stack for stack in large if (stack.kind, stack.lattice) == (kind, lattice)]
            images = [(stack.mean - stack.thinned(dark.at(stack.exposure_s))).transpose(axes) for stack in alike]
            first, step = (0, 1) if lattice is None else (lattice[axes[0]], lattice[2])
            if kind in ("band", "flat"):
                dead |= {first + step * k for k in _in_all(images, _dead_lines)}
        darks = [stack.frames.mean(axis=0).transpose(axes) for stack in large if stack.kind == "dark"]
        hot = _in_all(darks, lambda image: _hot_lines(image, smallest))
        for word, lines, why in (
            ("dead", dead, "no light, between bright neighbours"),
            ("hot", hot - dead, f"{smallest:.3g} DN or more above their neighbours"),
        ):
            if lines:
                listing = ", ".join(f"{k}" for k in sorted(lines)[:6]) + (" ..." if len(lines) > 6 else "")
                yield Suspicion(
                    f"{word} {name}s of the sensor: {listing}",
                    "camera",
                    f"Counted from 0, these {name}s have {why}, over {DEFECTIVE_SHARE:.0%} of their length or more.",
                )


def _in_all(images: Sequence[NDArray[np.float64]], lines_of: Callable[[NDArray[np.float64]], set[int]]) -> set[int]:
    """Rows that are defective in all images; none without images."""
    return set.intersection(*map(lines_of, images)) if images else set()


def _dead_lines(image: NDArray[np.float64]) -> set[int]:
    """Rows of an image (y, x) without light between bright neighbours."""
    neighbours = median_filter(image, (LINES, 1), mode="nearest")
    bright = neighbours > BRIGHT_LIGHT * max(float(np.percentile(image, 99)), 1.0)
    without = bright & (image < LARGEST_DEAD_LIGHT * neighbours)
    share = without.sum(axis=1) / np.maximum(bright.sum(axis=1), 1)
    return {*np.flatnonzero((share >= DEFECTIVE_SHARE) & (bright.mean(axis=1) > BRIGHT_SHARE)).tolist()}


def _hot_lines(image: NDArray[np.float64], smallest_dn: float) -> set[int]:
    """Rows of an image (y, x) above their neighbours over nearly all of their length."""
    excess = image - median_filter(image, (LINES, 1), mode="nearest")
    return {*np.flatnonzero((excess > smallest_dn).mean(axis=1) >= DEFECTIVE_SHARE).tolist()}
