"""The camera of a capture: the bundled one states a lens and a pixel pitch, and surveyed points."""

import cboxlab
import pytest
from cboxlab.calibration.geometry.camera_calibration import calibrate_camera
from helpers.places import ROOT


def test_the_nominal_focal_length_is_millimetres_over_the_pitch():
    """In pixels; the survey finds it within 2 %, as lenses are made."""
    capture = cboxlab.load_capture(ROOT / "validate" / "data" / "demo-capture")
    fit, targets, _ = calibrate_camera(capture)
    manifest = capture.manifest
    expected = 1000.0 * manifest.lens.focal_length_mm / manifest.camera.pixel_pitch_um
    assert targets is None
    assert fit.nominal_focal_length_px == pytest.approx(expected, rel=1e-12)
    assert fit.camera.focal_length_px == pytest.approx(expected, rel=0.02)
