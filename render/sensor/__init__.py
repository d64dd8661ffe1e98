"""The sensor simulation: cameras as data, optics, charge, electrons, noise, counts, colour."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .cameras import PACKAGED, load_camera
    from .colour_correction import chart_reflectances, demosaic, linear_counts
    from .detector import Detector, SensorCamera, noisy_counts, quantise
    from .light import frame_shape, integration_weights
    from .simulation import auto_exposure, simulate_frame

__all__ = [
    "PACKAGED",
    "Detector",
    "SensorCamera",
    "auto_exposure",
    "chart_reflectances",
    "demosaic",
    "frame_shape",
    "integration_weights",
    "linear_counts",
    "load_camera",
    "noisy_counts",
    "quantise",
    "simulate_frame",
]

__getattr__, __dir__ = lazy_names(__name__)
