"""Pictures of a texture elsewhere, rolled or mirrored, by a test that needs no noise.

Fine structure of a scene is at the same place in equal pictures: their product is largest where one lies on the other
unmoved. A product that is larger for a moved or mirrored picture means that the scene is there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter

from .difference import Finding, self_normalised, sigma_of

__all__ = ["moved_texture"]

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
#: Pixels a side of the blocks whose sums are independent: wider than a pixel filter.
_BLOCK_PX = 4
#: Fewest blocks of a test.
_LEAST_BLOCKS = 36


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
    if (height // _BLOCK_PX) * (width // _BLOCK_PX) < _LEAST_BLOCKS:
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
        statistic, share = self_normalised(_block_sums(terms))
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
    scale = 1.4826 * float(np.median(np.abs(fine)))
    return np.clip(fine / scale, -_CUT, _CUT) if scale > 0 else np.zeros_like(fine)


def _block_sums(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) sums of square blocks."""
    height, width = (size // _BLOCK_PX for size in terms.shape)
    inner = terms[: height * _BLOCK_PX, : width * _BLOCK_PX]
    return np.asarray(inner.reshape(height, _BLOCK_PX, width, _BLOCK_PX).sum(axis=(1, 3)).ravel())
