"""Checks for equal content under two names, and for names that contradict their table."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ..capture import BandTable, Capture, split_name
from ..correction import DarkLibrary, NoiseModel
from ..frame_readers import frame_header
from .frame_checks import Stack, Suspicion
from .tables import stated_columns

__all__ = [
    "check_frame_content",
    "check_names",
    "check_same_view",
    "check_spectra_content",
    "check_stated_exposures",
    "named_pass_band",
]

#: Smallest share of pixels that differ from the most common count: clipped darks below it may be equal by chance.
SMALLEST_VARIED_SHARE = 0.05

#: Blocks along each side of a picture that is compared with another one.
BLOCKS = 8

#: Smallest rank correlation of the block means of two pictures of one scene through one filter: pictures of different
#: exposure and light reach 0.95, since a factor keeps the ranks.
SMALLEST_RANK_CORRELATION = 0.8

#: Smallest standard deviation of the block means over their noise: fainter pictures are not compared.
SMALLEST_CONTRAST = 10.0

#: Kind of frame by a word in a file's name.
KIND_OF_WORD = {
    "dark": "dark",
    "bias": "dark",
    "flat": "flat",
    "sphere": "reference",
    "reference": "reference",
    "ref": "reference",
}

#: Exposure in a file's name, in s or ms.
EXPOSURE = re.compile(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)(ms|s)")

#: Largest factor between an exposure and that in its file's name: names hold rounded numbers.
LARGEST_NAME_FACTOR = 1.25

#: Milliseconds in a second.
_MS_PER_S = 1000.0

#: Fewest frames off by one factor that are one error of all exposures, not one error each.
FEWEST_ALIKE = 4

#: Pass bands farther than this from the wavelength in the band's name are not its own, nm.
FAR_PASS_BAND_NM = 25

#: Pass bands nearer than this to the wavelength in another band's name are that band's, nm.
NEAR_PASS_BAND_NM = 15

#: Numbers of three digits in a band's name are a wavelength within this range, nm.
NAMED_WAVELENGTH_NM = (350, 1000)


def check_frame_content(stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detect identical frames; with noise, no two frames are identical.

    Parameters
    ----------
    stacks
        All frames.

    Yields
    ------
    Suspicion
        For each frame that equals an earlier one. A uniform field may serve as flat and as reference of a band. A
        frame of a mosaic may serve once for each channel.
    """
    first_of: dict[tuple[bytes, str | None], tuple[Stack, str]] = {}
    for stack in stacks:
        for path, frame in zip(stack.paths, stack.frames, strict=True):
            if not _is_varied(frame):
                continue
            digest = hashlib.sha256(np.ascontiguousarray(frame).tobytes()).digest()
            first, other = first_of.setdefault((digest, None), (stack, path))
            if first.channel is not None and other == path:  # only a frame of the same channel can be a copy
                first, other = first_of.setdefault((digest, stack.channel), (stack, path))
            if (first, other) == (stack, path):
                continue
            kinds = {first.kind, stack.kind}
            if other == path and first.band == stack.band and kinds == {"flat", "reference"}:
                continue
            two = "two repeats" if first is stack else f"{first.key} and {stack.key}"
            yield Suspicion(
                f"the same frame occurs twice: {two} have the same content",
                path,
                f"It equals {other} in all {frame.size} counts, which noise makes impossible for different frames.",
            )


def _is_varied(frame: np.ndarray) -> bool:
    """Whether enough pixels differ from the most common count, so that no other frame is equal."""
    _, counts = np.unique(frame, return_counts=True)
    return bool(counts.max() < (1 - SMALLEST_VARIED_SHARE) * frame.size)


