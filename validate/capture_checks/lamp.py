"""Checks of the photographs' light against the lamp's and of the bands against each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.quality import Suspicion, centre_nm, power_law
from cboxlab.calibration.radiometry import Radiometry
from numpy.typing import NDArray

from .scene_view import SceneView, lamp_signals, relative_radiance

__all__ = ["check_lamp"]

#: Plausible light over the light that the lamp gives a known scene: the lamp's power may be off by a third.
PLAUSIBLE_LIGHT = (0.6, 1.6)

#: Plausible light of one band over the median of all: strong effects of the catalogue change it by some per cent.
PLAUSIBLE_BAND = (0.82, 1.25)

#: Largest plausible excess of the bands at the ends of the spectrum: ambient light and leaks brighten dim bands.
PLAUSIBLE_END_BAND = 1.7

#: Fewest unlike bands that show another lamp: a white balance changes two.
FEWEST_OF_ANOTHER_LAMP = 3

#: Their smallest share of the bands: exposures go wrong one by one.
SHARE_OF_ANOTHER_LAMP = 0.4

#: Plausible radiance over that of the lamp if the scene is not known: a dark box to a lamp in the picture.
PLAUSIBLE_RADIANCE = (2e-5, 1.2)

#: A band of an unknown scene is suspected below this share of the median of all bands.
DIM_BAND = 0.5

#: A band of an unknown scene is suspected below this share of the mean of its neighbours.
DIM_AMONG_NEIGHBOURS = 0.15

#: Percentile of the pixels that stands for the light of an unknown scene: bright surfaces, without the lamp.
BRIGHT_PERCENTILE = 95

#: Smallest direct light of the compared pixels over that of the brightest: elsewhere interreflection dominates.
WELL_LIT = 0.3

#: Smallest mean reflectance of the compared pixels: light scattered in the camera matters less than on dark paint.
BRIGHT_REFLECTANCE = 0.3

#: Fewest pixels of bright paint; with fewer, well-lit pixels of all paints are compared.
FEWEST_PIXELS = 12

#: Fewest bands that can be compared with each other: the median of two is no third opinion.
FEWEST_BANDS = 3


def check_lamp(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    channels: Mapping[str, str] | None,
    view: SceneView | None,
) -> Iterator[Suspicion]:
    """Check the photographs' radiance against the lamp's and each band against the others.

    Where the capture claims no absolute scale, the bands alone are compared, and nothing where each band's is free.

    Parameters
    ----------
    capture
        A capture.
    bands
        The capture's corrected signals.
    radiometry
        The capture's constant C.
    channels
        Channel of each band of a sensor with a mosaic; None without one.
    view
        The capture's known scene, whose interreflection is computed if it is diffuse; None leaves wider limits.

    Yields
    ------
    Suspicion
        For the lamp's radiance, then for each band that does not fit.
    """
    signals = lamp_signals(capture, radiometry, channels)
    if signals is None or capture.manifest.is_free_by_band:
        return
    if view is not None and view.scene.diffuse:
        level, (low, high) = _light_over_expected(view), PLAUSIBLE_LIGHT
        unit = "the lamp and the surfaces' reflectances give"
    else:
        level = np.nanpercentile(relative_radiance(bands, signals, capture.cell), BRIGHT_PERCENTILE, axis=(1, 2))
        low, high = PLAUSIBLE_RADIANCE
        unit = "the lamp"
    finite = np.isfinite(level)
    if not np.any(finite):
        return
    middle = float(np.median(level[finite]))
    if capture.manifest.is_absolute and not low < middle < high:
        yield Suspicion(
            "the lamp's radiance does not suit the photographs (its unit, or the exposures)",
            "lamp.radiance",
            f"The surfaces are {middle:.3g} times as bright as {unit}; {low:g} to {high:g} is plausible.",
        )
    if np.count_nonzero(finite) < FEWEST_BANDS or not middle > 0:
        return
    ratios = level / middle / _leaks(capture, radiometry)
    if view is not None and view.scene.diffuse:
        yield from _check_bands(capture, ratios)
    else:
        yield from _check_dim_bands(capture, level, ratios)


def _leaks(capture: Capture, radiometry: Radiometry) -> NDArray[np.float64]:
    """(band,) C over the median, at least 1: a leak brightens reference and photograph."""
    constants = {c.band: c.constant for c in radiometry.by_band}
    usual = float(np.median(list(constants.values()))) if constants else 1.0
    return np.array([max(constants.get(band, usual) / usual, 1.0) for band in capture.band_ids])


def _light_over_expected(view: SceneView) -> NDArray[np.float64]:
    """(band,) light of well-lit bright pixels over the rendering's; NaN without such pixels."""
    direct, illuminated = view.preview.direct, view.preview.on_surface & (view.preview.direct > 0)
    if not np.any(illuminated):
        return np.full(len(view.relative), np.nan)
    well_lit = illuminated & (direct > WELL_LIT * np.percentile(direct[illuminated], 95))
    well_lit &= np.isfinite(view.relative[view.clear]).all(axis=0)
    brightness = view.reflectance.mean(axis=1)[np.where(illuminated, view.preview.surface, 0)]
    bright = well_lit & (brightness > BRIGHT_REFLECTANCE)
    compared = bright if np.count_nonzero(bright) >= FEWEST_PIXELS else well_lit
    if not np.any(compared):
        return np.full(len(view.relative), np.nan)
    expected = view.preview.radiance[:, compared].sum(axis=1)
    return np.asarray(view.relative[:, compared].sum(axis=1) / np.maximum(expected, 1e-300), np.float64)


