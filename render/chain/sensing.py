"""Constants of one capture from light to counts: responses, flats, reference, darks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .band_curves import BandCurves
from .interleaving import Interleaving

__all__ = ["MergedExposure", "Sensing"]


@dataclass(frozen=True, eq=False)
class MergedExposure:
    """One of the exposures that were merged into the bands' signals."""

    #: (band,) exposure time over that of the scene's signal.
    ratio: NDArray[np.float64]
    #: (band, y, x) weight on its signal. Weights times ratios add up to 1 over the exposures.
    weight: NDArray[np.float64]
    #: (band,) level of dark frames at its exposure, DN.
    dark: NDArray[np.float64]
    #: (band,) time from the first frame's beginning to the middle of its frames, min.
    minutes: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sensing:
    """Constants of a capture; bands in the manifest's order."""

    #: Responses without effects, for the measured C.
    curves: BandCurves
    #: (band, 301) radiance of the flats' source on WAVELENGTH_NM; 1 where not stated.
    flat_radiance: NDArray[np.float64]
    #: (band, 301) radiance of the reference on WAVELENGTH_NM; 1 where not stated.
    reference_radiance: NDArray[np.float64]
    #: (band, y, x) measured response, 1 on average over ``usable``.
    flat: NDArray[np.float64]
    #: (band, y, x) pixels over which the flat is normalised.
    usable: NDArray[np.bool_]
    #: (band, y, x) pixels from which C was measured.
    good: NDArray[np.bool_]
    #: (band,) mean of the flat above dark, DN; 0 where there is none.
    flat_level: NDArray[np.float64]
    #: (band,) C t / (f_number^2 d^2) of the reference frames.
    reference_factor: NDArray[np.float64]
    #: (band,) weight of the band in the mean C; 0 without a reference.
    reference_weight: NDArray[np.float64]
    #: (band,) level of dark frames at the exposure of the scene, DN.
    dark_scene: NDArray[np.float64]
    #: (band,) level of dark frames at the exposure of the flats, DN.
    dark_flat: NDArray[np.float64]
    #: (band,) level of dark frames at the exposure of the reference, DN.
    dark_reference: NDArray[np.float64]
    #: (band,) exposure of the scene, s.
    exposure_scene: NDArray[np.float64]
    #: (band,) exposure of the flats, s.
    exposure_flat: NDArray[np.float64]
    #: (band,) exposure of the reference, s.
    exposure_reference: NDArray[np.float64]
    #: (band,) time from the first frame's beginning to the middle of the band's frames, min.
    minutes: NDArray[np.float64]
    #: Largest count, DN.
    full_scale: float
    #: Channels of the pixels in the frames of a sensor with a mosaic; None without one.
    mosaic: Interleaving | None = None
    #: Exposures that were merged; empty where each band has one.
    merged: tuple[MergedExposure, ...] = ()

    def during(self, exposure: MergedExposure) -> Sensing:
        """The constants of one exposure alone.

        Parameters
        ----------
        exposure
            One of ``merged``.

        Returns
        -------
        Sensing
            With its dark level, time and exposure.
        """
        return replace(
            self,
            dark_scene=exposure.dark,
            exposure_scene=self.exposure_scene * exposure.ratio,
            minutes=exposure.minutes,
            merged=(),
        )
