"""The calibration of a capture: all results in one object, and as files."""

from .calibrate import Calibration, calibrate_capture
from .geometry_plot import wireframe
from .write import calibration_record, write_calibration, write_geometry

__all__ = [
    "Calibration",
    "calibrate_capture",
    "calibration_record",
    "wireframe",
    "write_calibration",
    "write_geometry",
]
