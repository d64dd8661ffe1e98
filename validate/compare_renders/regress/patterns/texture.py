"""Textures: single pixels that differ by more than noise, in no pattern.

The square of a difference has its variance as mean, whatever its distribution and its correlation with neighbours. A
variance from independent batches has that mean, too. Their difference is tested as a self-normalised sum.

Of several cubes on each side, products of the differences of two cubes need no variance. Noise of independent cubes has
products of mean 0, whatever its distribution. What is the same in all cubes has a positive one.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from cboxlab.utils.distributions import student_quantile
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, minimum_filter, uniform_filter

from .difference import Difference, Finding, self_normalised, sigma_of

__all__ = ["FIXED_TEXTURE", "fine_structure", "fixed_pixels", "textures"]

#: Name of a texture of smooth parts.
FIXED_TEXTURE = "fixed texture"

#: Variance over the stated one that is allowed: errors of batches that share low-discrepancy numbers.
_ALLOWED = 1.5
#: Fine structure that a change carries, over the local change times the baseline's structure: for powers up to 2.
_CARRIED = 2.0
#: Pixels a side of a window whose mean is no texture.
_WINDOW_PX = 5
#: Pixels a side of the blocks whose sums are independent in smooth parts, where filters correlate pixels.
_BLOCK_PX = 4
#: Fewest blocks or pixels of a test.
_MIN_TERMS = 24
#: Smallest relative size of a texture: accuracy of single precision and of estimators.
_FLOOR = 1e-4
#: Edges of the squares in which cubes are compared, px: a texture of one object, in small pictures.
_SQUARES_PX = (12, 24, 48)
#: Pixels a side of the window whose mean is subtracted from the difference of each cube.
_AROUND_PX = 7
#: Scatters of the surroundings at which a pixel of a cube is cut: a firefly is in one cube.
_CUT = 4.0
#: Fewest products that count: those of normal noise count as a ninth of their number.
_MIN_EVEN = 10.0
#: Radiance below which a pixel counts as dark, over the mean.
_DARK = 1e-3
#: Squares whose correlation of neighbours is looked at, from the clearest on.
_CANDIDATES = 24
#: Largest distance of pixels whose correlation counts besides that of the whole picture, px: that of a pixel filter.
_REACH_PX = 3
#: Standard deviation of a normal number over the mean of its absolute value.
_NORMAL_OVER_MEAN = 1.2533


def textures(difference: Difference) -> list[Finding]:
    """Scatter of single pixels beyond their stated errors, by group of pixels.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    list of Finding
        One for each group with enough pixels; none where a side states no errors.
    """
    if difference.variance is None:
        return []
    findings = []
    for name, group in difference.groups.items():
        finding = _tested(difference, difference.variance, name, group)
        if finding is not None:
            findings.append(finding)
    return findings


def fixed_pixels(
    difference: Difference, apart: NDArray[np.float64], light: NDArray[np.float64], rounding: float = 0.0
) -> Finding | None:
    """Square, or the whole picture, whose pixels are most clearly alike in all cubes.

    Light and colours are compared, since a paint may have another texture of the same light. Each colour is taken
    without what it has in common with the light, whose noise is larger.

    Parameters
    ----------
    difference
        The difference.
    apart
        (n, g, y, x) candidate less baseline of independent cubes, in groups of bands.
    light
        (g, y, x) mean of both sides.
    rounding
        Relative standard deviation of single pixels from the steps of files.

    Returns
    -------
    Finding or None
        The size is the root mean square of the relative difference in all cubes. None for a single cube, and for small
        pictures.
    """
    if len(apart) < 2:
        return None
    used = np.logical_or.reduce(list(difference.groups.values()))
    fields, scales = _fields(apart, light, used, max(_FLOOR, 2 * rounding))
    products = (fields.sum(axis=0) ** 2 - (fields**2).sum(axis=0)) / (len(apart) * (len(apart) - 1))
    noise = fields - fields.mean(axis=0)
    groups = {"": slice(0, 1), " in colour": slice(None)} if len(light) > 1 else {"": slice(None)}
    tests = []
    for (kind, group), window in itertools.product(groups.items(), _windows(used.shape)):
        terms = products[group, *window].sum(axis=0)
        terms = terms[terms != 0]
        if _enough(terms, difference.clustering):
            tests.append((float(terms.sum()) / float(np.sqrt((terms**2).sum())), kind, group, window, terms))
    findings = []
    for _, kind, group, window, terms in sorted(tests, key=lambda test: -test[0])[:_CANDIDATES]:
        alike = max(difference.clustering, _alike(noise[:, group, *window]))
        if not _enough(terms, alike):
            continue
        statistic, share = self_normalised(terms, alike)
        probability = min(1.0, len(tests) * share / 2) if statistic > 0 else 1.0
        squares = (products[group, *window] * scales[group, *window] ** 2).sum(axis=(-2, -1)) / terms.size
        size, degrees = float(np.sqrt(max(float(squares.mean()), 0.0))), terms.size / alike - 1.0
        edge, sigma = min(products[0, *window].shape), sigma_of(size, probability, degrees)
        top, left = (axis.start for axis in window)
        where = "" if edge == min(used.shape) else f", x {left} to {left + edge - 1}, y {top} to {top + edge - 1}"
        name = f"a fixed pattern of single pixels{kind}{where}"
        findings.append(Finding(name, terms.size, size, sigma, degrees, probability, looks=float(len(tests))))
    return min(findings, key=lambda finding: finding.probability, default=None)


def fine_structure(difference: Difference) -> float:
    """Scatter of the baseline's pixels about their surroundings in smooth parts, noise included.

    Parameters
    ----------
    difference
        The difference.

    Returns
    -------
    float
        Root mean square over the mean light; 0 without smooth parts.
    """
    if not difference.smooth.any():
        return 0.0
    level = difference.level
    off = (level - median_filter(level, _WINDOW_PX, mode="nearest"))[difference.smooth]
    return float(np.sqrt(np.mean(off**2)) / max(float(level[difference.smooth].mean()), 1e-300))


def _fields(
    apart: NDArray[np.float64], light: NDArray[np.float64], used: NDArray[np.bool_], floor: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fine structure of each cube over its scatter (n, k, y, x), and the scatter (k, y, x).

    The light is the first of k. It is 0 where the scatter is below a floor, relative to the light.
    """
    local = np.stack([median_filter(group, _WINDOW_PX, mode="nearest") for group in light])
    local = np.maximum(local, _DARK * np.maximum(light.mean(axis=(1, 2), keepdims=True), 1e-300))
    relative = np.concatenate([(apart.sum(axis=1) / local.sum(axis=0))[:, None], (apart / local)[:, 1:]], axis=1)
    relative = np.where(used, relative, 0.0)
    fine = _about_means(relative, np.broadcast_to(used, relative.shape[1:]))
    scales, share = np.zeros(fine.shape[1:]), uniform_filter(used.astype(float), _AROUND_PX)
    for number in range(fine.shape[1]):
        for other in range(number):
            first, second = fine[:, other], fine[:, number]
            fine[:, number] = second - first * float((first * second).sum()) / max(float((first**2).sum()), 1e-300)
        typical = np.abs(fine[:, number]).mean(axis=0)
        scales[number] = _NORMAL_OVER_MEAN * uniform_filter(typical, _AROUND_PX) / np.maximum(share, 1e-9)
    noisy = used & (scales > floor)
    cut = np.where(noisy, np.clip(fine / np.where(noisy, scales, 1.0), -_CUT, _CUT), 0.0)
    return _about_means(cut, noisy), scales  # cut noise that is skew has a mean where one side has more samples


