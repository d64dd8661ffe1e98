"""Raw frames as DNG 1.4 files (Adobe, Digital Negative Specification 1.4, 2012)."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.calibration.instrument import colour_matching_functions
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import ArrayLike, NDArray

from ..sensor import SensorCamera, chart_reflectances

__all__ = ["write_dng"]

#: Types of TIFF's tags.
_BYTE = 1
_ASCII = 2
_SHORT = 3
_LONG = 4
_RATIONAL = 5
_SRATIONAL = 10

#: Tag of the photometric interpretation.
_PHOTOMETRIC = 262

#: Photometric interpretation of frames without mosaic.
_LINEAR_RAW = 34892

#: Calibration illuminant D65.
_D65 = 21

#: Largest linear value of a linearisation table, which has 16 bits.
_TABLE_TOP = 65535.0

#: Bit depth below which a linearisation table is written: converters may round the black level to integer counts.
_FEW_BITS = 12


def write_dng(path: Path, counts: NDArray[np.uint16], camera: SensorCamera, exposure_s: float, white: Spectrum) -> None:
    """Write counts, unchanged, with the tags that converters need.

    The tags hold the dark level, the response curve F (as a linearisation table) and the colour filter array. A colour
    matrix is fitted to the ColorChecker under D65. Frames without mosaic are grey.

    Parameters
    ----------
    path
        File to write; an incomplete one is removed.
    counts
        (y, x) counts, DN.
    camera
        Camera of the frame.
    exposure_s
        Exposure, s.
    white
        Light of the scene, for the camera's neutral.

    Raises
    ------
    InputError
        If the mosaic is not 2 x 2 letters R, G and B, if a channel does not see the white, or if the path cannot be
        written to.
    """
    detector = camera.detector
    top, black = float(detector.full_scale_dn), detector.dark(exposure_s)[0]
    tags: list[tuple] = [
        (271, _ASCII, 0, "cboxlab", True),
        (272, _ASCII, 0, camera.name, True),
        (33434, _RATIONAL, 1, _rational([exposure_s]), True),
        (50706, _BYTE, 4, (1, 4, 0, 0), True),
        (50707, _BYTE, 4, (1, 1, 0, 0), True),
        (50708, _ASCII, 0, camera.name, True),
    ]
    if detector.linear_dn is not None or detector.bit_depth < _FEW_BITS:
        linear = detector.linearise(np.arange(2**detector.bit_depth))
        scale = _TABLE_TOP / linear[-1]
        table = np.rint(linear * scale).astype(int)
        tags.append((50712, _SHORT, table.size, tuple(table.tolist()), True))
        top, black = _TABLE_TOP, black * scale
    tags += [
        (50714, _RATIONAL, 1, _rational([max(black, 0.0)]), True),
        (50717, _LONG, 1, int(top), True),
    ]
    if camera.pattern is not None:
        tags += _colour_tags(camera, white)
    try:
        with replacing(path) as temporary:
            tifffile.imwrite(
                temporary,
                counts,
                photometric="minisblack" if camera.pattern is None else "cfa",
                metadata=None,
                extratags=tags,
                software=False,
                description=None,
            )
            if camera.pattern is None:  # tifffile supports linear raw only with three samples
                with tifffile.TiffFile(temporary, mode="r+") as file:
                    file.pages.first.tags[_PHOTOMETRIC].overwrite(_LINEAR_RAW)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be written") from None


def _colour_tags(camera: SensorCamera, white: Spectrum) -> list[tuple]:
    """Tags of the colour filter array, the colour matrix and the neutral."""
    pattern = camera.pattern or ()
    if [len(row) for row in pattern] != [2, 2] or set(camera.channels) != set("RGB"):
        where = f"camera {camera.name}: mosaic.pattern"
        raise InputError(where, repr(list(pattern)), "2 x 2 letters R, G, B for a DNG", "Write a .tif instead.")
    cells = tuple("RGB".index(letter) for row in pattern for letter in row)
    sensitivity = np.stack([camera.channels[letter].at(WAVELENGTH_NM) for letter in "RGB"])
    neutral = sensitivity @ white.at(WAVELENGTH_NM)
    if neutral.min() <= 0:
        raise InputError("DNG: white", "light with no signal in a channel", "light with a signal in all channels")
    return [
        (33421, _SHORT, 2, (2, 2), True),
        (33422, _BYTE, 4, bytes(cells), True),
        (50721, _SRATIONAL, 9, _rational(_matrix(sensitivity).ravel()), True),
        (50728, _RATIONAL, 3, _rational(neutral / neutral.max()), True),
        (50778, _SHORT, 1, _D65, True),
    ]


def _matrix(sensitivity: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) from XYZ to camera channels under D65, fitted to the ColorChecker.

    Y is 1 for white, as is white in the strongest channel.
    """
    from colour import SDS_ILLUMINANTS  # slow to import, and only needed here

    table = SDS_ILLUMINANTS["D65"]
    light = np.interp(WAVELENGTH_NM, table.wavelengths, table.values)
    stimuli = np.vstack([chart_reflectances(), np.ones(WAVELENGTH_NM.size)]) * light
    xyz = stimuli @ colour_matching_functions().T
    channels = stimuli @ sensitivity.T
    fitted = np.linalg.lstsq(xyz / xyz[-1, 1], channels / channels[-1].max(), rcond=None)[0]
    return np.asarray(fitted.T, np.float64)


def _rational(values: ArrayLike) -> tuple[int, ...]:
    """Numerators and denominators, alternating."""
    parts = [Fraction(float(value)).limit_denominator(1_000_000) for value in np.atleast_1d(values)]
    return tuple(number for part in parts for number in (part.numerator, part.denominator))
