"""Checks for equal content under two names, and for names that contradict their table."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

import numpy as np

from ..capture import Capture
from .stacks import Stack
from .suspicion import Suspicion
from .tables import stated_columns

__all__ = ["check_frame_content", "check_names", "check_spectra_content"]

#: Smallest share of pixels that differ from the most common count; frames below it (clipped darks) are not compared.
_FEWEST_DIFFERENT = 0.05
_KINDS = {
    "dark": "dark",
    "bias": "dark",
    "flat": "flat",
    "sphere": "reference",
    "reference": "reference",
    "ref": "reference",
}
_EXPOSURE = re.compile(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)(ms|s)")
#: Largest factor between an exposure and its file's name, and frames of one factor that make it that of all.
_AS_NAMED, _SEVERAL = 1.25, 4


def _telling(frame: np.ndarray) -> bool:
    counts = np.bincount(frame.ravel())
    return bool(counts.max() < (1 - _FEWEST_DIFFERENT) * frame.size)


def check_frame_content(stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detects identical frames; with noise, no two frames are identical."""
    seen: dict[bytes, tuple[Stack, str]] = {}
    for stack in stacks:
        for path, frame in zip(stack.paths, stack.whole, strict=True):
            if not _telling(frame):
                continue
            key = hashlib.sha256(np.ascontiguousarray(frame).tobytes()).digest()
            first, other = seen.setdefault(key, (stack, path))
            if (first, other) == (stack, path):
                continue
            kinds = {first.kind, stack.kind}
            # One uniform field may serve as flat and as reference.
            if other == path and first.band == stack.band and kinds == {"flat", "reference"}:
                continue
            two = "two repeats" if first is stack else f"{first.key} and {stack.key}"
            yield Suspicion(
                f"the same frame occurs twice: {two} have the same content",
                path,
                f"It equals {other} in all {frame.size} counts, which noise makes impossible for different frames.",
            )


def check_spectra_content(capture: Capture) -> Iterator[Suspicion]:
    """Detects spectra with equal values under two names."""
    distinct = {reference: (kind, key, s) for kind, key, reference, s in reversed(stated_columns(capture))}
    listed = list(reversed(list(distinct.items())))
    for index, (reference, (kind, key, spectrum)) in enumerate(listed):
        if np.ptp(spectrum.values) == 0:
            continue
        for other, (other_kind, _, another) in listed[:index]:
            same = spectrum.values.shape == another.values.shape and np.allclose(
                spectrum.values, another.values, rtol=1e-9, atol=0
            )
            if same and not (kind == other_kind == "reference radiance"):
                yield Suspicion(
                    f"the {kind} and the {other_kind} are the same table",
                    f"{key} ({reference})",
                    f"Its {spectrum.values.size} values equal those of {other}.",
                )


def _tokens(path: str) -> set[str]:
    # the sign of a power of ten parts no name: 8.6e-06s
    return set(re.split(r"(?<!\de)[+-]|[^A-Za-z0-9.+-]+", PurePosixPath(path).stem.lower()))


def check_names(capture: Capture, stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detects frames named after another band, kind or exposure, and bands with the filter of another band."""
    bands = {band.lower() for band in capture.band_ids if re.search(r"[A-Za-z]", band)}
    for stack in stacks:
        for path in stack.paths:
            tokens = _tokens(path)
            named = tokens & bands
            if stack.band is not None and named and stack.band.lower() not in named:
                yield Suspicion(
                    f"a frame of another band: {path} is listed under {stack.band}",
                    f"{stack.key}.frames",
                    f"Its name says {', '.join(sorted(named))}.",
                )
            kinds = {_KINDS[token] for token in tokens if token in _KINDS}
            own = {"bracket": "band"}.get(stack.kind, stack.kind)
            if kinds and own not in kinds and kinds | {own} != {"flat", "reference"}:
                yield Suspicion(
                    f"a {' or '.join(sorted(kinds))} frame is listed among the {own} frames",
                    f"{stack.key}.frames",
                    f"The file is called {path}.",
                )
    yield from _exposures_named(stacks)
    yield from _peaks(capture)


def _exposures_named(stacks: Sequence[Stack]) -> Iterator[Suspicion]:
    """Detects exposures other than file names say: all by one factor, or single ones."""
    named = [
        (stack, path, float(found[1]) * (1e-3 if found[2] == "ms" else 1.0))
        for stack in stacks
        for path in stack.paths
        for token in _tokens(path)
        if (found := _EXPOSURE.fullmatch(token))
    ]
    named = [row for row in named if row[2] > 0]
    factors = np.array([stack.exposure_s / seconds for stack, _, seconds in named])
    alike = factors.size >= _SEVERAL and np.ptp(np.log(factors)) < np.log(_AS_NAMED)
    if alike and not 1 / _AS_NAMED < (factor := float(np.median(factors))) < _AS_NAMED:
        stack, path, seconds = named[0]
        yield Suspicion(
            f"all exposures are {factor:.4g} times those in the names of the frames (another unit)",
            "exposure_s",
            f"{path} is listed under {stack.exposure_s:g} s, and {len(named) - 1} others likewise.",
        )
        return
    for (stack, path, seconds), factor in zip(named, factors, strict=True):
        if not 1 / _AS_NAMED < factor < _AS_NAMED:
            yield Suspicion(
                f"a frame of {seconds:g} s is listed under {stack.exposure_s:g} s",
                f"{stack.key}.exposure_s",
                f"The file is called {path}.",
            )


def _peaks(capture: Capture) -> Iterator[Suspicion]:
    """Detects bands named after a wavelength whose filter is that of another band."""
    named, centre = {}, {}
    for index, band in enumerate(capture.manifest.band):
        number = re.search(r"(?<!\d)(\d{3})(?!\d)", band.id)
        if number is None or band.transmittance is None or not 350 <= int(number[1]) <= 1000:
            continue
        curve = capture.light(band.transmittance)
        if curve.values.max() <= 0 or curve.wavelength_nm[-1] < 300:
            continue
        weight = np.maximum(curve.values, 0) * (curve.values > 0.5 * curve.values.max())
        named[band.id] = float(number[1])
        centre[band.id] = (index, float(np.average(curve.wavelength_nm, weights=weight)))
    for name, (index, peak) in centre.items():
        nearest = min(named, key=lambda other: abs(named[other] - peak))
        if nearest != name and abs(named[name] - peak) > 25 and abs(named[nearest] - peak) < 15:
            yield Suspicion(
                f"the filter of {name} is that of {nearest}",
                f"band[{index}] ({name}).transmittance",
                f"Its pass band is at {peak:.0f} nm; the band is named after {named[name]:.0f} nm.",
            )
