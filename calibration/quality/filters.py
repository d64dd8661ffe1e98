"""Check for a filter's table that is shifted in wavelength."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from ..capture import BandTable, Capture
from ..radiometry import Radiometry
from .content import named_pass_band
from .frame_checks import Suspicion

__all__ = ["check_filter_shift"]

#: Smallest suspicious distance of a pass band from the wavelength in the band's name, nm: makers hold 2 to 5 nm.
SMALLEST_SHIFT_NM = 7.0

#: Largest standard deviation of the other bands' distances, nm: names must be those of the pass bands.
NAMES_AGREE_NM = 3.0

#: Smallest deviation of the band's C from the median that the shift explains, natural log.
SMALLEST_DEVIATION = 0.01

#: Largest share of the deviation that is left after the table is shifted back.
LARGEST_LEFT_SHARE = 0.35

#: Fewest bands with a wavelength in their name.
FEWEST_BANDS = 5


def check_filter_shift(capture: Capture, radiometry: Radiometry) -> Iterator[Suspicion]:
    """Detect a filter's table that is shifted against the wavelength in the band's name.

    The band's C from the reference deviates from the median of the bands, and agrees if the table is shifted to the
    wavelength in the band's name.

    Parameters
    ----------
    capture
        A capture; a sensor with a mosaic is not checked.
    radiometry
        C by the references of each band.

    Yields
    ------
    Suspicion
        For each such table.
    """
    constants = {c.band: c.constant for c in radiometry.by_band if c.constant > 0}
    pass_bands = {band.id: named_pass_band(capture, band) for band in capture.manifest.band}
    distances = {name: pair[1] - pair[0] for name, pair in pass_bands.items() if pair is not None and name in constants}
    if capture.manifest.mosaic is not None or len(distances) < FEWEST_BANDS:
        return
    median = float(np.median(list(constants.values())))
    for index, band in enumerate(capture.manifest.band):
        others = [distance for name, distance in distances.items() if name != band.id]
        if band.id not in distances or np.std(others) > NAMES_AGREE_NM:
            continue
        shift = distances[band.id] - float(np.median(others))
        deviation = float(np.log(constants[band.id] / median))
        if abs(shift) < SMALLEST_SHIFT_NM or abs(deviation) < SMALLEST_DEVIATION:
            continue
        remainder = deviation - _change_of_constant(capture, band, -shift)
        if abs(remainder) < LARGEST_LEFT_SHARE * abs(deviation):
            yield Suspicion(
                f"the table of the filter of {band.id} is shifted by {shift:+.0f} nm, or is that of another filter",
                f"band[{index}] ({band.id}).transmittance",
                f"Its pass band is {shift:+.1f} nm from the wavelength in the band's name, relative to the other "
                f"bands, and its C is {np.exp(deviation):.3f} times their median; with the table shifted back it is "
                f"{np.exp(remainder):.3f} times.",
            )


def _change_of_constant(capture: Capture, band: BandTable, shift_nm: float) -> float:
    """Natural log by which a shift of a band's table decreases its C; NaN if a table is missing."""
    efficiency = capture.manifest.camera.quantum_efficiency
    references = capture.references(band.id)
    if not isinstance(efficiency, str) or not references or band.transmittance is None:
        return float("nan")
    light = capture.light(references[0].radiance).at(WAVELENGTH_NM) * INTEGRAL_GRID.weights
    light = light * WAVELENGTH_NM * capture.light(efficiency).at(WAVELENGTH_NM)
    if capture.manifest.lens.transmittance is not None:
        light = light * capture.light(capture.manifest.lens.transmittance).at(WAVELENGTH_NM)
    table = capture.light(band.transmittance)
    as_stated, shifted = (_signal(light, table.wavelength_nm + s, table.values) for s in (0.0, shift_nm))
    return float(np.log(shifted / as_stated))


def _signal(
    light: NDArray[np.float64], wavelength_nm: NDArray[np.float64], transmittance: NDArray[np.float64]
) -> float:
    """Signal of light on WAVELENGTH_NM through a filter, any unit."""
    return float(np.sum(light * np.interp(WAVELENGTH_NM, wavelength_nm, transmittance, 0.0, 0.0)))
