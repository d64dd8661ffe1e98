"""Check for exchanged frames of bands, by the colours of a known scene's materials."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.quality import Suspicion
from numpy.typing import NDArray

from .scene_view import SceneView

__all__ = ["check_materials"]

#: Largest share of the mean square misfit that an exchange of two bands leaves.
SWAP_SHARE = 0.4

#: Smallest suspicious rms misfit, natural log: sound captures have 0.07 to 0.11.
SMALLEST_MISFIT = 0.12

#: Smallest suspicious rms misfit of a single band, natural log.
SMALLEST_BAND_MISFIT = 0.5

#: Smallest ratio of a single band's misfit to that of all others.
BAND_MISFIT_RATIO = 4

#: Fewest usable pixels of a material: the median of fewer has the noise of single pixels.
FEWEST_PIXELS = 12

#: Fewest bands: with three, each exchange fits about as well as another.
FEWEST_BANDS = 4

#: Smallest reflectance, which keeps logarithms finite.
SMALLEST_REFLECTANCE = 1e-6


@dataclass(frozen=True, eq=False)
class _Colours:
    """Colours of n materials relative to the most common one, natural logarithms."""

    #: (n, band) measured.
    measured: NDArray[np.float64]
    #: (n, band) by the reflectance tables.
    expected: NDArray[np.float64]
    #: Names of the materials.
    names: list[str]
    #: Indices of the bands with a signal, in the order of the columns.
    bands: list[int]


def check_materials(capture: Capture, view: SceneView | None) -> Iterator[Suspicion]:
    """Detect exchanged frames of two bands and frames of another band, by the materials.

    Parameters
    ----------
    capture
        A capture.
    view
        The capture's known scene; None leaves the check out.

    Yields
    ------
    Suspicion
        For two exchanged bands, or else for the one band that does not fit; at most one.
    """
    colours = None if view is None or np.count_nonzero(view.clear) < FEWEST_BANDS else _colours(view)
    if colours is None:
        return
    misfit = _misfit(colours.measured, colours.expected)
    if misfit < SMALLEST_MISFIT**2:
        return
    exchange = _exchanged_bands(capture, colours, misfit)
    yield from (exchange,) if exchange is not None else _foreign_band(capture, colours)


def _colours(view: SceneView) -> _Colours | None:
    """Colours of the visible materials; None if fewer than two are visible."""
    names, clear = [surface.material for surface in view.scene.surfaces], view.clear
    measured, expected, counts = [], [], {}
    for material in dict.fromkeys(names):
        members = [index for index, name in enumerate(names) if name == material]
        pixels = np.isin(view.preview.surface, members)
        if np.count_nonzero(pixels & np.isfinite(view.relative[clear]).all(axis=0)) < FEWEST_PIXELS:
            continue
        values = np.nanmedian(view.relative[clear][:, pixels], axis=1)
        if not np.all(values > 0):
            continue
        measured.append(np.log(values))
        expected.append(np.log(np.maximum(view.reflectance[members[0], clear], SMALLEST_REFLECTANCE)))
        counts[material] = np.count_nonzero(pixels)
    if len(counts) < 2:
        return None
    base = int(np.argmax([*counts.values()]))
    others = [index for index in range(len(counts)) if index != base]
    return _Colours(
        np.array([measured[index] - measured[base] for index in others]),
        np.array([expected[index] - expected[base] for index in others]),
        [[*counts][index] for index in others],
        np.flatnonzero(clear).tolist(),
    )


def _misfit(measured: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Mean square difference less the median of each material, which interreflection changes."""
    difference = measured - expected
    return float(np.mean((difference - np.median(difference, axis=1, keepdims=True)) ** 2))


def _exchanged_bands(capture: Capture, colours: _Colours, misfit: float) -> Suspicion | None:
    """The exchange of two bands that fits best; None if it leaves too much of the misfit.

    Behind a mosaic frames are exchanged with all their channels.
    """
    groups: dict[tuple[str, ...], dict[str | None, int]] = {}
    for column, index in enumerate(colours.bands):
        band = capture.manifest.band[index]
        groups.setdefault(band.frames, {})[band.channel] = column
    swaps = {}
    for first, second in itertools.combinations(groups, 2):
        order = np.arange(len(colours.bands))
        for channel in groups[first].keys() & groups[second].keys():
            i, j = groups[first][channel], groups[second][channel]
            order[[i, j]] = j, i
        swaps[first, second] = _misfit(colours.measured[:, order], colours.expected)
    best = min(swaps, key=swaps.__getitem__, default=None)
    if best is None or swaps[best] >= SWAP_SHARE * misfit:
        return None
    names = [[colours.bands[column] for column in groups[frames].values()] for frames in best]
    first_text, second_text = (", ".join(capture.band_ids[index] for index in indices) for indices in names)
    return Suspicion(
        f"the frames of {first_text} and {second_text} are exchanged",
        ", ".join(f"band[{index}] ({capture.band_ids[index]}).frames" for indices in names for index in indices),
        f"The colours of {', '.join(colours.names)} differ from their tables by {np.sqrt(misfit):.0%} (rms), by "
        f"{np.sqrt(swaps[best]):.0%} with the two exchanged.",
    )


def _foreign_band(capture: Capture, colours: _Colours) -> Iterator[Suspicion]:
    """The band that does not fit the tables, if all others do."""
    difference = colours.measured - colours.expected
    difference = difference - np.median(difference, axis=1, keepdims=True)
    worst = int(np.argmax(np.sum(difference**2, axis=0)))
    others = np.sqrt(np.mean(np.delete(difference, worst, axis=1) ** 2))
    misfit = np.sqrt(np.mean(difference[:, worst] ** 2))
    if misfit > max(SMALLEST_BAND_MISFIT, BAND_MISFIT_RATIO * others):
        index = colours.bands[worst]
        yield Suspicion(
            f"the frames of {capture.band_ids[index]} are those of another band",
            f"band[{index}] ({capture.band_ids[index]}).frames",
            f"The colours of {', '.join(colours.names)} differ from their tables by {misfit:.0%} in it, by "
            f"{others:.0%} in the others.",
        )