def check_same_view(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Detect bands of one channel and filter that show different pictures.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.
    dark
        The capture's dark frames.
    noise
        Gain and read noise by its frames.

    Yields
    ------
    Suspicion
        One for all such bands.
    """
    pictures: dict[tuple[str | None, str | None], list[tuple[str, NDArray[np.float64]]]] = {}
    for stack in stacks:
        if stack.kind != "band" or stack.band is None:
            continue
        blocks = _block_means(stack, dark, noise)
        if blocks is not None:
            filter_column = capture.band(stack.band).transmittance
            pictures.setdefault((stack.channel, filter_column), []).append((stack.band, blocks))
    different: dict[str, float] = {}
    for group in pictures.values():
        for (band, blocks), (other, others) in itertools.combinations(group, 2):
            correlation = float(np.corrcoef(np.argsort(np.argsort(blocks)), np.argsort(np.argsort(others)))[0, 1])
            if correlation < SMALLEST_RANK_CORRELATION:
                different |= {name: min(correlation, different.get(name, 1.0)) for name in (band, other)}
    if different:
        yield Suspicion(
            "bands of one channel and filter show different pictures (photographs of a board belong in [[target]])",
            ", ".join(different),
            f"The rank correlation of the means of {BLOCKS} x {BLOCKS} blocks goes down to "
            f"{min(different.values()):.2f}; two pictures of one scene reach {SMALLEST_RANK_CORRELATION:g} at least.",
        )


def _block_means(stack: Stack, dark: DarkLibrary, noise: NoiseModel) -> NDArray[np.float64] | None:
    """(BLOCKS^2,) means of blocks above dark, DN; None for a small or faint picture."""
    net = stack.mean - stack.thinned(dark.at(stack.exposure_s))
    height, width = (n // BLOCKS for n in net.shape)
    if min(height, width) < 1:
        return None
    blocks = net[: BLOCKS * height, : BLOCKS * width].reshape(BLOCKS, height, BLOCKS, width).mean(axis=(1, 3)).ravel()
    variance = float(noise.variance(blocks).mean()) / (height * width * len(stack.paths))
    return blocks if blocks.std() > SMALLEST_CONTRAST * np.sqrt(variance) else None


def check_spectra_content(capture: Capture) -> Iterator[Suspicion]:
    """Detect spectra with equal values under two names.

    Parameters
    ----------
    capture
        A capture.

    Yields
    ------
    Suspicion
        For each pair, except constant spectra and the radiances of two references.
    """
    distinct = {reference: (kind, key, s) for kind, key, reference, s in reversed(stated_columns(capture))}
    columns = list(reversed(list(distinct.items())))
    for index, (reference, (kind, key, spectrum)) in enumerate(columns):
        if np.ptp(spectrum.values) == 0:
            continue
        for other, (other_kind, _, another) in columns[:index]:
            same = spectrum.values.shape == another.values.shape and np.allclose(
                spectrum.values, another.values, rtol=1e-9, atol=0
            )
            if same and not (kind == other_kind == "reference radiance"):
                yield Suspicion(
                    f"the {kind} and the {other_kind} are the same table",
                    f"{key} ({reference})",
                    f"Its {spectrum.values.size} values equal those of {other}.",
                )


def check_stated_exposures(capture: Capture, stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detect exposures that contradict what the files of their frames state.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.

    Yields
    ------
    Suspicion
        For the exposures off by one factor, together.
    """
    off_by: dict[float, list[tuple[Stack, float]]] = defaultdict(list)
    for stack in stacks:
        file = split_name(capture.folder, stack.paths[0])[0]
        stated_s = frame_header(capture.folder / file).facts.exposure_s
        if stated_s is None or stack.exposure_s <= 0:
            continue
        factor = stack.exposure_s / stated_s
        if max(factor, 1 / factor) > LARGEST_NAME_FACTOR:
            off_by[float(f"{factor:.2g}")].append((stack, stated_s))
    for factor, pairs in off_by.items():
        stack, stated_s = pairs[0]
        yield Suspicion(
            f"exposures that their files contradict, by a factor of {factor:g}",
            f"{stack.key}.exposure_s" + (f" and {len(pairs) - 1} others" if len(pairs) > 1 else ""),
            f"It is {stack.exposure_s:g} s, and {stack.paths[0]} states {stated_s:g} s."
            + (" Is it in ms?" if factor == _MS_PER_S else ""),
        )


def check_names(capture: Capture, stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detect frames named after another band, kind or exposure, and exchanged filters.

    Parameters
    ----------
    capture
        A capture.
    stacks
        All its frames.

    Yields
    ------
    Suspicion
        For each frame or band whose name contradicts its table.
    """
    bands = {band.lower() for band in capture.band_ids if re.search(r"[A-Za-z]", band)}
    for stack in stacks:
        sharing = {other.band.lower() for other in stacks if other.band is not None and stack.shares_frames(other)}
        for path in stack.paths:
            tokens = _tokens(path)
            bands_in_name = (tokens & bands) - sharing
            if stack.band is not None and bands_in_name and stack.band.lower() not in bands_in_name:
                yield Suspicion(
                    f"a frame of another band: {path} is listed under {stack.band}",
                    f"{stack.key}.frames",
                    f"Its name says {', '.join(sorted(bands_in_name))}.",
                )
            kinds = {KIND_OF_WORD[token] for token in tokens if token in KIND_OF_WORD}
            kind = {"bracket": "band"}.get(stack.kind, stack.kind)
            if kinds and kind not in kinds and kinds | {kind} != {"flat", "reference"}:
                yield Suspicion(
                    f"a {' or '.join(sorted(kinds))} frame is listed among the {kind} frames",
                    f"{stack.key}.frames",
                    f"The file is called {path}.",
                )
    yield from _check_named_exposures(stacks)
    yield from _check_pass_bands(capture)


def _tokens(path: str) -> set[str]:
    """Words of a file's name. The sign of a power of ten does not divide a word, as in 8.6e-06s."""
    return set(re.split(r"(?<!\de)[+-]|[^A-Za-z0-9.+-]+", PurePosixPath(path).stem.lower()))


def _check_named_exposures(stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Exposures that contradict the names of their frames: all by one factor, or single ones."""
    exposures = [
        (stack, path, float(match[1]) * (1e-3 if match[2] == "ms" else 1.0))
        for stack in stacks
        for path in stack.paths
        for token in _tokens(path)
        if (match := EXPOSURE.fullmatch(token))
    ]
    exposures = [row for row in exposures if row[2] > 0]
    factors = np.array([stack.exposure_s / seconds for stack, _, seconds in exposures])
    alike = factors.size >= FEWEST_ALIKE and np.ptp(np.log(factors)) < np.log(LARGEST_NAME_FACTOR)
    if alike and not 1 / LARGEST_NAME_FACTOR < (factor := float(np.median(factors))) < LARGEST_NAME_FACTOR:
        stack, path, seconds = exposures[0]
        yield Suspicion(
            f"all exposures are {factor:.4g} times those in the names of the frames (another unit)",
            "exposure_s",
            f"{path} is listed under {stack.exposure_s:g} s, and {len(exposures) - 1} others by the same factor.",
        )
        return
    for (stack, path, seconds), factor in zip(exposures, factors, strict=True):
        if not 1 / LARGEST_NAME_FACTOR < factor < LARGEST_NAME_FACTOR:
            yield Suspicion(
                f"a frame of {seconds:g} s is listed under {stack.exposure_s:g} s",
                f"{stack.key}.exposure_s",
                f"The file is called {path}.",
            )


def named_pass_band(capture: Capture, band: BandTable) -> tuple[float, float] | None:
    """Wavelength in a band's name and centre of its pass band by the filter's table.

    Parameters
    ----------
    capture
        A capture.
    band
        One of its bands.

    Returns
    -------
    tuple of float, or None
        Both in nm; None if the name holds no wavelength or the table no pass band in nm.
    """
    shortest, longest = NAMED_WAVELENGTH_NM
    number = re.search(r"(?<!\d)(\d{3})(?!\d)", band.id)
    if number is None or band.transmittance is None or not shortest <= int(number[1]) <= longest:
        return None
    curve = capture.light(band.transmittance)
    if curve.values.max() <= 0 or curve.wavelength_nm[-1] < 300:
        return None
    weight = np.maximum(curve.values, 0) * (curve.values > 0.5 * curve.values.max())
    return float(number[1]), float(np.average(curve.wavelength_nm, weights=weight))


def _check_pass_bands(capture: Capture) -> Iterator[Suspicion]:
    """Bands named after a wavelength whose filter is that of another band."""
    wavelength_of, centre = {}, {}
    for index, band in enumerate(capture.manifest.band):
        pass_band = named_pass_band(capture, band)
        if pass_band is not None:
            wavelength_of[band.id] = pass_band[0]
            centre[band.id] = (index, pass_band[1])
    for name, (index, peak) in centre.items():
        nearest = min(wavelength_of, key=lambda other: abs(wavelength_of[other] - peak))
        far = abs(wavelength_of[name] - peak) > FAR_PASS_BAND_NM
        if nearest != name and far and abs(wavelength_of[nearest] - peak) < NEAR_PASS_BAND_NM:
            yield Suspicion(
                f"the filter of {name} is that of {nearest}",
                f"band[{index}] ({name}).transmittance",
                f"Its pass band is at {peak:.0f} nm; the band is named after {wavelength_of[name]:.0f} nm.",
            )
