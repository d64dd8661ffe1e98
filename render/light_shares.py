"""How light came to each pixel: straight from the lamp to what is seen, after one more reflection, or after many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .image import RenderedImage

__all__ = ["LightShares", "light_shares"]


@dataclass(frozen=True, eq=False)
class LightShares:
    """Parts of each pixel's light, which sum to 1; NaN where there is none or the lamp itself is in sight.

    direct : (q, y, x) reflected once, where the camera sees it. by_way_of : (paint, q, y, x) reflected once before,
    by each paint. many : (q, y, x) reflected three times or more.
    """

    direct: NDArray[np.float64]
    by_way_of: NDArray[np.float64]
    many: NDArray[np.float64]


def light_shares(image: RenderedImage, paints: int, weights: NDArray) -> LightShares:
    """Shares in the signals that ``weights`` (w, q) make of a final gather's image of so many ``paints``.

    Raises ValueError for another integrator's image, which does not keep its reflections apart.
    """
    mean = image.coefficients.mean(axis=0)
    each = (
        1 + paints + paints**2
    )  # the gather's accumulators: direct, second, third paints, then the patches' basis
    per_paint, rest = divmod(mean.shape[-1] - 1, paints)
    if rest or per_paint <= each:
        raise ValueError("not an image of the final gather")
    rows = image.spectra @ weights

    def signal(columns: list[int]) -> NDArray:
        return np.moveaxis(mean[..., columns] @ rows[columns], -1, 0)

    start = [1 + m * per_paint for m in range(paints)]
    direct = signal(start)
    by_way_of = np.stack([signal([s + 1 + m for s in start]) for m in range(paints)])
    total = signal(list(range(1, mean.shape[-1])))
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = np.where((total > 0) & ~image.sees_lamp, total, np.nan)
        first, second = direct / whole, by_way_of / whole
    return LightShares(first, second, 1 - first - second.sum(axis=0))
