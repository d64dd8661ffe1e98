"""Light on the sensor, band by band."""

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
    """Value of the optics stage: the picture of the scene on the sensor, band by band."""

    #: (band, y, x) signal above dark at a flat of 1, DN, not clipped, the lamp included.
    signal: NDArray[np.float64]
    #: (band,) mean wavelength of each band's signal, nm.
    effective_nm: NDArray[np.float64]
    #: Camera, for its principal point and size.
    camera: Camera
    #: Change (band, y, x) of the signal when another camera replaces this one; None where the scene behind the picture
    #: is not known.
    moved: Callable[[Camera], NDArray[np.float64]] | None = None
    #: Change that Gaussian blurs (band,), px, make of the light minus the change of the pixels; None where the scene is
    #: not known.
    beyond_pixels: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None

    def with_signal(self, signal: NDArray[np.float64]) -> Light:
        """Light with another signal.

        Parameters
        ----------
        signal
            (band, y, x) DN.

        Returns
        -------
        Light
            The rest is unchanged.
        """
        return replace(self, signal=signal)

    def scaled(self, factor: NDArray[np.float64] | float) -> Light:
        """Light times a factor.

        Parameters
        ----------
        factor
            (band, 1, 1) or a number.

        Returns
        -------
        Light
            Signal and changes times the factor.
        """
        moved, beyond = self.moved, self.beyond_pixels
        return replace(
            self,
            signal=factor * self.signal,
            moved=None if moved is None else lambda camera: factor * moved(camera),
            beyond_pixels=None if beyond is None else lambda sigma_px: factor * beyond(sigma_px),
        )


def with_scene_behind(light: Light, warp: Warp) -> Light:
    """Light with the edges inside its pixels, which the pixels alone do not show.

    Parameters
    ----------
    light
        The light.
    warp
        The picture by faces.

    Returns
    -------
    Light
        Light with ``moved`` and ``beyond_pixels``.
    """
    edges = cache(lambda: build_edge_blur(warp))
    return replace(
        light,
        moved=lambda camera: warp_change(warp, camera),
        beyond_pixels=lambda sigma_px: edges().beyond_pixels(sigma_px),
    )
