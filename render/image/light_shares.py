"""Shares of each pixel's light by number of reflections: one, two (by material), or more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from .image import RenderedImage

__all__ = ["LightShares", "light_shares"]


@dataclass(frozen=True, eq=False)
class LightShares:
    """Shares of each pixel's light, which sum to 1; NaN without light and where a lamp is visible.

    direct : (q, y, x) reflected once, at the surface seen. via_material : (material, q, y, x) reflected once before, by
    each material, and then by each of several lamps that reflect. many : (q, y, x) reflected three times or more.
    """

    direct: NDArray[np.float64]
    via_material: NDArray[np.float64]
    many: NDArray[np.float64]


def light_shares(image: RenderedImage, scene: Scene, weights: NDArray) -> LightShares:
    """Shares in the signals with ``weights`` (w, q), of a final gather's image of the scene.

    Raises ValueError for the image of another integrator, which does not separate reflections.
    """
    mean = image.coefficients.mean(axis=0)
    # The accumulators of the gather, of each lamp: direct, second and third material, then the patches' basis.
    lamps = len(scene.lamps)
    firsts = len(scene.materials) + lamps * any(lamp.reflects for lamp in scene.lamps)
    seconds = firsts if lamps > 1 else len(scene.materials)
    per_lamp, rest = divmod(mean.shape[-1], lamps)
    per_material, left = divmod(per_lamp - 1, firsts)
    if rest or left or per_material <= 1 + seconds + seconds**2:
        raise ValueError("not an image of the final gather")
    rows = image.spectra @ weights

    def signal(columns: list[int]) -> NDArray:
        return np.moveaxis(mean[..., columns] @ rows[columns], -1, 0)

    emitted = [lamp * per_lamp for lamp in range(lamps)]
    start = [e + 1 + m * per_material for e in emitted for m in range(firsts)]
    direct = signal(start)
    via_material = np.stack([signal([s + 1 + m for s in start]) for m in range(seconds)])
    total = signal([column for column in range(mean.shape[-1]) if column not in emitted])
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = np.where((total > 0) & ~image.sees_lamp, total, np.nan)
        first, second = direct / whole, via_material / whole
    return LightShares(first, second, 1 - first - second.sum(axis=0))
