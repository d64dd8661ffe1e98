"""Check of sensitivities, lamp and filter weights together, by the patches of a chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from ..instrument import BandResponse, colour_matching_functions
from .colorimetry import FilterWeights
from .colour_error import lab_differences
from .patches import PatchTable

__all__ = ["ChainCheck", "check_chain"]

#: Draws of the patches' noise: their mean colour difference is then known to 5 %.
_DRAWS = 32


@dataclass(frozen=True, eq=False)
class ChainCheck:
    """CIEDE2000 of n patches, by the weights in use, against their tables under the lamp."""

    #: Numbers of the patches, without the white one.
    labels: tuple[int, ...]
    #: (n,) of the measured signals.
    measured: NDArray[np.float64]
    #: (n,) of the signals that sensitivities, lamp and tables predict: the error of the weights alone.
    of_weights: NDArray[np.float64]
    #: Mean that the patches' noise alone gives.
    by_noise: float

    @property
    def note(self) -> str:
        """One sentence with the three means."""
        return (
            f"colour chain: {len(self.labels)} patches of the chart miss their tables by a mean CIEDE2000 of "
            f"{self.measured.mean():.2f} with the weights in use; of this the weights alone give "
            f"{self.of_weights.mean():.2f}, noise {self.by_noise:.2f}"
        )


def check_chain(
    table: PatchTable,
    weights: FilterWeights,
    responses: Sequence[BandResponse],
    lamp: Spectrum,
    reference: Mapping[str, Spectrum],
) -> ChainCheck | None:
    """Compare colours of measured patches with those of their tabulated reflectances.

    Parameters
    ----------
    table
        Measured patches.
    weights
        Filter weights in use.
    responses
        Response of every band of the table.
    lamp
        Spectral radiance of the lamp.
    reference
        Tabulated reflectances by column name.

    Returns
    -------
    ChainCheck | None
        None if no patch but the white one has a tabulated reflectance.
    """
    rows = [
        index
        for index, label in enumerate(table.labels)
        if label.column in reference
        and label.label != table.white.label
        and bool(np.all(np.isfinite(table.reflectance[index])))
    ]
    if not rows:
        return None
    step = INTEGRAL_GRID.weights
    light = lamp.at(WAVELENGTH_NM)
    paints = np.stack([reference[str(table.labels[index].column)].at(WAVELENGTH_NM) for index in rows])
    curves = np.stack([response.response for response in responses]) * step
    goal = colour_matching_functions() * step
    exact, white = (light * paints) @ goal.T, light @ goal.T
    whites = np.broadcast_to(white, exact.shape)
    of_white = curves @ light

    def differences(signals: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
        return lab_differences(signals @ weights.weights.T, others, whites)[1]

    measured = table.reflectance[rows] * of_white
    without_noise = measured @ weights.weights.T
    draws = np.random.default_rng(0).standard_normal((_DRAWS, *measured.shape)) * table.sigma[rows] * of_white
    return ChainCheck(
        tuple(table.labels[index].label for index in rows),
        differences(measured, exact),
        differences((light * paints) @ curves.T, exact),
        float(np.mean([differences(measured + draw, without_noise) for draw in draws])),
    )
