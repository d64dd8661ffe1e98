"""Mirrored, turned or rolled pictures, by two tests that need no noise.

In pictures of one scene, the difference of a block from its mirror image has the same sign on both sides, or noise
decides. Where one picture is mirrored, the sign is opposite wherever the scene is not symmetric.

Fine structure of a scene is at the same place in equal pictures: their product is largest where one lies on the other
unmoved. A product that is larger for a moved or mirrored picture means that the scene is there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter
from scipy.special import bdtrc

from .difference import Finding, self_normalised, sigma_of
from .fine_light import BLOCK_PX, block_sums

__all__ = ["mirror_order", "moved_texture"]

#: Blocks along a side of the picture: wider than the blotches of a denoiser, and 32 pairs.
_BLOCKS = 8
#: Ways to exchange blocks: name, and what is reversed.
_EXCHANGES = {
    "mirrored left to right": (slice(None), slice(None, None, -1)),
    "upside down": (slice(None, None, -1), slice(None)),
    "turned by half a turn": (slice(None, None, -1), slice(None, None, -1)),
}
#: Ways to lay one picture on the other: name, and the picture.
_WAYS: dict[str, Callable[[NDArray], NDArray]] = {
    "moved": lambda picture: picture,
    "mirrored left to right": lambda picture: picture[:, ::-1],
    "upside down": lambda picture: picture[::-1],
    "turned by half a turn": lambda picture: picture[::-1, ::-1],
}
#: Pixels a side of the window whose mean is subtracted: what remains is fine structure.
_WINDOW_PX = 5
#: Scatters at which single pixels are cut: fireflies would rule the product.
_CUT = 3.0
#: Fewest blocks of a test.
_LEAST_BLOCKS = 36


def mirror_order(baseline: NDArray[np.float64], difference: NDArray[np.float64]) -> Finding | None:
    """Sign test of what is not symmetric in both pictures.

    Parameters
    ----------
    baseline
        (y, x, w) picture.
    difference
        (y, x, w) other picture minus the baseline.

    Returns
    -------
    Finding or None
        The clearest of three exchanges; its size is the root mean square of the parts that are not symmetric, over the
        mean. None for pictures below 16 pixels a side.
    """
    if min(baseline.shape[:2]) < 2 * _BLOCKS:
        return None
    before = _block_means(baseline)
    after = before + _block_means(difference)
    pairs = _BLOCKS**2 // 2
    findings = []
    for name, way in _EXCHANGES.items():
        odd = before - before[way]
        signs = np.sum(odd * (after - after[way]), axis=-1)
        opposite = int((signs < 0).sum()) // 2
        probability = min(1.0, len(_EXCHANGES) * float(bdtrc(opposite - 1, pairs, 0.5))) if opposite else 1.0
        size = float(np.sqrt(np.mean(odd**2)) / max(float(np.abs(before).mean()), 1e-300))
        pixels = int(np.prod(baseline.shape[:2]))
        findings.append(Finding(name, pixels, size, sigma_of(size, probability, pairs - 1.0), pairs - 1.0, probability))
    return min(findings, key=lambda finding: finding.probability)


def _block_means(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """(8, 8, w) means of blocks that are mirror images of each other."""
    height, width = (size // _BLOCKS for size in picture.shape[:2])
    top, side = ((size - _BLOCKS * block) // 2 for size, block in zip(picture.shape, (height, width), strict=False))
    inner = picture[top : top + _BLOCKS * height, side : side + _BLOCKS * width]
    return np.asarray(inner.reshape(_BLOCKS, height, _BLOCKS, width, -1).mean(axis=(1, 3)))


def moved_texture(baseline: NDArray[np.float64], candidate: NDArray[np.float64]) -> Finding | None:
    """Clearest place or mirror image at which the candidate fits better than unmoved.

    Parameters
    ----------
    baseline, candidate
        (y, x) pictures, summed over wavelengths.

    Returns
    -------
    Finding or None
        The size is the part of the fine structure's variance that is found there, less that found unmoved. None for
        small pictures.
    """
    height, width = baseline.shape
    if (height // BLOCK_PX) * (width // BLOCK_PX) < _LEAST_BLOCKS:
        return None
    first, second = _fine(baseline), _fine(candidate)
    if not (first.any() and second.any()):
        return None
    findings = []
    for name, way in _WAYS.items():
        other = way(second)
        products = np.fft.irfft2(np.fft.rfft2(first).conj() * np.fft.rfft2(other), first.shape)
        down, right = (int(n) for n in np.unravel_index(int(products.argmax()), products.shape))
        if name == "moved" and (down, right) == (0, 0):
            continue
        moved = np.roll(other, (-down, -right), (0, 1))
        terms = first * (moved - second)
        statistic, share = self_normalised(block_sums(terms))
        looks = len(_WAYS) * baseline.size
        probability = min(1.0, looks * share) if statistic > 0 else 1.0
        size = float(terms.mean() / np.mean(first**2))
        by = (right + width // 2) % width - width // 2, (down + height // 2) % height - height // 2
        label = f"{name} by {by[0]} px right, {by[1]} px down" if name == "moved" else name
        sigma = sigma_of(size, probability, 36.0)
        findings.append(Finding(f"fine structure {label}", baseline.size, size, sigma, 36.0, probability))
    return min(findings, key=lambda finding: finding.probability, default=None)


def _fine(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) relative fine structure over its typical size, cut."""
    local = median_filter(picture, _WINDOW_PX, mode="wrap")
    relative = picture / np.maximum(local, 1e-3 * max(float(local.mean()), 1e-300)) - 1
    fine = relative - uniform_filter(relative, _WINDOW_PX, mode="wrap")
    scale = robust_sigma(fine)
    return np.clip(fine / scale, -_CUT, _CUT) if scale > 0 else np.zeros_like(fine)