def _about_means(pictures: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Pictures (n, k, y, x) less means of the used pixels around (k, y, x); 0 elsewhere."""
    window = (1, _AROUND_PX, _AROUND_PX)
    share = np.maximum(uniform_filter(used.astype(float), window), 1e-9)
    return np.where(used, pictures - uniform_filter(pictures, (1, *window)) / share, 0.0)


def _windows(shape: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """The whole picture, and squares that overlap by half."""
    yield slice(0, shape[0]), slice(0, shape[1])
    for edge in _SQUARES_PX:
        starts = (range(0, size - edge + 1, edge // 2) for size in shape)
        for row, column in itertools.product(*starts):
            yield slice(row, row + edge), slice(column, column + edge)


def _enough(terms: NDArray[np.float64], alike: float) -> bool:
    """Whether a sum has enough independent terms, and is not ruled by a few of them."""
    if terms.size < _MIN_TERMS * alike:
        return False
    return float((terms**2).sum()) ** 2 >= _MIN_EVEN * alike * float((terms**4).sum())


def _alike(noise: NDArray[np.float64]) -> float:
    """Number of neighbouring products that correlation makes one, by noise (n, k, y, x)."""
    squares = np.maximum((noise**2).mean(axis=(0, 2, 3)), 1e-300)
    height, width = noise.shape[2:]
    result = 1.0
    for down, right in itertools.product(range(_REACH_PX + 1), range(-_REACH_PX, _REACH_PX + 1)):
        if (down, right) > (0, 0):
            first = noise[:, :, : height - down, max(-right, 0) : width - max(right, 0)]
            second = noise[:, :, down:, max(right, 0) : width - max(-right, 0)]
            result += 2 * float(np.mean(((first * second).mean(axis=(0, 2, 3)) / squares) ** 2))
    return result


def _tested(difference: Difference, variance: NDArray, name: str, group: NDArray[np.bool_]) -> Finding | None:
    """Test of one group."""
    level = median_filter(difference.level, _WINDOW_PX, mode="nearest")
    if name == "smooth parts":
        share = np.maximum(uniform_filter(group.astype(float), _WINDOW_PX), 1e-9)
        mean = uniform_filter(np.where(group, difference.relative, 0.0), _WINDOW_PX) / share
        off = (difference.relative - mean) * np.maximum(level, 1e-3 * level.mean())
        scale = np.sqrt(_around(variance, group))
        # a change in proportion to the picture, or to a power of it, carries the picture's own fine structure
        carried = _CARRIED * mean * (difference.level - level)
        blocks = _blocks(difference.level.shape)
    else:
        # light at edges varies by the local range, so that squares over it are comparable
        off, carried = difference.total, np.zeros(group.shape)
        quiet = median_filter(difference.level, 3, mode="nearest")
        scale = maximum_filter(quiet, 3) - minimum_filter(quiet, 3) + 1e-2 * level
        blocks = np.arange(group.size).reshape(group.shape)
    excess = off**2 - _ALLOWED * variance - (_FLOOR * difference.level) ** 2 - carried**2
    used = group & (scale > 0)
    if not used.any():
        return None
    sums = np.bincount(blocks[used], excess[used] / scale[used] ** 2).astype(float)
    terms = sums[np.bincount(blocks[used]) > 0]
    if terms.size < _MIN_TERMS:
        return None
    pixels_alike = difference.clustering * terms.size / int(used.sum())
    statistic, probability = self_normalised(terms, max(1.0, pixels_alike))
    mean_level = float(difference.level[used].mean())
    size = float(np.sqrt(max(np.mean(off[used] ** 2 - variance[used]), 0.0))) / max(mean_level, 1e-300)
    share_ = probability / 2 if statistic > 0 else 1.0
    student = float(student_quantile(max(share_, 1e-300) / 2, terms.size - 1)) if share_ < 1 else 0.0
    sigma = size / student if student > 0 and size > 0 else _FLOOR
    label = FIXED_TEXTURE if name == "smooth parts" else f"single pixels of {name}"
    ratio = float(
        np.sqrt((off[used] ** 2 / scale[used] ** 2).sum() / max((variance[used] / scale[used] ** 2).sum(), 1e-300))
    )
    return Finding(label, int(used.sum()), size, sigma, terms.size - 1.0, share_, {"times_the_stated_error": ratio})


def _around(variance: NDArray[np.float64], group: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(y, x) mean variance of the pixels around each one, its own left out."""
    count = uniform_filter(group.astype(float), _WINDOW_PX) * _WINDOW_PX**2 - group
    total = uniform_filter(np.where(group, variance, 0.0), _WINDOW_PX) * _WINDOW_PX**2 - np.where(group, variance, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(count > 0.5, np.maximum(total, 0.0) / count, 0.0)


def _blocks(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """(y, x) number of each pixel's block."""
    rows, columns = (np.arange(size) // _BLOCK_PX for size in shape)
    return rows[:, None] * (int(columns[-1]) + 1) + columns
