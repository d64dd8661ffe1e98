"""Contrast and place of fine structure, by tests that need no noise.

Both sides show one structure with independent noise. Their product is then at most half the sum of their squares. Where
one side is blurred, the product is larger than the square of that side. In the same way the product with the other
side's slopes has no sign, unless the structure moved. Squares of blocks weight both tests. They are the same for
exchanged sides. Noise, filters and denoisers of both sides thus leave the means at 0 or below.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from .difference import Difference, Finding, common_size, self_normalised

__all__ = [
    "BLOCK_PX",
    "alike_along_edges",
    "block_sums",
    "fine_light",
    "moved_slightly",
    "other_contrast",
    "sum_by_blocks",
]

#: Pixels a side of the windows whose means are subtracted for the contrast: narrow filters change the finest structure
#: alone, denoisers leave it and change wider structure.
_CONTRAST_PX = (3, 5, 7)
#: The same for the place, and widths of the Gaussians that smooth slopes, px: wide ones have far less noise, and narrow
#: ones see textures of single pixels.
_PLACE_PX = ((5, 0.0), (9, 1.2))
#: Tests of the place: four motions at each width.
_MOTIONS = 4 * len(_PLACE_PX)
#: Width of the filter that gives the local level of the light, px: a product of a pixel's noise with it is small.
_LEVEL_PX = 2.5
#: Pixels a side of the blocks whose sums are independent: wider than a pixel filter.
BLOCK_PX = 4
#: Fewest blocks of a test.
_LEAST_BLOCKS = 36
#: Squares of a block over the median block's, from which it counts about fully.
_STRUCTURED = 2.0
#: Squares of a block's difference over the median block's, below which it counts no more.
_QUIET = 0.3
#: Blocks of equal weight below which few blocks agree.
_FEW_BLOCKS = 30.0
#: Correlation of both sides in a block from which it shows a common structure.
_ALIKE = 0.3
#: Median square of the difference over that of steps, up to which steps explain it: normal noise has 0.45 of its mean.
_OVER_STEPS = 2.0
#: Standard deviations at which single pixels are cut along edges: a firefly would rule its block.
_MOST_SIGMAS = 4.0


def other_contrast(difference: Difference, steps: float = 0.0) -> Finding | None:
    """Fine structure of one side that is weaker in the other: a blur, a filtered texture.

    Parameters
    ----------
    difference
        The difference.
    steps
        Relative standard deviation from the steps in which files store values.

    Returns
    -------
    Finding or None
        The size is the part of the contrast that the weaker side lacks. None for small pictures.
    """
    findings = [f for window in _CONTRAST_PX for f in _contrast(difference, steps, window)]
    return min(findings, key=lambda finding: finding.probability, default=None)


def _contrast(difference: Difference, steps: float, window_px: int) -> list[Finding]:
    """Tests of both sides in one window; none for small pictures."""
    fine = fine_light(difference, window_px)
    blocks = _blocks(fine)
    if blocks is None or _by_steps(fine, steps):
        return []
    (before, after, product), alike, (structured, quiet) = blocks
    weights = alike * structured, quiet
    structure, findings = np.maximum(product, 0.0), []
    for name, weaker in (("weaker", after), ("stronger", before)):
        size, sigma, degrees, share = _common(product - weaker, structure, weights, difference)
        probability = min(1.0, len(_CONTRAST_PX) * share) if size > 0 else 1.0
        label = f"fine structure of the candidate {name}"
        findings.append(_finding(label, difference, max(size, 0.0), sigma, degrees, probability))
    return findings


def moved_slightly(difference: Difference, steps: float = 0.0) -> Finding | None:
    """Fine structure moved by a part of a pixel or by some: along x or y, turned, or magnified.

    Parameters
    ----------
    difference
        The difference.
    steps
        Relative standard deviation from the steps in which files store values.

    Returns
    -------
    Finding or None
        The size is the displacement in px, to first order; of a turned or magnified picture that at half a width from
        its middle. None for small pictures.
    """
    findings = [f for window, width in _PLACE_PX for f in _motions(difference, steps, window, width)]
    return min(findings, key=lambda finding: finding.probability, default=None)


def _motions(difference: Difference, steps: float, window_px: int, width_px: float) -> list[Finding]:
    """Tests of all motions by slopes of one width; none for small pictures."""
    fine = fine_light(difference, window_px)
    blocks = _blocks(fine)
    if blocks is None or _by_steps(fine, steps):
        return []
    _, _, weights = blocks
    smooth = [gaussian_filter(p, width_px, mode="nearest") if width_px else p for p in fine]
    y, x = (axis - axis.max() / 2 for axis in np.indices(fine[0].shape))
    y, x = 2 * y / fine[0].shape[1], 2 * x / fine[0].shape[1]
    sharp, slopes = ([np.gradient(p) for p in pictures] for pictures in (fine, smooth))
    motions: dict[str, tuple[Any, Any]] = {
        "moved down": (1.0, 0.0),
        "moved to the right": (0.0, 1.0),
        "turned clockwise": (x, -y),
        "magnified": (y, x),
    }
    findings = []
    for name, (down, right) in motions.items():
        along, sharply = ([down * slope[0] + right * slope[1] for slope in sides] for sides in (slopes, sharp))
        terms = block_sums(fine[0] * along[1] - fine[1] * along[0])
        squares = np.maximum(block_sums(sharply[0] * along[1] + sharply[1] * along[0]), 0.0)
        size, sigma, degrees, share = _common(terms, squares, weights, difference)
        probability = min(1.0, _MOTIONS * share)
        findings.append(_finding(name, difference, size, sigma, degrees, probability, "px"))
    return findings


def _common(
    terms: NDArray[np.float64],
    norms: NDArray[np.float64],
    weights: tuple[NDArray[np.float64], ...],
    difference: Difference,
) -> tuple[float, float, float, float]:
    """Size that blocks have in common, with sigma, degrees of freedom and probability.

    It is the clearest of four tests. Large changes are clear by their sign in many blocks, small ones by their
    agreement in few. Few blocks may be parts of fewer lamps, and have to agree when four are taken as one, too.
    """
    tests, alike = [], _alike(difference)
    for weight in weights:
        parts, sizes = weight * terms, weight * norms
        of_four = [_merged(values, difference.level.shape) for values in (parts, sizes)]
        size, sigma, degrees, probability = common_size(parts, sizes, alike)
        if degrees < _FEW_BLOCKS:
            probability = max(probability, common_size(of_four[0], of_four[1])[3])
        _, by_sign = self_normalised(parts, alike)
        if float((parts**2).sum()) ** 2 < _FEW_BLOCKS * float((parts**4).sum()):
            by_sign = max(by_sign, self_normalised(of_four[0])[1])
        share = min(1.0, 2 * len(weights) * min(probability, by_sign))
        tests.append((share, size, sigma, degrees))
    share, size, sigma, degrees = min(tests)
    return size, sigma, degrees, share


def _merged(values: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(n,) sums of 2 x 2 blocks, the last ones of fewer."""
    rows, columns = (size // BLOCK_PX for size in shape)
    grid = values.reshape(rows, columns)
    return np.add.reduceat(np.add.reduceat(grid, range(0, rows, 2), axis=0), range(0, columns, 2), axis=1).ravel()


def _by_steps(fine: tuple[NDArray[np.float64], NDArray[np.float64]], steps: float) -> bool:
    """Whether the steps in which files store values explain the difference in fine structure."""
    first, second = fine
    used = first != 0
    return bool(used.any()) and float(np.median((first - second)[used] ** 2)) <= _OVER_STEPS * steps**2


def _alike(difference: Difference) -> float:
    """Number of neighbouring blocks that correlation makes one.

    Products of both sides are correlated over half the area of their noise.
    """
    return 1 + difference.clustering / (2 * BLOCK_PX**2)


def _finding(
    name: str, difference: Difference, size: float, sigma: float, degrees: float, probability: float, unit: str = "1"
) -> Finding:
    """Finding of a size that blocks have in common."""
    sigma = float(np.clip(sigma, 1e-9, 1e9))
    return Finding(name, int(difference.smooth.size), size, sigma, max(degrees, 1.0), probability, unit=unit)


def fine_light(difference: Difference, window_px: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fine structure of both sides, relative to a common smooth light.

    Parameters
    ----------
    difference
        The difference.
    window_px
        Pixels a side of the window whose mean is subtracted.

    Returns
    -------
    first, second : NDArray
        (y, x) of baseline and candidate.
    """
    baseline, candidate = difference.level, difference.level + difference.total
    used = np.logical_or.reduce([difference.smooth, *difference.groups.values()])
    light = gaussian_filter(0.5 * (baseline + candidate), _LEVEL_PX, mode="nearest")
    light = np.maximum(light, 1e-3 * max(float(light.mean()), 1e-300))
    first, second = (p - uniform_filter(p, window_px, mode="nearest") for p in (baseline, candidate))
    return np.where(used, first, 0.0) / light, np.where(used, second, 0.0) / light


def _blocks(
    fine: tuple[NDArray, NDArray],
) -> tuple[tuple[NDArray, NDArray, NDArray], NDArray[np.float64], tuple[NDArray[np.float64], ...]] | None:
    """Squares of both sides and their product in blocks, with likeness and weights.

    The first weights are about alike for all structured blocks, the second are larger where both sides agree.
    """
    first, second = fine
    height, width = first.shape
    if (height // BLOCK_PX) * (width // BLOCK_PX) < _LEAST_BLOCKS:
        return None
    before, after, product = (block_sums(p) for p in (first**2, second**2, first * second))
    both = before + after
    if not both.any():
        return None
    alike = np.clip(2 * product / np.maximum(both, 1e-300) - _ALIKE, 0.0, None)
    apart = both - 2 * product
    structured, quiet = (p + part * float(np.median(p[both > 0])) for p, part in ((both, _STRUCTURED), (apart, _QUIET)))
    return (before, after, product), alike, (1 / np.maximum(structured, 1e-300), alike / np.maximum(quiet, 1e-300))


def block_sums(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums of square blocks.

    Parameters
    ----------
    terms
        (y, x) terms of the pixels.

    Returns
    -------
    NDArray
        (n,) sums.
    """
    height, width = (size // BLOCK_PX for size in terms.shape)
    inner = terms[: height * BLOCK_PX, : width * BLOCK_PX]
    return np.asarray(inner.reshape(height, BLOCK_PX, width, BLOCK_PX).sum(axis=(1, 3)).ravel())


def sum_by_blocks(
    used: NDArray[np.bool_], terms: NDArray[np.float64], norms: NDArray[np.float64], clustering: float
) -> tuple[float, float]:
    """Standard deviation of a sum of terms by its blocks, and degrees of freedom.

    Filters and denoisers move an edge as a whole, so that its pixels agree by chance.

    Parameters
    ----------
    used
        (y, x) pixels of the terms, n of them.
    terms
        (n,) terms.
    norms
        (n,) terms of a size of 1.
    clustering
        Number of pixels that correlation makes one.

    Returns
    -------
    sigma, degrees : float
        The standard deviation is infinite for few blocks.
    """
    pictures = np.zeros((2, *used.shape))
    pictures[:, used] = terms, norms
    alike = 1 + clustering / BLOCK_PX**2
    _, sigma, degrees, _ = common_size(block_sums(pictures[0]), block_sums(pictures[1]), alike)
    return sigma * float(norms.sum()), degrees


def alike_along_edges(rest: NDArray[np.float64], edges: NDArray[np.bool_], smooth: NDArray[np.bool_]) -> float:
    """Probability that noise makes neighbours at edges as alike as what a name leaves.

    A filter correlates noise at edges as it does in smooth parts. A shadow or an object that moved leaves one sign
    along its edges, far below the noise of single pixels. Products of neighbours at edges are summed by blocks, less
    their expectation from smooth parts, and their sum is divided by its own scatter.

    Parameters
    ----------
    rest
        (y, x) what is left of a difference, over its standard deviation.
    edges, smooth
        (y, x) pixels at edges, and away from them.

    Returns
    -------
    float
        The probability, one-sided; 1 without neighbours at edges or in smooth parts.
    """
    products, squares = np.zeros((2, 2, *rest.shape))
    values = np.clip(rest, -_MOST_SIGMAS, _MOST_SIGMAS)
    for first, second in ((np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:])):
        for number, mask in enumerate((edges, smooth)):
            both = mask[first] & mask[second]
            products[number][first] += both * values[first] * values[second]
            squares[number][first] += both * 0.5 * (values[first] ** 2 + values[second] ** 2)
    if not squares.sum(axis=(1, 2)).all():
        return 1.0
    expected = float(products[1].sum() / squares[1].sum())
    excess = block_sums(products[0] - expected * squares[0])
    statistic, probability = self_normalised(excess[excess != 0])
    return 0.5 * probability if statistic > 0 else 1.0
