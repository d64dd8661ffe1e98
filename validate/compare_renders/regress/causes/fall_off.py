"""Fall-off over the picture: cos^n of the angle from the axis, or 1 + a r^2."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Steps of Gauss and Newton.
_STEPS = 4
#: Largest size of an exponent.
_MAX_EXPONENT = 12.0
#: Smallest size of an exponent: noise.
_MIN_EXPONENT = 1e-3
#: Largest distance of an exponent from 4 at which it is taken for the natural fall-off of a lens.
_NATURAL = 0.15
#: Tangents of half the angle of view that are tried about the picture's centre where no camera is stated.
_TANGENTS = (0.2, 0.35, 0.6, 1.0)


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """The exponent is fitted by steps; r = 1 at half of the picture's width."""
    x, y = pictures.across()
    base, square = pictures.baseline, (x * x + y * y)[..., None]
    yield Trial(lambda a: {"at_half_width": 1 + float(a[0]), "law": "1 + a r^2"}, (base * square,))
    cosines: list[tuple[float | None, NDArray[np.float64]]]
    if pictures.camera is None:
        cosines = [(tangent, (1 + tangent**2 * square) ** -0.5) for tangent in _TANGENTS]
    else:
        cosines = [(None, _cosine(pictures))]
    for (tangent, cosine), levelled in product(cosines, (False, True)):
        exponent, factor = 0.0, 1.0
        for _ in range(_STEPS):
            now = factor * base * cosine**exponent
            templates = [now * np.log(cosine), *([now] if levelled else [])]
            step = pictures.fit(templates, now - base)
            exponent = float(np.clip(exponent + step[0], -_MAX_EXPONENT, _MAX_EXPONENT))
            if levelled:
                factor *= float(np.clip(1 + step[1], 0.5, 2.0))
        if abs(exponent) > _MIN_EXPONENT:
            values: dict[str, object] = {
                "law": "cos^n",
                "exponent": exponent,
                **({"factor_at_centre": factor} if levelled else {}),
            }
            if tangent is not None:
                values["tangent_at_half_width"] = tangent
            elif abs(exponent - 4) < _NATURAL:
                values["meaning"] = "irradiance of a film behind a lens in place of radiance?"
            picture = factor * base * cosine**exponent
            yield Trial(fixed_values(values), fixed=picture - base, selected=1 + levelled + (tangent is not None))


def _cosine(pictures: Pictures) -> NDArray[np.float64]:
    """(y, x, 1) cosine of the angle between each pixel's ray and the camera's axis."""
    camera = pictures.camera
    if camera is None:
        raise ValueError("the camera is unknown")
    rows, columns = np.indices(pictures.baseline.shape[:2])
    directions = camera.directions(columns, rows) @ camera.rotation.T
    return np.asarray(directions[..., 2:] / np.linalg.norm(directions, axis=-1, keepdims=True))


CAUSE = Cause(
    "fall-off",
    "Light falls off from the picture's centre: vignetting, or a film's cos^4.",
    _trials,
    is_factor=True,
)
