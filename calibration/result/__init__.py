"""The calibration of a capture: all results in one object, and as files."""

from .calibrate import Calibration, calibrate
from .geometry_plot import wireframe
from .write import calibration_record, write_calibration, write_geometry

__all__ = [
    "Calibration",
    "calibrate",
    "calibration_record",
    "wireframe",
    "write_calibration",
    "write_geometry",
]
