"""The known scene of a capture through its calibrated camera, with the signals of the bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.radiometry import Radiometry, optical_factor, response_curve
from cboxlab.rendering.device import variant
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import NDArray

from .scene_preview import ScenePreview, render_preview

__all__ = ["SceneView", "lamp_signals", "relative_radiance", "view_scene"]


@dataclass(frozen=True, eq=False)
class SceneView:
    """Rendering and photographs of a known scene by the calibrated camera, on one grid."""

    #: Scene of the capture, with one lamp.
    scene: Scene

    #: Rendering of the scene, in the bands.
    preview: ScenePreview

    #: (surface, band) mean of the reflectance weighted with the band's response to the lamp, 0 to 1.
    reflectance: NDArray[np.float64]

    #: (band, y, x) measured radiance over the lamp's, on the grid of ``preview``; NaN for masked pixels.
    relative: NDArray[np.float64]


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


def relative_radiance(bands: CorrectedBands, signals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Measured radiance over that of the lamp.

    Parameters
    ----------
    bands
        Corrected signals.
    signals
        (band,) signals of the lamp's radiance, DN.

    Returns
    -------
    NDArray
        (band, y, x), NaN for masked pixels.
    """
    masked = bands.images["mask"].values != 0
    return np.where(masked, np.nan, bands.images["signal"].values) / signals[:, None, None]


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
        None if scene, camera, lamp or a table of the sensor equation is missing, and for a sensor with a mosaic. None
        also for several lamps, because the capture states the spectrum of one, and without a compiled variant.
    """
    scene = capture.scene
    signals = lamp_signals(capture, radiometry, channels)
    lamp = capture.manifest.lamp
    if scene is None or camera is None or signals is None or lamp is None:
        return None
    if scene.further_lamps or channels is not None or not variant.compiled():
        return None
    light = capture.light(lamp.radiance).at(WAVELENGTH_NM)
    curves = [response_curve(capture, band) for band in capture.manifest.band]
    weights = [curve * light / np.sum(curve * light) for curve in curves if curve is not None]
    reflectances = scene.reflectances(WAVELENGTH_NM) @ np.array(weights).T
    preview = render_preview(scene, camera, np.clip(reflectances, 0.0, 1.0))  # tables of a spoilt capture exceed them
    names = [*scene.materials]
    of_surface = reflectances[[names.index(surface.material) for surface in scene.surfaces]]
    step = preview.step
    return SceneView(scene, preview, of_surface, relative_radiance(bands, signals)[:, ::step, ::step])
