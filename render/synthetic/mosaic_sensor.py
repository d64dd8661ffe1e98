"""A simulated sensor with a mosaic: its dyes and its bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import channel_letters, channel_mask, checked_pattern
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

__all__ = ["MosaicSensor", "SimulatedBand", "bands_of", "interleaved", "mosaic_sensor"]

#: Largest transmittance of a dye, without unit: usual dyes absorb a tenth at their peak.
_DYE_PEAK = 0.9
#: Peak and standard deviation of the usual dyes, nm.
_DYES_NM: Mapping[str, tuple[float, float]] = {"R": (600.0, 40.0), "G": (540.0, 45.0), "B": (460.0, 35.0)}
#: Letters of pixels without a dye: white and clear.
_CLEAR = "WC"
#: Shortest peak of the dyes of a multispectral mosaic, nm: within the sensor's and the box's spectra.
_FIRST_NM = 430.0
#: Longest peak of the dyes of a multispectral mosaic, nm.
_LAST_NM = 670.0
#: Standard deviation of a dye of a multispectral mosaic, nm: filter arrays of 16 and 25 bands pass about 30 nm.
_NARROW_NM = 15.0


@dataclass(frozen=True, eq=False)
class MosaicSensor(FrozenMappings):
    """The mosaic of a simulated sensor."""

    #: Letters of one repeat, row by row, as in the capture format.
    pattern: str
    #: By letter, transmittance of the dye in front of its pixels.
    dyes: Mapping[str, Spectrum]


@dataclass(frozen=True)
class SimulatedBand:
    """A band of a simulated capture: a filter, and a channel of the sensor."""

    #: Identifier of the band.
    id: str
    #: Identifier of the filter, the same for all channels of a frame.
    filter: str
    #: Letter of the channel; None without a mosaic.
    channel: str | None = None


def mosaic_sensor(pattern: str) -> MosaicSensor:
    """A mosaic with usual dyes.

    R, G and B are broad. W is clear, and C too. The dyes of other letters are narrow, with peaks spread evenly over the
    visible spectrum.

    Parameters
    ----------
    pattern
        Letters of one repeat: "RGGB", or rows separated by a space.

    Returns
    -------
    MosaicSensor
        The pattern with a dye for each letter.

    Raises
    ------
    InputError
        If it is no pattern.
    """
    try:
        letters = channel_letters(checked_pattern(pattern))
    except ValueError as fault:
        raise InputError("mosaic", f"'{pattern}'", str(fault)) from None
    others = sorted(letter for letter in letters if letter not in _DYES_NM and letter not in _CLEAR)
    peaks = np.linspace(_FIRST_NM, _LAST_NM, len(others)).tolist()
    bells = {**_DYES_NM, **{letter: (peak, _NARROW_NM) for letter, peak in zip(others, peaks, strict=True)}}

    def dye(letter: str) -> Spectrum:
        if letter in _CLEAR:
            return Spectrum(WAVELENGTH_NM, np.full(WAVELENGTH_NM.size, _DYE_PEAK), "zero")
        peak, width = bells[letter]
        return Spectrum(WAVELENGTH_NM, _DYE_PEAK * np.exp(-0.5 * ((WAVELENGTH_NM - peak) / width) ** 2), "zero")

    return MosaicSensor(pattern, {letter: dye(letter) for letter in letters})


def bands_of(filters: Sequence[str], mosaic: MosaicSensor | None) -> tuple[SimulatedBand, ...]:
    """Bands of a capture: each filter, behind a mosaic with each channel.

    Parameters
    ----------
    filters
        Identifiers of the filters.
    mosaic
        The mosaic; None without one.

    Returns
    -------
    tuple
        By filter, then by channel. With one filter a band has the name of its channel.
    """
    if mosaic is None:
        return tuple(SimulatedBand(name, name) for name in filters)
    small = {letter: letter.lower() for letter in mosaic.dyes}
    names = small if len(set(small.values())) == len(small) else {letter: letter for letter in small}
    return tuple(
        SimulatedBand(names[letter] if len(filters) == 1 else f"{name}-{names[letter]}", name, letter)
        for name in filters
        for letter in mosaic.dyes
    )


def interleaved(
    planes: NDArray[np.float64], bands: Sequence[SimulatedBand], mosaic: MosaicSensor | None
) -> NDArray[np.float64]:
    """The frame of one filter: each pixel has the value of its channel.

    Parameters
    ----------
    planes
        (band, y, x) values of the filter's bands at all pixels.
    bands
        These bands.
    mosaic
        The mosaic; None without one.

    Returns
    -------
    NDArray
        (y, x) the values of one frame; the only plane without a mosaic.
    """
    frame = planes[0].copy()
    for band, plane in zip(bands, planes, strict=True):
        if mosaic is not None and band.channel is not None:
            np.copyto(frame, plane, where=channel_mask(mosaic.pattern, (plane.shape[0], plane.shape[1]), band.channel))
    return frame
