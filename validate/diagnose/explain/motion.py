"""Size of a displacement: distance, enlargement and turn of each band's picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .explanation import Explanation

__all__ = ["Motion", "motions"]


@dataclass(frozen=True)
class Motion:
    """Displacement of one band's picture."""

    #: Mean displacement to the right, px.
    right_px: float
    #: Mean displacement down, px.
    down_px: float
    #: Size over that of the model's picture, less 1.
    enlargement: float
    #: Turn, clockwise, degrees.
    turned_deg: float
    #: Root mean square of the displacement over the picture, px.
    rms_px: float
    #: Standard deviation of that by noise alone, px.
    sigma_px: float


def motions(explanation: Explanation) -> dict[str, Motion]:
    """Displacement of each band in which an explanation shows.

    Parameters
    ----------
    explanation
        The explanation of what remains.

    Returns
    -------
    dict
        By band; empty where it is no displacement of the picture.
    """
    field = explanation.field
    if field is None or field.acts != "displacement" or field.image is None or field.coefficients is None:
        return {}
    maps = np.asarray(field.image.matrix(field.size))
    down, right = (axis.ravel() - axis.mean() for axis in np.indices(field.size))
    square = float(right @ right + down @ down)
    result = {}
    for band in explanation.bands:
        index = field.bands.index(band)
        u, v = field.coefficients[index].reshape(2, -1) @ maps
        over_noise = explanation.change[index] / explanation.sigma[index]
        rms = float(np.sqrt(np.mean(u**2 + v**2)))
        result[band] = Motion(
            right_px=float(u.mean()),
            down_px=float(v.mean()),
            enlargement=float(u @ right + v @ down) / square,
            turned_deg=float(np.degrees(v @ right - u @ down) / square),
            rms_px=rms,
            sigma_px=rms / float(np.sqrt(np.nansum(over_noise**2))),
        )
    return result
