"""What is constant on one capture's way from light to counts: responses, flats, reference, darks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .band_curves import BandCurves

__all__ = ["Sensing"]


@dataclass(frozen=True, eq=False)
class Sensing:
    """A capture's constants. Arrays (band,) and (band, y, x) in the manifest's order.

    curves : the responses without effects, for the measured C. flat_radiance, reference_radiance :
    (band, 301) of the uniform sources on WAVELENGTH_NM, 1 where not stated. flat : the measured response,
    1 on average over ``usable``. good : pixels from which C was measured. flat_level : mean of the flat above
    dark, DN, 0 where there is none. reference_factor : C t / (f_number^2 d^2) of the reference frames.
    reference_weight : of this band in the mean C, 0 without a reference. dark_* : DN. exposure_* : s.
    minutes : from the first frame's beginning to the middle of the band's frames. full_scale : DN.
    """

    curves: BandCurves
    flat_radiance: NDArray[np.float64]
    reference_radiance: NDArray[np.float64]
    flat: NDArray[np.float64]
    usable: NDArray[np.bool_]
    good: NDArray[np.bool_]
    flat_level: NDArray[np.float64]
    reference_factor: NDArray[np.float64]
    reference_weight: NDArray[np.float64]
    dark_scene: NDArray[np.float64]
    dark_flat: NDArray[np.float64]
    dark_reference: NDArray[np.float64]
    exposure_scene: NDArray[np.float64]
    exposure_flat: NDArray[np.float64]
    exposure_reference: NDArray[np.float64]
    minutes: NDArray[np.float64]
    full_scale: float
