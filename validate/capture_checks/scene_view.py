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

__all__ = ["SceneView", "lamp_signals", "relative_radiance", "view_scene", "without_gaps"]


@dataclass(frozen=True, eq=False)
class SceneView:
    """Rendering and photographs of a known scene by the calibrated camera, on one grid."""

    #: Scene of the capture, with one lamp.
    scene: Scene

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


def lamp_signals(
    capture: Capture, radiometry: Radiometry, channels: Mapping[str, str] | None
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
        curve = response_curve(capture, band, None if channels is None else channels[band.id])
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
    light = capture.light(lamp.radiance).at(WAVELENGTH_NM)
    of_band = {} if channels is None else channels
    curves = [response_curve(capture, band, of_band.get(band.id)) for band in capture.manifest.band]
    weights = [curve * light / np.sum(curve * light) for curve in curves if curve is not None]
    reflectances = scene.reflectances(WAVELENGTH_NM) @ np.array(weights).T
    preview = render_preview(scene, camera, np.clip(reflectances, 0.0, 1.0))  # tables of a spoilt capture exceed them
    names = [*scene.materials]
    of_surface = reflectances[[names.index(surface.material) for surface in scene.surfaces]]
    step = preview.step
    relative = relative_radiance(bands, signals, capture.cell)
    relative[_is_noise(bands)] = np.nan
    return SceneView(scene, preview, of_surface, relative[:, ::step, ::step])
