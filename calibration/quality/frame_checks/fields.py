"""Checks of flats and references for their light over the picture and over a mosaic."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ...capture import Capture, channel_mask, pattern_rows, split_channel
from ...correction import DarkLibrary
from ...radiometry import counts_over_constant
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_fields", "check_pattern"]

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
