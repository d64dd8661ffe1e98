"""Change of corrected signals by charge that moves between pixels of the raw frames.

Behind a mosaic neighbours have other colours, and flats and reference frames have as much of it as the scene. So the
change is that of the whole chain: raw frames of each kind, then the laboratory's correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.chain import Counts, Stage, expected_signal, with_charge_moved
from numpy.typing import NDArray

from .predictor import Predictor

__all__ = ["charge_exchange"]

#: Part of the charge that moves where a change is computed, without unit: small against 1, since the change is linear.
_STEP = 1e-3


@dataclass(frozen=True)
class _Moved:
    """Effect on counts: a small part of the charge moves."""

    #: Change of (band, y, x) frames above dark by a unit of the exchange.
    exchange: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    #: Stage of the chain.
    stage: Stage = "counts"

    def apply(self, counts: Counts) -> Counts:
        """Counts after ``_STEP`` units of the exchange."""
        return with_charge_moved(counts, lambda frames: _STEP * self.exchange(frames))


def charge_exchange(
    predictor: Predictor,
) -> Callable[[Callable[[NDArray[np.float64]], NDArray[np.float64]]], NDArray[np.float64]]:
    """Changes of the corrected signals by a unit of an exchange of charge, to first order.

    Parameters
    ----------
    predictor
        Predictor of the capture.

    Returns
    -------
    Callable
        Change (band, y, x) of the signals, DN over the lamp's scale, by an exchange. The exchange gives the change of
        raw frames (band, y, x) above dark, DN, by these frames.
    """
    light = predictor.before_optics(predictor.included)

    def signal(*effects: _Moved) -> NDArray[np.float64]:
        return expected_signal(light, predictor.sensing, effects, predictor.camera) / predictor.lamp_scale

    before = signal()
    return lambda exchange: (signal(_Moved(exchange)) - before) / _STEP
