"""Calibrations without the parts that take long."""

from importlib import import_module
from types import SimpleNamespace

import pytest
from cboxlab.calibration.capture import load_capture

__all__ = ["quick_calibration"]


def quick_calibration(folder):
    """``calibrate_capture`` without colour, linearity, sensor study and patches; its suspicions are complete."""
    module = import_module("cboxlab.calibration.result.calibrate")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "study_colour", lambda *_: SimpleNamespace(reason=""))
        patch.setattr(module, "measure_linearity", lambda *_: None)
        patch.setattr(module, "study_sensor", lambda *_: SimpleNamespace(verdicts=()))
        patch.setattr(module, "measure_patches", lambda *_: None)
        return module.calibrate_capture(load_capture(folder))
