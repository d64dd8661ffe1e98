"""Checks of the bands against each other, against the lamp and against the materials of a known scene."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from ..capture import Capture
from ..correction import CorrectedBands
from ..radiometry import (
    Radiometry,
    optical_factor,
    register,
    response_curve,
)
from .constants import centre_nm, power_law
from .sight import Sight, radiance_over_lamp, see
from .suspicion import Suspicion

__all__ = ["SceneView", "check_lamp", "check_materials", "check_registration", "view_scene"]

#: Plausible range of the photographs' light over what a known scene and its lamp give, and of one band over the median
#: of all. Strong effects of the catalogue change bands by some per cent and the lamp's power by a third.
_PLAUSIBLE_LIGHT, _PLAUSIBLE_BAND = (0.6, 1.6), (0.82, 1.25)
#: Highest plausible excess of the bands at the ends of the spectrum.
_BRIGHT_END = 1.7
#: Plausible range of radiance over that of the lamp if the scene is not known, and of a band beside its neighbours.
_DIMMEST, _BRIGHTEST = 2e-5, 1.2
_DIM_BAND, _DIM_BESIDE = 0.5, 0.15
_MOST_PIXELS = 400
#: A swap of two bands must reduce the misfit of the materials below this share; the smallest misfit (natural log).
_SWAP_SHARE, _SWAP_MISFIT = 0.4, 0.12
_SHIFT_PX = 0.75
_FEWEST_PIXELS = 12


@dataclass(frozen=True, eq=False)
class SceneView:
    """A known scene seen by the calibrated camera, and the signals of the bands.

    reflectance : (surface, band), mean weighted with the band's response to the lamp. relative : (band, y, x) radiance
    relative to the lamp's on the grid of ``sight``, NaN for masked pixels.
    """

    scene: Scene
    sight: Sight
    reflectance: NDArray[np.float64]
    relative: NDArray[np.float64]


def _lamp_signals(
    capture: Capture, radiometry: Radiometry, channels: Mapping[str, str] | None
) -> NDArray[np.float64] | None:
    """(band,) DN of a field with the lamp's radiance; None if a table is missing."""
    lamp = capture.manifest.lamp
    if lamp is None or radiometry.constant is None:
        return None
    light = capture.light(lamp.radiance).at(WAVELENGTH_NM) * INTEGRAL_GRID.weights
    signals = []
    for band in capture.manifest.band:
        curve = response_curve(capture, band, None if channels is None else channels[band.id])
        factor = optical_factor(capture, band)
        if curve is None or factor is None:
            return None
        signals.append(radiometry.constant * factor * float(np.sum(curve * light)))
    found = np.array(signals)
    return found if np.all(found > 0) else None


def _relative(bands: CorrectedBands, signals: NDArray[np.float64]) -> NDArray[np.float64]:
    out = bands.images["mask"].values != 0
    return np.where(out, np.nan, bands.images["signal"].values) / signals[:, None, None]


def view_scene(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    camera: Camera | None,
    channels: Mapping[str, str] | None,
) -> SceneView | None:
    """The scene seen by the camera; None if scene, camera, lamp or a table of the sensor equation is not known.

    None for several lamps, too: the capture states the spectrum of one.
    """
    scene = capture.known_scene()
    signals = _lamp_signals(capture, radiometry, channels)
    lamp = capture.manifest.lamp
    if (
        scene is None
        or scene.further_lamps
        or camera is None
        or signals is None
        or lamp is None
        or channels is not None
    ):
        return None
    sight = see(scene, camera)
    light = capture.light(lamp.radiance).at(WAVELENGTH_NM)
    weights = []
    for band in capture.manifest.band:
        curve = response_curve(capture, band)
        if curve is None:
            return None
        weights.append(curve * light / np.sum(curve * light))
    reflectance = np.array(
        [
            [float(np.sum(w * scene.materials[s.material].reflectance.at(WAVELENGTH_NM))) for w in weights]
            for s in scene.surfaces
        ]
    )
    step = sight.step
    return SceneView(scene, sight, reflectance, _relative(bands, signals)[:, ::step, ::step])


