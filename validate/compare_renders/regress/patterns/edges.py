"""Patterns of a difference at edges: a moved, enlarged, turned or blurred picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

__all__ = ["EDGE_PATTERNS", "EdgePattern", "edge_patterns"]

#: Number of patterns.
EDGE_PATTERNS = 5

#: Steps of this many standard deviations count half in patterns, larger ones more.
_CLEAR_STEP_SIGMAS = 10.0
#: Second derivative over the step of an edge, below which the edge is too wide to show a blur.
_SHARP_EDGE = 0.2
#: Fourth powers over the squared sum of squares, below which single pixels rule a pattern: ten equal pixels.
_MIN_PATTERN_PIXELS = 10
#: Fewest pixels of a pattern.
_MIN_PIXELS = 24
#: Fewest pixels of a pattern over the number that correlation makes one.
_MIN_INDEPENDENT = 6.0


@dataclass(frozen=True)
class EdgePattern:
    """Size of one pattern."""

    #: "shift x", "shift y", "magnification", "turn" or "blur".
    name: str
    #: Number of pixels.
    pixels: int
    #: Size, in ``unit``.
    size: float
    #: Standard deviation of ``size``.
    sigma: float
    #: Degrees of freedom of ``sigma``.
    degrees: float
    #: "px" at half a width from the centre, or "px^2" of added variance.
    unit: str


def edge_patterns(
    half: NDArray[np.float64],
    residual: NDArray[np.float64],
    edges: NDArray[np.bool_],
    *,
    variance: NDArray[np.float64],
    shared: NDArray[np.float64],
    clustering: float,
) -> list[EdgePattern]:
    """Sizes of the patterns that enough edges show.

    Each edge pixel contributes with its sign. The sum over the root of its sum of squares is the statistic. It needs no
    known variance, and heavy tails make it smaller, not larger.

    Parameters
    ----------
    half
        (y, x) mean of both pictures, with noise independent of the difference's.
    residual
        (y, x) difference without the even change of the light.
    edges
        (y, x) pixels at the edges in use.
    variance
        (y, x) smooth variance of the difference.
    shared
        (y, x) error of the difference that pixels share.
    clustering
        Number of pixels that correlation makes one.

    Returns
    -------
    list[EdgePattern]
        At most ``EDGE_PATTERNS``.
    """
    span = maximum_filter(half, 3) - minimum_filter(half, 3)
    down, right = (np.asarray(slope) for slope in np.gradient(half))
    curved = -_laplacian(half)
    inside = np.pad(np.ones(np.subtract(half.shape, 2), bool), 1)
    at_edges = inside & edges
    weight = np.where(at_edges, 1 / np.maximum(span**2 + _CLEAR_STEP_SIGMAS**2 * variance, 1e-300), 0.0)
    y, x = (axis - (axis.max() / 2) for axis in np.indices(half.shape))
    x, y = 2 * x / half.shape[1], 2 * y / half.shape[1]
    slopes: tuple[tuple[str, Any, str, float], ...] = (
        ("shift x", -right, "px", 0.0),
        ("shift y", -down, "px", 0.0),
        ("magnification", -(right * x + down * y), "px", 0.0),
        ("turn", right * y - down * x, "px", 0.0),
        ("blur", -curved / 2, "px^2", _SHARP_EDGE),
    )
    patterns = []
    for name, slope, unit, sharpness in slopes:
        used = at_edges & (np.abs(slope) > sharpness * span)
        # neither light that brightens all pixels alike is a pattern, nor the error of the even change, which they share
        w, s, light = weight[used], np.asarray(slope)[used], half[used]
        s = s - light * (w * s * light).sum() / max(float((w * light**2).sum()), 1e-300)
        terms, norms = w * s * residual[used], w * s**2
        root = float(np.hypot(np.sqrt((terms**2).sum() * clustering), (w * s) @ shared[used]))
        few = (terms**2).sum() ** 2 < _MIN_PATTERN_PIXELS * (terms**4).sum()
        independent = float(used.sum()) / clustering
        if used.sum() < _MIN_PIXELS or independent < _MIN_INDEPENDENT or root == 0 or few:
            continue
        size, sigma = float(terms.sum() / norms.sum()), root / float(norms.sum())
        patterns.append(EdgePattern(name, int(used.sum()), size, sigma, independent - 1.0, unit))
    return patterns


def _laplacian(picture: NDArray) -> NDArray[np.float64]:
    """(y, x) sum of the second derivatives along rows and columns."""
    along = np.pad(picture, 1, mode="edge")
    return along[2:, 1:-1] + along[:-2, 1:-1] + along[1:-1, 2:] + along[1:-1, :-2] - 4 * picture
