"""Difference of two pictures as tests of patterns take it, and their findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from cboxlab.utils.distributions import robust_sigma, student_quantile, student_tail
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .correlation import clustering_by_filter

__all__ = ["Difference", "Finding", "common_size", "self_normalised", "sigma_of"]

#: Radiance below which a pixel counts as dark, over the mean.
_DARK = 1e-3
#: Pixels a side of the median that gives the local level: wider than a cell of the finest checkerboard.
_LEVEL_PX = 5
#: Pixels that correlation makes one, above which the noise is none of a pixel filter: three pixels wide.
_WIDEST_FILTER = 6.0
#: Fewest degrees of freedom of a common size: the scatter of fewer blocks says little.
_LEAST_DEGREES = 4.0
#: Scatters at which single pixels are cut in the look at the correlation of noise.
_CUT = 6.0


@dataclass(frozen=True)
class Finding(FrozenMappings):
    """Test of one kind of pattern, at its clearest instance."""

    #: Pattern in words.
    name: str
    #: Number of pixels.
    pixels: int
    #: Relative size of the pattern.
    size: float
    #: Standard deviation of ``size``.
    sigma: float
    #: Degrees of freedom of ``sigma``.
    degrees: float
    #: Probability of a pattern this clear in equal pictures, all instances of the kind counted.
    probability: float
    #: Numbers of the pattern by name, for its removal.
    parameters: Mapping[str, Any] = field(default_factory=dict)
    #: Unit of ``size``.
    unit: str = "1"
    #: Instances of the kind that ``probability`` counts.
    looks: float = 1.0
    #: Standard deviation of the size at a typical place; None for ``sigma``.
    typical_sigma: float | None = None


@dataclass(frozen=True, eq=False)
class Difference(FrozenMappings):
    """Difference of two pictures, summed over wavelengths."""

    #: (y, x) baseline.
    level: NDArray[np.float64]
    #: (y, x) candidate less baseline, without outliers.
    total: NDArray[np.float64]
    #: (y, x) variance of ``total``; None where a side states no errors.
    variance: NDArray[np.float64] | None
    #: (y, x) pixels away from edges, lamp and border.
    smooth: NDArray[np.bool_]
    #: (y, x) pixels by group, for tests of single pixels.
    groups: Mapping[str, NDArray[np.bool_]]
    #: Number of pixels that correlation makes one.
    clustering: float = 1.0

    @cached_property
    def relative(self) -> NDArray[np.float64]:
        """(y, x) difference over the local level of both pictures; 0 outside of smooth parts."""
        local = median_filter(self.level + 0.5 * self.total, _LEVEL_PX, mode="nearest")
        floor = _DARK * max(float(local.mean()), 1e-300)
        return np.where(self.smooth, self.total / np.maximum(local, floor), 0.0)

    @cached_property
    def of_pixel_filter(self) -> bool:
        """Whether the noise reaches over three pixels at most, as that of a pixel filter.

        That of a denoiser reaches further.
        """
        if not self.smooth.any() or self.clustering > _WIDEST_FILTER:
            return False
        off = self.relative - np.median(self.relative[self.smooth])
        scatter = robust_sigma(off[self.smooth])
        return clustering_by_filter(np.clip(off / max(scatter, 1e-300), -_CUT, _CUT), self.smooth) is not None


def self_normalised(terms: NDArray[np.float64], alike: float = 1.0) -> tuple[float, float]:
    """Sum of independent terms over the root of their sum of squares.

    It needs no known variance, and heavy tails make it smaller.

    Parameters
    ----------
    terms
        (n,) terms of mean 0 in equal pictures, two or more.
    alike
        Number of neighbouring terms that correlation makes one.

    Returns
    -------
    statistic
        The quotient; at most the root of n.
    probability
        Probability of a quotient this large, of Student's t.
    """
    count = terms.size / alike
    root = float(np.sqrt((terms**2).sum()))
    if count <= 2 or root == 0:
        return 0.0, 1.0
    quotient = float(terms.sum()) / root / np.sqrt(alike)
    below = max(1 - quotient**2 / count, 1e-12)
    student = quotient * np.sqrt((count - 1) / count / below)
    return quotient, float(2 * student_tail(abs(student), count - 1))


def common_size(
    terms: NDArray[np.float64], norms: NDArray[np.float64], alike: float = 1.0
) -> tuple[float, float, float, float]:
    """Size that blocks have in common, by their scatter about it.

    Few blocks that agree are clear here, unlike in ``self_normalised``, whose quotient cannot exceed the root of their
    number. Residuals are those without the block itself (MacKinnon and White 1985), so that one block rules nothing.

    Parameters
    ----------
    terms
        (n,) independent terms, of mean 0 in equal pictures.
    norms
        (n,) terms of a size of 1, at least 0.
    alike
        Number of neighbouring terms that correlation makes one.

    Returns
    -------
    size, sigma, degrees
        The size, its standard deviation and degrees of freedom, one less than the number of blocks that count.
    probability
        Two-sided probability of a size this large, of Student's t; 1 for few blocks.
    """
    total = float(norms.sum())
    if total <= 0:
        return 0.0, np.inf, 0.0, 1.0
    size, share = float(terms.sum()) / total, norms / total
    degrees = 1 / max(float((share**2).sum()) * alike, 1e-300) - 1
    residuals = (terms - size * norms) / np.maximum(1 - share * alike, 1e-3)
    sigma = float(np.sqrt((residuals**2).sum() * alike)) / total
    if degrees < _LEAST_DEGREES or sigma == 0:
        return size, np.inf, degrees, 1.0
    return size, sigma, degrees, float(2 * student_tail(abs(size) / sigma, degrees))


def sigma_of(size: float, probability: float, degrees: float) -> float:
    """Standard deviation by which a size has a two-sided probability of Student's t.

    Parameters
    ----------
    size
        Relative size of a pattern.
    probability
        Probability of a pattern this clear in equal pictures, 0 to 1.
    degrees
        Degrees of freedom.

    Returns
    -------
    float
        Above 0.
    """
    student = float(student_quantile(max(probability, 1e-300) / 2, degrees)) if probability < 1 else 0.0
    return max(abs(size) / max(student, 1e-3), 1e-12)