def check_lamp(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    channels: Mapping[str, str] | None,
    view: SceneView | None,
) -> Iterator[Suspicion]:
    """Checks the radiance of the photographs against the lamp's, and each band against the others."""
    signals = _lamp_signals(capture, radiometry, channels)
    if signals is None:
        return
    known = view is not None and view.scene.diffuse
    if view is not None and view.scene.diffuse:
        level, (low, high) = _light_over_expected(view), _PLAUSIBLE_LIGHT
    else:
        level = np.nanpercentile(_relative(bands, signals), 95, axis=(1, 2))
        low, high = _DIMMEST, _BRIGHTEST
    good = np.isfinite(level)
    if np.count_nonzero(good) < 1:
        return
    middle = float(np.median(level[good]))
    unit = "the lamp and the surfaces' reflectances give" if known else "the lamp"
    if not low < middle < high:
        yield Suspicion(
            "the lamp's radiance does not suit the photographs (its unit, or the exposures)",
            "lamp.radiance",
            f"The surfaces are {middle:.3g} times as bright as {unit}; {low:g} to {high:g} is plausible.",
        )
    if np.count_nonzero(good) < 3 or not middle > 0:
        return
    constants = {c.band: c.constant for c in radiometry.by_band}
    usual = float(np.median(list(constants.values()))) if constants else 1.0
    # A leak of the filter brightens reference and photograph alike.
    leaks = np.array([max(constants.get(band, usual) / usual, 1.0) for band in capture.band_ids])
    ratios = level / middle / leaks
    if known:
        yield from _band_by_band(capture, ratios)
        return
    for index in range(len(capture.band_ids)):
        around = [level[k] for k in (index - 1, index + 1) if 0 <= k < level.size]
        ratio = level[index] / max(np.mean(around), 1e-300)
        if ratios[index] < _DIM_BAND and ratio < _DIM_BESIDE:
            yield _unsuitable(capture, index, ratio, "that of its neighbours")


def _band_by_band(capture: Capture, ratios: NDArray[np.float64]) -> Iterator[Suspicion]:
    """Bands that are brighter or darker than the lamp's spectrum and the surfaces' reflectances make them.

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
    low, high = _PLAUSIBLE_BAND
    odd = ~((ratios > low) & (ratios < high)) & np.isfinite(ratios)
    # ambient light and leaks beyond the tables brighten the dimmest bands, those at either end of the spectrum
    ends = np.isin(np.arange(len(centre)), (np.argmin(centre), np.argmax(centre)))
    odd &= ~(ends & (ratios > 1) & (ratios < _BRIGHT_END))
    for index in np.flatnonzero(odd):
        yield _unsuitable(capture, int(index), ratios[index], "that of the other bands")


def _unsuitable(capture: Capture, index: int, ratio: float, other: str) -> Suspicion:
    band = capture.band_ids[index]
    return Suspicion(
        f"{band} does not suit the lamp and the other bands (its exposure, aperture, filter or frames)",
        f"band[{index}] ({band})",
        f"Its light is {ratio:.3g} times {other}, by the lamp's spectrum and the surfaces' reflectances.",
    )


def _light_over_expected(view: SceneView) -> NDArray[np.float64]:
    """(band,) light of well-lit bright pixels over what the lamp gives them, interreflection included."""
    surface, direct = view.sight.surface, view.sight.direct
    known = (surface >= 0) & (surface < len(view.scene.surfaces)) & (direct > 0)
    if not np.any(known):
        return np.full(len(view.relative), np.nan)
    lit = known & (direct > 0.3 * np.percentile(direct[known], 95)) & np.isfinite(view.relative).all(axis=0)
    bright = lit & (view.reflectance.mean(axis=1)[np.where(known, surface, 0)] > 0.3)
    chosen = np.flatnonzero(bright if np.count_nonzero(bright) >= _FEWEST_PIXELS else lit)
    chosen = chosen[:: max(1, len(chosen) // _MOST_PIXELS)]
    if not len(chosen):
        return np.full(len(view.relative), np.nan)
    place, normal = (part.reshape(-1, 3)[chosen] for part in (view.sight.place_mm, view.sight.normal))
    expected = radiance_over_lamp(view.scene, place, normal, surface.ravel()[chosen], view.reflectance)
    measured = view.relative.reshape(len(view.relative), -1)[:, chosen]
    return np.asarray(measured.sum(axis=1) / np.maximum(expected.sum(axis=0), 1e-300), np.float64)


def _features(view: SceneView) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]] | None:
    """(material, band) logarithms of measured light and of reflectance, minus those of the most common material."""
    surface = view.sight.surface
    names = [s.material for s in view.scene.surfaces]
    measured, stated, kept = [], [], []
    for material in dict.fromkeys(names):
        members = [i for i, name in enumerate(names) if name == material]
        pixels = np.isin(surface, members)
        if np.count_nonzero(pixels & np.isfinite(view.relative).all(axis=0)) < _FEWEST_PIXELS:
            continue
        values = np.nanmedian(view.relative[:, pixels], axis=1)
        if not np.all(values > 0):
            continue
        measured.append(np.log(values))
        stated.append(np.log(np.maximum(view.reflectance[members[0]], 1e-6)))
        kept.append((np.count_nonzero(pixels), material))
    if len(kept) < 2:
        return None
    base = int(np.argmax([count for count, _ in kept]))
    rest = [i for i in range(len(kept)) if i != base]
    return (
        np.array([measured[i] - measured[base] for i in rest]),
        np.array([stated[i] - stated[base] for i in rest]),
        [kept[i][1] for i in rest],
    )


def _misfit(measured: NDArray[np.float64], stated: NDArray[np.float64]) -> float:
    """Mean square difference after fitting one factor per material (interreflection changes the level)."""
    off = measured - stated
    return float(np.mean((off - np.median(off, axis=1, keepdims=True)) ** 2))


def check_materials(capture: Capture, view: SceneView | None) -> Iterator[Suspicion]:
    """Detects exchanged frames of two bands, from the colours of the materials."""
    features = None if view is None or len(capture.band_ids) < 4 else _features(view)
    if features is None:
        return
    measured, stated, materials = features
    as_is = _misfit(measured, stated)
    if as_is < _SWAP_MISFIT**2:
        return
    swaps = {}
    for i, j in itertools.combinations(range(measured.shape[1]), 2):
        order = np.arange(measured.shape[1])
        order[[i, j]] = j, i
        swaps[i, j] = _misfit(measured[:, order], stated)
    i, j = min(swaps, key=swaps.__getitem__)
    first, second = capture.band_ids[i], capture.band_ids[j]
    if swaps[i, j] < _SWAP_SHARE * as_is:
        yield Suspicion(
            f"the frames of {first} and {second} are exchanged",
            f"band[{i}] ({first}).frames, band[{j}] ({second}).frames",
            f"The colours of {', '.join(materials)} differ from their tables by {np.sqrt(as_is):.0%} (rms), by "
            f"{np.sqrt(swaps[i, j]):.0%} with the two exchanged.",
        )
        return
    off = measured - stated
    off = off - np.median(off, axis=1, keepdims=True)
    worst = int(np.argmax(np.sum(off**2, axis=0)))
    rest = np.delete(off, worst, axis=1)
    if np.sqrt(np.mean(off[:, worst] ** 2)) > max(0.5, 4 * np.sqrt(np.mean(rest**2))):
        yield Suspicion(
            f"the frames of {capture.band_ids[worst]} are those of another band",
            f"band[{worst}] ({capture.band_ids[worst]}).frames",
            f"The colours of {', '.join(materials)} differ from their tables by "
            f"{np.sqrt(np.mean(off[:, worst] ** 2)):.0%} in it, by {np.sqrt(np.mean(rest**2)):.0%} in the others.",
        )


def _shift(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2,) shift of the edges of ``other`` relative to ``one``, px; NaN without common edges."""
    found = register(one, other)
    return found.shift_px if found.found and found.correlation > 0.5 else np.full(2, np.nan)


