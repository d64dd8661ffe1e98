"""A simulated laboratory: surveys points of a box, photographs it, writes a capture."""

from .capture_writer import sphere_spectrum, tungsten_lamp, unit_factors, write_photographs
from .cube_capture import write_cube_capture
from .mosaic_sensor import MosaicSensor, SimulatedBand, interleaved, mosaic_sensor
from .photographer import CaptureSettings, Frame, FrameHooks, band_filters, behind_mosaic

__all__ = [
    "CaptureSettings",
    "Frame",
    "FrameHooks",
    "MosaicSensor",
    "SimulatedBand",
    "band_filters",
    "behind_mosaic",
    "interleaved",
    "mosaic_sensor",
    "sphere_spectrum",
    "tungsten_lamp",
    "unit_factors",
    "write_cube_capture",
    "write_photographs",
]
