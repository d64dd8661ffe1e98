"""Names of bands in the order of their wavelengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.calibration.instrument import BandResponse, band_centres

__all__ = ["NamedBand", "named_bands"]

#: Index of a band in the comparison, and its name for the page.
NamedBand = tuple[int, str]


def named_bands(bands: Sequence[str], responses: Sequence[BandResponse]) -> list[NamedBand]:
    """Bands in the order of their wavelengths, with names for the page.

    Parameters
    ----------
    bands
        Identifiers of the bands.
    responses
        Responses of the same bands; empty if not known.

    Returns
    -------
    list
        (index, name) by wavelength, the name in nm; without responses in the given order, by identifier.
    """
    if not responses:
        return list(enumerate(bands))
    centres = band_centres(responses)
    return [(int(i), f"{centres[i]:.0f} nm") for i in np.argsort(centres, kind="stable")]