def _agrees(one: NDArray[np.float64], other: NDArray[np.float64], shift: NDArray[np.float64]) -> bool:
    """Whether all four halves of the picture have the same shift, which noise without edges does not have."""
    v, u = (n // 2 for n in one.shape)
    halves = (np.s_[:v], np.s_[v:], np.s_[:, :u], np.s_[:, u:])
    return all(np.hypot(*(_shift(one[half], other[half]) - shift)) < _SHIFT_PX / 2 for half in halves)


def check_registration(capture: Capture, bands: CorrectedBands) -> Iterator[Suspicion]:
    """Detects a band shifted relative to the others; lenses change the magnification between bands, not the shift."""
    if capture.manifest.mosaic is not None or len(capture.band_ids) < 3 or min(capture.shape) < 32:
        return
    # Every second pixel of larger pictures tells as well, in a fourth of the time.
    step = 1 + (max(capture.shape) > 160)
    signal = bands.images["signal"].values[:, ::step, ::step]
    order = np.argsort([np.nanpercentile(s, 90) for s in signal])
    middle = int(order[len(order) // 2])
    shifts = step * np.array([_shift(signal[middle], image) for image in signal])
    own = np.median(shifts[np.all(np.isfinite(shifts), axis=1)], axis=0)
    for index, (u, v) in enumerate(shifts - own):
        # If the reference band itself is shifted, compare with another band.
        base = middle if index != middle else int(order[0])
        if np.hypot(u, v) > _SHIFT_PX and (
            _agrees(signal[base], signal[index], shifts[index] / step)
            if index != middle
            else _agrees(signal[index], signal[base], shifts[base] / step)
        ):
            band = capture.band_ids[index]
            yield Suspicion(
                f"the photograph of {band} is moved against the other bands (a moved camera, another capture's frames)",
                f"band[{index}] ({band}).frames",
                f"Its edges lie ({u:+.2f}, {v:+.2f}) px from theirs.",
            )
