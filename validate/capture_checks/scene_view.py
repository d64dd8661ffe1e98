"""The known scene of a capture through its calibrated camera, with the signals of the bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.instrument import Mask, interpolated_channel
from cboxlab.calibration.radiometry import Radiometry, optical_factor, response_curve
from cboxlab.rendering.device import variant
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from .scene_preview import ScenePreview, render_preview

__all__ = [
    "PaintLight",
    "SceneView",
    "lamp_signals",
    "light_of_paints",
    "relative_radiance",
    "view_scene",
    "without_gaps",
]

#: Fewest pixels of a paint in a band: the mean of fewer has the noise of single pixels.
FEWEST_PAINT_PIXELS = 12

#: Standard deviation of a median over the median absolute deviation and the root of the number: 1.4826 times 1.2533.
MEDIAN_TO_SIGMA = 1.858


@dataclass(frozen=True, eq=False)
class SceneView:
    """Rendering and photographs of a known scene by the calibrated camera, on one grid."""

    #: Scene of the capture, with one lamp.
    scene: Scene

    #: The calibrated camera.
    camera: Camera

    #: Rendering of the scene, in the bands.
    preview: ScenePreview

    #: (surface, band) mean of the reflectance weighted with the band's response to the lamp, 0 to 1.
    reflectance: NDArray[np.float64]

    #: (band, y, x) measured radiance over the lamp's, on the grid of ``preview``; NaN for masked pixels, and in bands
    #: whose signal is noise.
    relative: NDArray[np.float64]

    @property
    def clear(self) -> NDArray[np.bool_]:
        """(band,) True for bands with a signal."""
        return np.any(np.isfinite(self.relative), axis=(1, 2))


@dataclass(frozen=True, eq=False)
class PaintLight:
    """Light of the paints of a known scene over its rendering."""

    #: (shift, paint, band) natural logarithms, by displacement of the channels' tables; NaN without enough pixels.
    ratios: NDArray[np.float64]

    #: (paint, band) reflectance over that of the brightest paint.
    brightness: NDArray[np.float64]

    #: (paint, band) median signal, DN; NaN without enough pixels.
    signal: NDArray[np.float64]

    #: (paint, band) standard deviation of ``ratios``, by the scatter of the pixels about their mean ratio.
    scatter: NDArray[np.float64]


def lamp_signals(
    capture: Capture, radiometry: Radiometry, channels: Mapping[str, str] | None, displaced_nm: float = 0.0
) -> NDArray[np.float64] | None:
    """Signals of a field that has the lamp's radiance, by the sensor equation.

    Parameters
    ----------
    capture
        A capture.
    radiometry
        The capture's constant C.
    channels
        Channel of each band of a sensor with a mosaic; None without one.
    displaced_nm
        Displacement of the sensor's tables to longer wavelengths, nm.

    Returns
    -------
    NDArray or None
        (band,) signal above dark, DN, above 0; None if a table or C is missing or a band sees nothing of the lamp.
    """
    lamp = capture.manifest.lamp
    if lamp is None or radiometry.constant is None:
        return None
    light = capture.light(lamp.radiance).at(WAVELENGTH_NM) * INTEGRAL_GRID.weights
    values = []
    for band in capture.manifest.band:
        curve = response_curve(capture, band, None if channels is None else channels[band.id], displaced_nm)
        factor = optical_factor(capture, band)
        if curve is None or factor is None:
            return None
        values.append(radiometry.constant * factor * float(np.sum(curve * light)))
    signals = np.array(values)
    return signals if np.all(signals > 0) else None


def relative_radiance(
    bands: CorrectedBands, signals: NDArray[np.float64], cell: tuple[int, int] | None
) -> NDArray[np.float64]:
    """Measured radiance over that of the lamp.

    Parameters
    ----------
    bands
        Corrected signals.
    signals
        (band,) signals of the lamp's radiance, DN.
    cell
        (height, width) of the mosaic's repeat, px, whose gaps are filled from neighbours; None without a mosaic.

    Returns
    -------
    NDArray
        (band, y, x), NaN for masked pixels.
    """
    return without_gaps(bands, cell) / signals[:, None, None]


def without_gaps(bands: CorrectedBands, cell: tuple[int, int] | None) -> NDArray[np.float64]:
    """Signals with the gaps of every channel of a mosaic filled from neighbours.

    Parameters
    ----------
    bands
        Corrected signals.
    cell
        (height, width) of the mosaic's repeat, px; None without a mosaic.

    Returns
    -------
    NDArray
        (band, y, x) DN, NaN for masked pixels, behind a mosaic only where no pixel of the channel is near.
    """
    usable, signal = bands.images["mask"].values == 0, bands.images["signal"].values
    if cell is None:
        return np.where(usable, signal, np.nan)
    filled = [interpolated_channel(image, used, cell) for image, used in zip(signal, usable, strict=True)]
    other = (bands.images["mask"].values & ~np.uint8(Mask.OTHER_CHANNEL)) != 0
    return np.where(other, np.nan, np.stack(filled))


def _is_noise(bands: CorrectedBands) -> NDArray[np.bool_]:
    """(band,) True where most pixels are darker than their noise."""
    images, noise = bands.images, []
    for signal, variance, mask in zip(*(images[name].values for name in ("signal", "variance", "mask")), strict=True):
        usable = mask == 0
        excess = signal[usable] - np.sqrt(variance[usable])
        noise.append(not excess.size or bool(np.median(excess) < 0))
    return np.array(noise)


def view_scene(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    camera: Camera | None,
    channels: Mapping[str, str] | None,
) -> SceneView | None:
    """The known scene seen by the calibrated camera.

    Parameters
    ----------
    capture
        A capture.
    bands
        The capture's corrected signals.
    radiometry
        The capture's constant C.
    camera
        Camera of the survey; None if there is none.
    channels
        Channel of each band of a sensor with a mosaic; None without one.

    Returns
    -------
    SceneView or None
        None if scene, camera, lamp or a table of the sensor equation is missing. None also for several lamps, because
        the capture states the spectrum of one, and without a compiled variant.
    """
    scene = capture.scene
    signals = lamp_signals(capture, radiometry, channels)
    lamp = capture.manifest.lamp
    if scene is None or camera is None or signals is None or lamp is None:
        return None
    if scene.further_lamps or not variant.compiled():
        return None
    reflectances = _reflectances(capture, scene, lamp.radiance, channels)
    preview = render_preview(scene, camera, reflectances)
    names = [*scene.materials]
    of_surface = reflectances[[names.index(surface.material) for surface in scene.surfaces]]
    step = preview.step
    relative = relative_radiance(bands, signals, capture.cell)
    relative[_is_noise(bands)] = np.nan
    return SceneView(scene, camera, preview, of_surface, relative[:, ::step, ::step])


def _reflectances(
    capture: Capture, scene: Scene, lamp: str, channels: Mapping[str, str] | None, displaced_nm: float = 0.0
) -> NDArray[np.float64]:
    """(material + 1, band) reflectances weighted with the response to the lamp, 0 to 1."""
    light = capture.light(lamp).at(WAVELENGTH_NM)
    of_band = {} if channels is None else channels
    curves = [response_curve(capture, band, of_band.get(band.id), displaced_nm) for band in capture.manifest.band]
    weights = [curve * light / np.sum(curve * light) for curve in curves if curve is not None]
    # tables of a spoilt capture exceed 0 to 1
    return np.clip(scene.reflectances(WAVELENGTH_NM) @ np.array(weights).T, 0.0, 1.0)


def light_of_paints(
    capture: Capture,
    bands: CorrectedBands,
    radiometry: Radiometry,
    channels: Mapping[str, str],
    view: SceneView,
    shifts_nm: NDArray[np.float64],
) -> PaintLight:
    """Light of the paints over the rendering, with the tables of a mosaic's channels displaced.

    Pixels next to another surface are left out. In small pictures each band has its own pixels alone.

    Parameters
    ----------
    capture
        A capture with a lamp.
    bands
        The capture's corrected signals.
    radiometry
        The capture's constant C.
    channels
        Channel of each band.
    view
        The known scene.
    shifts_nm
        (shift,) displacements of all tables to longer wavelengths, nm.

    Returns
    -------
    PaintLight
        By paints with pixels, in the order of the scene's surfaces.
    """
    count, step = len(capture.band_ids), view.preview.step
    lamp = "" if capture.manifest.lamp is None else capture.manifest.lamp.radiance
    expected = view.preview.radiance[None]
    if np.any(shifts_nm):
        displaced = [_reflectances(capture, view.scene, lamp, channels, shift) for shift in shifts_nm]
        rendered = render_preview(view.scene, view.camera, np.concatenate(displaced, axis=1)).radiance
        expected = rendered.reshape(len(shifts_nm), count, *rendered.shape[1:])
    full = lamp_signals(capture, radiometry, channels)
    units = [lamp_signals(capture, radiometry, channels, shift) for shift in shifts_nm]
    usable = np.isfinite(view.relative)
    if step == 1:
        usable &= bands.images["mask"].values == 0
    names = [surface.material for surface in view.scene.surfaces]
    paints = list(dict.fromkeys(names))
    inside = view.preview.on_surface & _is_inside(view.preview.surface)
    ratios = np.full((len(shifts_nm), len(paints), count), np.nan)
    brightness, scatter = np.ones((len(paints), count)), np.zeros((len(paints), count))
    signal = np.full((len(paints), count), np.nan)
    for row, paint in enumerate(paints):
        of_paint = inside & np.isin(view.preview.surface, [k for k, name in enumerate(names) if name == paint])
        brightness[row] = view.reflectance[names.index(paint)] / np.maximum(view.reflectance.max(axis=0), 1e-9)
        for band in range(count):
            pixels = of_paint & usable[band]
            light = view.relative[band][pixels] / np.maximum(view.preview.radiance[band][pixels], 1e-300)
            if light.size < FEWEST_PAINT_PIXELS or not np.median(light) > 0 or full is None:
                continue
            spread = MEDIAN_TO_SIGMA * float(np.median(np.abs(light / np.median(light) - 1)))
            scatter[row, band] = spread / np.sqrt(light.size)
            signal[row, band] = full[band] * np.median(view.relative[band][pixels])
            for index, unit in enumerate(units):
                if unit is not None:
                    of_unit = unit[band] / full[band] * np.maximum(expected[index, band][pixels], 1e-300)
                    ratios[index, row, band] = np.log(np.median(view.relative[band][pixels] / of_unit))
    return PaintLight(ratios, brightness, signal, scatter)


def _is_inside(surface: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(y, x) True where the four neighbours show the same surface."""
    framed = np.pad(surface, 1, mode="edge")
    neighbours = (framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:])
    return np.all([neighbour == surface for neighbour in neighbours], axis=0)
