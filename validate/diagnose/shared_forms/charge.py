"""Charge that moves between pixels of a colour sensor: one way, or along the register.

It moves on the raw frames, so that it goes from colour to colour, in flats and reference frames, too. Without a mosaic
an exchange of light looks the same, see ``blur``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps, exchanges
from numpy.typing import NDArray

from ..field_fit import (
    ChargeExchange,
    Columns,
    Family,
    FieldFit,
    FittedExplanation,
    ResidualData,
    equations_in_all_bands,
    fixed_spectrum,
)

__all__ = ["TRAILS", "moved_charge"]

#: Ways along which charge may trail, in words, by degrees from the rows, downwards.
TRAILS: Mapping[int, str] = {0: "to the right", 90: "down", 180: "to the left", 270: "up"}

#: Parts of a pixel's charge that go to the right, down, to the left and up, by the way in words.
_LEAKS: Mapping[str, tuple[float, float, float, float]] = {
    "along the rows": (0.5, 0, 0.5, 0),
    "along the columns": (0, 0.5, 0, 0.5),
    "to the right": (1, 0, 0, 0),
    "down": (0, 1, 0, 0),
    "to the left": (0, 0, 1, 0),
    "up": (0, 0, 0, 1),
}


def moved_charge(data: ResidualData, family: Family) -> Iterator[FittedExplanation]:
    """Charge that moves on the raw frames of a colour sensor.

    Parameters
    ----------
    data
        Residual to be explained.
    family
        Family of the forms.

    Yields
    ------
    FittedExplanation
        A leak to each neighbour, along the rows, along the columns; charge that trails along the register. Nothing
        without a mosaic. The numbers are parts of the charge, and not negative.
    """
    if data.charge is None:
        return
    columns, maps = _columns(data, data.charge, "leak"), ImageMaps("cosines")
    n, alike = equations_in_all_bands(data, columns), np.ones(len(data.bands))
    for way, parts in _LEAKS.items():
        fit = fixed_spectrum(n.of_sums(np.array([parts])), alike)
        part = float(fit.coefficients[0, 0])
        if part > 0:
            fit = replace(fit, coefficients=fit.coefficients * parts)
            form = f"charge that leaks {way}, {part:.2%}"
            yield FittedExplanation(family, form, fit, columns, "leak", maps, sharp=True, num_choices=len(_LEAKS))
    trails = (_register(data, data.charge, family, angle) for angle in TRAILS)
    yield from (trail for trail in trails if trail.fit.coefficients.sum() > 0)


def _register(data: ResidualData, charge: ChargeExchange, family: Family, angle_deg: int) -> FittedExplanation:
    """Charge that stays behind in the register and is read with pixels that follow."""
    columns = _columns(data, charge, "register", angle_deg)
    fit: FieldFit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(len(data.bands)))
    return FittedExplanation(
        family,
        f"trails {TRAILS[angle_deg]}, {fit.coefficients[0].sum():.2%} of the charge",
        fit,
        columns,
        "register",
        ImageMaps("cosines"),
        sharp=True,
        num_choices=len(TRAILS),
        angle_deg=angle_deg,
    )


def _columns(data: ResidualData, charge: ChargeExchange, acts: Acts, angle_deg: int = 0) -> Columns:
    """Changes of the signal by units of an exchange on the raw frames."""

    def unit(index: int) -> NDArray[np.float64]:
        return charge(lambda frames: np.array([exchanges(acts, frame, angle_deg=angle_deg)[index] for frame in frames]))

    count = len(exchanges(acts, np.zeros((2, 2)), angle_deg=angle_deg))
    changes = np.array([unit(index) for index in range(count)]).reshape(count, len(data.bands), -1)
    return lambda band: changes[:, band].astype(np.float32)
