"""Sound captures raise no suspicion, whatever they lack."""

import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.result import calibrate
from helpers.fake_capture import FakeCapture
from helpers.places import ROOT


@pytest.mark.parametrize("lacking", [{}, {"flats": False}, {"darks": False}, {"references": False}], ids=str)
def test_a_small_sound_capture_raises_none(tmp_path, lacking):
    """False-alarm rate of all checks together below 1 in 1000 captures; seed 3."""
    folder = FakeCapture(tmp_path / "capture", seed=3).write(**lacking)
    assert calibrate(load_capture(folder)).suspicions == ()


def test_the_bundled_capture_raises_none():
    folder = ROOT / "validate" / "data" / "demo-capture"
    assert calibrate(load_capture(folder)).suspicions == ()
