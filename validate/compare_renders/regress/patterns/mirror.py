"""Mirrored or upside-down pictures, by a test that needs no noise.

In pictures of one scene, the difference of a block from its mirror image has the same sign on both sides, or noise
decides. Where one picture is mirrored, the sign is opposite wherever the scene is not symmetric.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from .difference import Finding, sigma_of

__all__ = ["mirror_order"]

#: Blocks along a side of the picture: wider than the blotches of a denoiser, and 32 pairs.
_BLOCKS = 8
#: Ways to exchange blocks: name, and what is reversed.
_WAYS = {
    "mirrored left to right": (slice(None), slice(None, None, -1)),
    "upside down": (slice(None, None, -1), slice(None)),
    "turned by half a turn": (slice(None, None, -1), slice(None, None, -1)),
}


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
    for name, way in _WAYS.items():
        odd = before - before[way]
        signs = np.sum(odd * (after - after[way]), axis=-1)
        opposite = int((signs < 0).sum()) // 2
        probability = min(1.0, len(_WAYS) * float(bdtrc(opposite - 1, pairs, 0.5))) if opposite else 1.0
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
