"""Stock settings of renderers: few reflections, a wide pixel filter, a denoiser.

Paths cut short and a filter alone have names by themselves. Stock settings do all at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d

from .cause import Cause, Pictures, Trial

__all__ = ["CAUSE"]


@dataclass(frozen=True)
class _Stock:
    """Stock settings of one renderer."""

    #: Name of the renderer.
    renderer: str
    #: Settings in the renderer's own names.
    settings: str
    #: Number of reflections on diffuse surfaces after which paths end.
    reflections: int
    #: Least and largest variance that the filter adds to that of a box of one pixel, px^2.
    blur_px2: tuple[float, float]


#: Renderers by their stock settings; figures measured with the renderer itself.
_STOCK = (_Stock("Blender Cycles", "diffuse bounces 4, Blackman-Harris filter of 1.5 px", 5, (0.04, 0.2)),)
#: Part of the change's chi-square that the denoiser's own error leaves in cells: 0.36 in the box at 256 samples.
_DENOISED = 0.4
#: Second difference along a line of pixels.
_CURVATURE = np.array([1.0, -2.0, 1.0])


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """The settings of each renderer, the width of its filter free."""
    scene = pictures.scene
    if scene is None:
        return
    base = pictures.baseline
    once = convolve1d(base, _CURVATURE, 0, mode="nearest") + convolve1d(base, _CURVATURE, 1, mode="nearest")
    for stock in _STOCK:
        cut = pictures.change(scene.light.change(max_bounces=stock.reflections).picture())

        def parameters(amplitudes: np.ndarray, stock: _Stock = stock) -> dict[str, object] | None:
            blur = 2 * float(amplitudes[0])
            if not stock.blur_px2[0] <= blur <= stock.blur_px2[1]:
                return None
            return {"renderer": stock.renderer, "settings": stock.settings, "filter_added_variance_px2": blur}

        yield Trial(parameters, (once,), fixed=cut)


CAUSE = Cause(
    "stock-settings",
    "A renderer ran with its stock settings: paths end early, and a wide filter blurs pixels.",
    _trials,
    needs_scene=True,
    shape_error=_DENOISED,
)
