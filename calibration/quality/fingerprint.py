"""Checks by the sensor's pattern: the pixels' sensitivities appear at the same position in all lit frames."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from ..correction import DarkLibrary
from .stacks import Stack
from .suspicion import Suspicion

__all__ = ["check_fingerprint", "check_flat_shapes"]

#: Thresholds of a correlation in standard deviations; with 8 orientations and a few thousand shifts, noise reaches 5.5.
_FOUND, _LOST = 9.0, 4.5
_STRONG = 20.0
_STRUCTURE = 0.04
#: Smallest factor of the flats' pattern in a photograph over that in a flat, and standard deviations to be sure of it.
_LEAST_SHARE, _SURE = 0.4, 4.0
_TURNS = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "upside down": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "exchanged in rows and columns": lambda image: image.T,
    "turned by 90 degrees": lambda image: np.rot90(image),
    "turned by 270 degrees": lambda image: np.rot90(image, 3),
    "transposed about the other diagonal": lambda image: image[::-1, ::-1].T,
}


def _detail(net: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) relative difference of each pixel from its neighbours, where the picture is smooth; mean 0."""
    local = uniform_filter(net, 5)
    floor = 0.02 * max(float(np.percentile(net, 99)), 1e-9)
    high = (net - local) / np.maximum(local, floor)
    high[local < floor] = 0.0
    # Reduce the weight of edges in the picture.
    spread = np.sqrt(np.maximum(uniform_filter(high**2, 5), 0.0)) + 1e-12
    usual = float(np.median(spread[spread > 1e-9])) if np.any(spread > 1e-9) else 1.0
    high = usual * np.clip(high / np.maximum(spread, usual), -4, 4) * np.minimum(1.0, (usual / spread) ** 2)
    return np.asarray(high - high.mean(), np.float64)


def _pattern(net: NDArray[np.float64]) -> NDArray[np.float64]:
    """``_detail`` (y, x) with unit variance."""
    detail = _detail(net)
    return np.asarray(detail / max(float(detail.std()), 1e-12), np.float64)


def _share(detail: NDArray[np.float64], pattern: NDArray[np.float64]) -> tuple[float, float]:
    """The factor with which a pattern of unit variance is in a detail, and its standard deviation by chance."""
    found = _correlations(detail, pattern) / np.sqrt(detail.size)
    return float(found[0, 0]), float(found.std())


def _correlations(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) circular correlation of two patterns for each shift, in standard deviations of noise."""
    product = np.fft.rfft2(a) * np.conj(np.fft.rfft2(b))
    found = np.fft.irfft2(product, s=a.shape)
    return np.asarray(found / np.sqrt(a.size), np.float64)


def _place(peak: tuple[int, ...], shape: tuple[int, int]) -> tuple[int, int]:
    v, u = (int(p) if p <= n // 2 else int(p) - n for p, n in zip(peak, shape, strict=True))
    return u, v


def check_fingerprint(stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detects frames that are mirrored, turned or shifted relative to the flats, or do not show their pattern."""
    net = {s.key: s.mean - s.thinned(dark.at(s.exposure_s)) for s in stacks if s.kind in ("band", "flat", "reference")}
    flats = [s for s in stacks if s.kind == "flat" and s.mean.shape == net[s.key].shape]
    places = {s.place for s in flats}
    if len(flats) < 2 or len(places) != 1:
        return
    patterns = {key: _pattern(image) for key, image in net.items()}
    common = np.mean([patterns[s.key] for s in flats], axis=0)
    pairs = [float(_correlations(patterns[a.key], patterns[b.key])[0, 0]) for a, b in itertools.pairwise(flats)]
    # Without a pattern of the sensor (or in simulations without noise) nothing can be tested.
    if np.median(pairs) < _STRONG:
        return
    lost = []
    for stack in stacks:
        if stack.kind not in ("band", "flat", "reference") or stack.place not in places:
            continue
        own = patterns[stack.key]
        others = common if stack.kind != "flat" else (common * len(flats) - own) / (len(flats) - 1)
        found = _correlations(own, others / others.std())
        here = float(found[0, 0])
        if here > _LOST:
            continue
        moved = _moved(own, others / others.std(), found)
        if moved is None:
            if stack.kind == "band":
                lost.append(stack)
        else:
            how, strength = moved
            yield Suspicion(
                f"the {stack.kind} frames are {how} against the flats",
                f"{stack.key}.frames",
                f"The correlation of the pixels' sensitivities with those of the flats is {strength:.0f} standard "
                f"deviations when they are {how}, {here:.1f} as stored.",
            )
    unit = common / common.std()
    usual = float(np.median([_share(_detail(net[s.key]), unit)[0] for s in flats]))
    shares = {stack.key: _share(_detail(net[stack.key]), unit) for stack in lost}
    flat_fielded = [
        key for key, (share, by_chance) in shares.items() if share + _SURE * by_chance < _LEAST_SHARE * usual
    ]
    if flat_fielded:
        yield Suspicion(
            "the photographs do not show the pixels' sensitivities that the flats show (already divided by a flat, or "
            "another sensor)",
            ", ".join(flat_fielded),
            f"The flats' pattern is in them with a factor of {shares[flat_fielded[0]][0] / usual:.2f} +- "
            f"{shares[flat_fielded[0]][1] / usual:.2f}; about 1 is expected.",
        )


def _moved(
    own: NDArray[np.float64], others: NDArray[np.float64], found: NDArray[np.float64]
) -> tuple[str, float] | None:
    """Orientation or shift of the pattern relative to the others, and its significance; None if it is not found."""
    if found.max() > _FOUND:
        u, v = _place(np.unravel_index(int(found.argmax()), found.shape), own.shape)  # type: ignore[arg-type]
        return f"moved by ({u}, {v}) px", float(found.max())
    for how, turn in _TURNS.items():
        turned = turn(own)
        if turned.shape == others.shape:
            other = _correlations(turned, others)
            if other.max() > _FOUND:
                return how, float(other.max())
    return None


def check_flat_shapes(stacks: Sequence[Stack], dark: DarkLibrary) -> Iterator[Suspicion]:
    """Detects flats and references with structure, which a uniform field does not have."""
    for stack in stacks:
        if stack.kind not in ("flat", "reference") or min(stack.mean.shape) < 64:
            continue
        net = stack.mean - stack.thinned(dark.at(stack.exposure_s))
        smooth = gaussian_filter(net, 2.0)
        level = float(np.median(net))
        if level <= 0:
            continue
        broad = gaussian_filter(net, 6.0)
        # A filter seen obliquely darkens the corners steeply; a picture shows in the middle as well.
        inner = tuple(slice(n // 5, n - n // 5) for n in net.shape)
        detail = ((smooth - broad) / np.maximum(broad, 0.1 * level))[inner]
        structure = float(np.sqrt(np.mean(detail**2)))
        if structure > _STRUCTURE:
            yield Suspicion(
                f"the {stack.kind} frames of {stack.band} show a picture, not a uniform field",
                f"{stack.key}.frames",
                f"They vary by {structure:.0%} (rms) over 2 to 6 px; flats of a uniform field stay below 1%.",
            )
