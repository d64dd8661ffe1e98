"""Shares of each pixel's light by number of reflections: one, two (by material), or more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from .image import RenderedImage

__all__ = ["Accumulators", "LightShares", "accumulators", "light_shares"]


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


@dataclass(frozen=True)
class Accumulators:
    """Order of the coefficients of a final gather, see ``render.radiosity.final_gather``.

    Those of a lamp are the visible lamp, then equal blocks, one for each first material. A block holds direct light,
    light by way of each second material, and the rest.
    """

    #: Number of lamps.
    lamps: int
    #: Number of materials at the surface seen: all materials, with the lamps if one reflects.
    firsts: int
    #: Number of materials at the reflection before.
    seconds: int
    #: Number of coefficients in a block.
    per_block: int

    @property
    def per_lamp(self) -> int:
        """Number of coefficients of a lamp."""
        return 1 + self.firsts * self.per_block

    @property
    def emitted(self) -> list[int]:
        """Coefficients of the visible lamps."""
        return [lamp * self.per_lamp for lamp in range(self.lamps)]

    def start(self, lamp: int, first: int) -> int:
        """First coefficient of a block, that of direct light.

        Parameters
        ----------
        lamp
            Index of the lamp.
        first
            Index of the material at the surface seen.

        Returns
        -------
        int
            Index of the coefficient.
        """
        return lamp * self.per_lamp + 1 + first * self.per_block


def accumulators(image: RenderedImage, scene: Scene) -> Accumulators:
    """Order of the coefficients of an image of the final gather.

    Parameters
    ----------
    image
        Image of a final gather.
    scene
        Its scene.

    Returns
    -------
    Accumulators
        The order.

    Raises
    ------
    ValueError
        For the image of another integrator, which does not separate reflections.
    """
    lamps = len(scene.lamps)
    firsts = len(scene.materials) + lamps * any(lamp.reflects for lamp in scene.lamps)
    seconds = firsts if lamps > 1 else len(scene.materials)
    per_lamp, rest = divmod(image.coefficients.shape[-1], lamps)
    per_block, block_rest = divmod(per_lamp - 1, firsts)
    if rest or block_rest or per_block <= 1 + seconds + seconds**2:
        raise ValueError("not an image of the final gather")
    return Accumulators(lamps, firsts, seconds, per_block)


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
    parts = accumulators(image, scene)
    mean = image.coefficients.mean(axis=0)
    rows = image.spectra @ weights

    def signal(columns: list[int]) -> NDArray:
        return np.moveaxis(mean[..., columns] @ rows[columns], -1, 0)

    start = [parts.start(lamp, first) for lamp in range(parts.lamps) for first in range(parts.firsts)]
    direct = signal(start)
    via_material = np.stack([signal([s + 1 + m for s in start]) for m in range(parts.seconds)])
    total = signal([column for column in range(mean.shape[-1]) if column not in parts.emitted])
    with np.errstate(divide="ignore", invalid="ignore"):
        reflected = np.where((total > 0) & ~image.sees_lamp, total, np.nan)
        first, second = direct / reflected, via_material / reflected
    return LightShares(first, second, 1 - first - second.sum(axis=0))
