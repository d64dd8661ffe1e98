"""Channels of a mosaic behind one narrow filter, joined to one column of patch reflectances.

What differs between the channels has one size in counts, not in reflectance: read noise, rounding, the black level and
light from outside the pass band. The variance of a channel's reflectances is therefore proportional to 1 / level^2,
with the level of the white patch, and so are the weights to level^2. The error of the illumination is common to the
channels of a filter and is no reason to prefer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..capture import Capture, channel_of_filter, split_channel

__all__ = ["BandColumns", "joined_channels"]

#: Standard deviations by which the channels behind one filter may differ, rms over the patches: chance exceeds it once
#: in 200 filters with 24 patches.
_AGREEMENT_SIGMAS = 1.4
#: Difference in reflectance below which channels behind one filter agree in any case: their pass bands differ.
_AGREEMENT = 0.01


@dataclass(frozen=True, eq=False)
class BandColumns:
    """Reflectances of n patches in m bands, scaled by the white patch."""

    #: m identifiers of bands.
    bands: tuple[str, ...]
    #: (n, m) band reflectances.
    reflectance: NDArray[np.float64]
    #: (n, m) standard deviations.
    sigma: NDArray[np.float64]
    #: (m, wavelength) weights of unit sum.
    filters: NDArray[np.float64]
    #: (m,) tabulated band reflectances of the white patch.
    white: NDArray[np.float64]
    #: (m,) signals of the white patch, DN.
    level: NDArray[np.float64]
    #: Channels that were joined, one sentence a filter.
    notes: tuple[str, ...] = ()


def joined_channels(capture: Capture, columns: BandColumns) -> BandColumns:
    """Join the channels of the same frames behind a filter, weighted by their squared signals.

    The channel that is chosen where none is stated gives the column its name. Another one that differs from it by more
    than noise sees light from outside the pass band, and is left out.

    Parameters
    ----------
    capture
        The capture.
    columns
        One column for each of its bands.

    Returns
    -------
    BandColumns
        One column for each filter whose bands state a channel, and for each other band.
    """
    joined, notes = [], []
    for members in _groups(capture):
        first = _reference(capture, members)
        used = [index for index in members if index == first or _agree(columns, first, index)]
        # one weight for all patches: weights of each patch would favour signals that noise makes small
        weight = columns.level[used] ** 2 / np.sum(columns.level[used] ** 2)
        reflectance = columns.reflectance[:, used] @ weight
        sigma = np.sqrt(columns.sigma[:, used] ** 2 @ weight**2)
        joined.append((columns.bands[first], reflectance, sigma, weight @ columns.filters[used]))
        if len(members) > 1:
            others = [columns.bands[index] for index in members if index not in used]
            notes.append(
                f"patches: column {columns.bands[first]} is of {', '.join(columns.bands[index] for index in used)}, "
                "weighted by their squared signals"
                + (f"; {', '.join(others)} differ by more and are left out" if others else "")
            )
    names, reflectances, sigmas, filters = zip(*joined, strict=True)
    order = [columns.bands.index(name) for name in names]
    return BandColumns(
        names,
        np.stack(reflectances, axis=1),
        np.stack(sigmas, axis=1),
        np.stack(filters),
        columns.white[order],
        columns.level[order],
        tuple(notes),
    )


def _groups(capture: Capture) -> list[list[int]]:
    """Positions of the bands by filter and frames; others stand alone."""
    groups: dict[tuple[str, ...], list[int]] = {}
    for index, band in enumerate(capture.manifest.band):
        together = band.channel is not None and band.transmittance is not None
        groups.setdefault((str(band.transmittance), *band.frames) if together else (band.id,), []).append(index)
    return list(groups.values())


def _reference(capture: Capture, members: Sequence[int]) -> int:
    """Position of the band whose channel suits the filter best."""
    bands = capture.manifest.band
    if len(members) == 1:
        return members[0]
    letter = channel_of_filter(capture, bands[members[0]])
    suited = [index for index in members if split_channel(str(bands[index].channel))[0] == letter]
    return (suited or list(members))[0]


def _agree(columns: BandColumns, first: int, other: int) -> bool:
    """Whether two channels show the same reflectances; no where no patch has one in both."""
    difference = columns.reflectance[:, other] - columns.reflectance[:, first]
    if np.all(np.isnan(difference)):
        return False
    noise = np.sqrt(np.nanmean(columns.sigma[:, other] ** 2 + columns.sigma[:, first] ** 2))
    return bool(np.sqrt(np.nanmean(difference**2)) < max(_AGREEMENT_SIGMAS * float(noise), _AGREEMENT))
