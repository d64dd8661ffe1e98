"""The calibration of a capture: all results in one object, and as files."""

from .calibrate import Calibration, calibrate
from .edge_alignment import refine_geometry
from .write import calibration_record, write_calibration, write_geometry

__all__ = [
    "Calibration",
    "calibrate",
    "calibration_record",
    "refine_geometry",
    "write_calibration",
    "write_geometry",
]
