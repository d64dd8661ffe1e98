"""Excess chi2 by region of the picture.

Each partition holds every residual once, so that its shares sum to 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .comparison import ChiSquare, Comparison
from .failure import OUTSIDE, SIGNIFICANT
from .regions import INTERIOR_DISTANCE_PX

__all__ = ["Region", "regions_of"]


@dataclass(frozen=True)
class Region:
    """One row of a partition."""

    #: Name of the region.
    name: str
    #: Chi2 of its residuals.
    chi2: ChiSquare
    #: Share of the residuals, 0 to 1.
    share_of_residuals: float
    #: Share of the chi2 above expectation. The rows sum to 1, and a row below expectation is negative. NaN where noise
    #: explains the entire picture.
    share_of_excess: float


def regions_of(c: Comparison) -> Mapping[str, tuple[Region, ...]]:
    """Partitions of the residuals.

    Parameters
    ----------
    c
        The comparison.

    Returns
    -------
    Mapping
        Regions by partition: "place" (interiors, edges, outside the box), "surface" and "band".
    """
    index, distance = c.maps["surface"].values, c.maps["edge_distance_px"].values
    residual = c.maps["residual_over_sigma"].values
    used = np.isfinite(residual)
    square = np.where(used, residual, 0.0) ** 2
    dof_each = c.chi2.dof / max(c.chi2.count, 1)

    def region(name: str, where: NDArray[np.bool_]) -> Region:
        members = np.broadcast_to(where, used.shape) & used
        count = int(members.sum())
        chi2 = ChiSquare(float(square[members].sum()), count, count * dof_each, c.chi2.variance_sigma)
        share = chi2.excess / c.chi2.excess if c.chi2.p_value < SIGNIFICANT else float("nan")
        return Region(name, chi2, count / max(c.chi2.count, 1), share)

    inside, near = index >= 0, distance < INTERIOR_DISTANCE_PX
    bands = np.arange(len(c.bands))[:, None, None]
    outside = region(OUTSIDE, ~inside)
    return {
        "place": (
            region("interiors of surfaces", inside & ~near),
            region(f"surfaces within {INTERIOR_DISTANCE_PX:g} px of an edge", inside & near),
            outside,
        ),
        "surface": (*(region(name, index == i) for i, name in enumerate(c.by_surface)), outside),
        "band": tuple(region(band, bands == i) for i, band in enumerate(c.bands)),
    }
