"""The picture that the lens throws on the sensor, as each band measures it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..perturbation import Warp, build_edge_blur, warp_change

__all__ = ["Light", "with_scene_behind"]


@dataclass(frozen=True, eq=False)
class Light:
    """What the optics stage changes: the picture of the scene on the sensor, band by band.

    signal : (band, y, x) DN above dark at a flat of 1, not clipped, the lamp included.
    effective_nm : (band,) mean wavelength of each band's signal. camera : for its principal point and size.
    moved : change (band, y, x) of the signal when another camera takes the place of this one. beyond_pixels : the
    change that Gaussian blurs (band,), px, make of the light less what they make of pixels. None where the scene
    behind the picture is not known.
    """

    signal: NDArray[np.float64]
    effective_nm: NDArray[np.float64]
    camera: Camera
    moved: Callable[[Camera], NDArray[np.float64]] | None = None
    beyond_pixels: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None

    def with_signal(self, signal: NDArray[np.float64]) -> Light:
        """The same with another signal."""
        return replace(self, signal=signal)

    def scaled(self, factor: NDArray[np.float64] | float) -> Light:
        """The same with ``factor``, (band, 1, 1) or a number, times the light."""
        moved, beyond = self.moved, self.beyond_pixels
        return replace(
            self,
            signal=factor * self.signal,
            moved=None if moved is None else lambda camera: factor * moved(camera),
            beyond_pixels=None if beyond is None else lambda sigma_px: factor * beyond(sigma_px),
        )


def with_scene_behind(light: Light, warp: Warp) -> Light:
    """The light with what its pixels do not tell: where in them the edges of the picture taken apart lie."""
    edges = cache(lambda: build_edge_blur(warp))
    return replace(
        light,
        moved=lambda there: warp_change(warp, there),
        beyond_pixels=lambda sigma_px: edges().beyond_pixels(sigma_px),
    )
