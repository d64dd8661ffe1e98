"""A simulated laboratory: surveys points of a box, photographs it, writes a capture."""

from .capture_writer import sphere_spectrum, tungsten_lamp, unit_factors, write_photographs
from .cube_capture import write_cube_capture
from .photographer import CaptureSettings, Frame, FrameHooks, band_filters

__all__ = [
    "CaptureSettings",
    "Frame",
    "FrameHooks",
    "band_filters",
    "sphere_spectrum",
    "tungsten_lamp",
    "unit_factors",
    "write_cube_capture",
    "write_photographs",
]