def _check_bands(capture: Capture, ratios: NDArray[np.float64]) -> Iterator[Suspicion]:
    """Bands of a known scene whose light over the expected is unlike the other bands'.

    ratios : (band,) over the median of all bands.
    """
    centre = np.array([centre_nm(capture, band) for band in capture.manifest.band])
    if power_law(centre, ratios) == -1:
        yield Suspicion(
            "the lamp's table is in quanta, not in energy",
            "lamp.radiance",
            "The bands' light over what the table gives falls as one over the wavelength.",
        )
        return
    low, high = PLAUSIBLE_BAND
    unlike = ~((ratios > low) & (ratios < high)) & np.isfinite(ratios)
    ends = np.isin(np.arange(len(centre)), (np.argmin(centre), np.argmax(centre)))
    unlike &= ~(ends & (ratios > 1) & (ratios < PLAUSIBLE_END_BAND))
    compared = np.count_nonzero(np.isfinite(ratios))
    if np.count_nonzero(unlike) >= max(FEWEST_OF_ANOTHER_LAMP, SHARE_OF_ANOTHER_LAMP * compared):
        factors = ", ".join(f"{ratio:.3g} in {band}" for band, ratio in zip(capture.band_ids, ratios, strict=True))
        yield Suspicion(
            "the lamp's spectrum does not suit the photographs (another lamp, or most exposures or filters are wrong)",
            "lamp.radiance",
            "The light over what the lamp's spectrum and the surfaces' reflectances give is, relative to the median, "
            f"{factors}.",
        )
        return
    for index in np.flatnonzero(unlike):
        yield _unsuitable(capture, int(index), ratios[index], "that of the other bands")


def _check_dim_bands(capture: Capture, level: NDArray[np.float64], ratios: NDArray[np.float64]) -> Iterator[Suspicion]:
    """Bands of an unknown scene that are much dimmer than their neighbours.

    level : (band,) radiance over the lamp's. ratios : (band,) the same over the median of all bands.
    """
    for index in range(len(capture.band_ids)):
        neighbours = [level[k] for k in (index - 1, index + 1) if 0 <= k < level.size]
        ratio = level[index] / max(np.mean(neighbours), 1e-300)
        if ratios[index] < DIM_BAND and ratio < DIM_AMONG_NEIGHBOURS:
            yield _unsuitable(capture, index, ratio, "that of its neighbours")


def _unsuitable(capture: Capture, index: int, ratio: float, other: str) -> Suspicion:
    """Suspicion of a band whose light is ``ratio`` times that of ``other``."""
    band = capture.band_ids[index]
    return Suspicion(
        f"{band} does not suit the lamp and the other bands (its exposure, aperture, filter or frames)",
        f"band[{index}] ({band})",
        f"Its light is {ratio:.3g} times {other}, by the lamp's spectrum and the surfaces' reflectances.",
    )
