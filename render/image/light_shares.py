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
    """Shares of each pixel's light by number of reflections.

    The shares of a pixel sum to 1. They are NaN without light and where a lamp is visible.
    """

    #: (q, y, x) share reflected once, at the visible surface.
    direct: NDArray[np.float64]
    #: (material, q, y, x) share reflected twice: before the visible surface by each material, then by each of several
    #: lamps that reflect.
    via_material: NDArray[np.float64]
    #: (q, y, x) share reflected three times or more.
    many: NDArray[np.float64]


def light_shares(image: RenderedImage, scene: Scene, weights: NDArray) -> LightShares:
    """Shares of light by number of reflections, from an image of the final gather.

    The accumulators of the gather separate the first two reflections: see `render.radiosity.final_gather`.

    Parameters
    ----------
    image
        Image of a final gather.
    scene
        Its scene.
    weights
        (w, q) weights of the wavelengths in q signals.

    Returns
    -------
    LightShares
        The shares.

    Raises
    ------
    ValueError
        For the image of another integrator, which does not separate reflections.
    """
    mean = image.coefficients.mean(axis=0)
    # The accumulators of the gather, of each lamp: direct, second and third material, then the patches' basis.
    lamps = len(scene.lamps)
    firsts = len(scene.materials) + lamps * any(lamp.reflects for lamp in scene.lamps)
    seconds = firsts if lamps > 1 else len(scene.materials)
    per_lamp, rest = divmod(mean.shape[-1], lamps)
    per_material, column_rest = divmod(per_lamp - 1, firsts)
    if rest or column_rest or per_material <= 1 + seconds + seconds**2:
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
        reflected = np.where((total > 0) & ~image.sees_lamp, total, np.nan)
        first, second = direct / reflected, via_material / reflected
    return LightShares(first, second, 1 - first - second.sum(axis=0))
