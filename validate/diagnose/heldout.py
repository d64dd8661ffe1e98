"""How well an effect predicts the residual in pixels and in bands that are held out from its fit.

The amplitude of a true cause is the same in all pixels and bands; that of an effect which resembles it is not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..compare import Nuisances
from .linear_model import LinearModel

__all__ = ["PREDICTS", "heldout_bands", "heldout_pixels"]

#: Where held out, an effect must gain this part of what it gains where fitted.
PREDICTS = 0.5

_BLOCK_PX = 16

#: A band is held out only where the other bands hold at least this part of the square of the effect's change.
_ENOUGH_ELSEWHERE = 0.2


def heldout_pixels(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain in blocks of pixels held out from the amplitude's fit, over that in the others; 1 is perfect.

    residual, predicted : (n + 11,) projected, over sigma.
    """
    rows, columns = np.indices(model.used.shape[1:])
    board = ((rows // _BLOCK_PX + columns // _BLOCK_PX) % 2).astype(bool)
    one = np.broadcast_to(board, model.used.shape)[model.used]
    priors = np.ones(Nuisances.count, bool)
    own = other = 0.0
    for part in (one, ~one):
        inside, outside = np.append(part, priors), np.append(~part, ~priors)
        amplitude = _amplitude(residual[inside], predicted[inside])
        own += _gain(residual[inside], predicted[inside], amplitude)
        other += _gain(residual[outside], predicted[outside], amplitude)
    return other / max(own, 1e-30)


def heldout_bands(model: LinearModel, residual: NDArray, predicted: NDArray) -> float:
    """Gain in each band with the amplitude that the other bands ask for, over that with the one of all bands.

    NaN for an effect that acts in one band alone. Parameters as in ``heldout_pixels``.
    """
    band = np.broadcast_to(np.arange(len(model.used))[:, None, None], model.used.shape)[model.used]
    pixels, shape = residual[: model.count], predicted[: model.count]
    everywhere = _amplitude(pixels, shape)
    own = other = 0.0
    for held in range(len(model.used)):
        inside = band != held
        if np.sum(shape[inside] ** 2) < _ENOUGH_ELSEWHERE * np.sum(shape**2):
            continue
        amplitude = _amplitude(pixels[inside], shape[inside])
        own += _gain(pixels[~inside], shape[~inside], everywhere)
        other += _gain(pixels[~inside], shape[~inside], amplitude)
    return other / own if own > 0 else float("nan")


def _amplitude(residual: NDArray, predicted: NDArray) -> float:
    return float(predicted @ residual) / max(float(predicted @ predicted), 1e-30)


def _gain(residual: NDArray, predicted: NDArray, amplitude: float) -> float:
    return float(2 * amplitude * (predicted @ residual) - amplitude**2 * (predicted @ predicted))
