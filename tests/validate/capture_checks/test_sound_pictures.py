"""Sound captures raise no suspicion, whatever they lack."""

import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.result import calibrate_capture
from cboxlab.rendering.device import variant
from cboxlab.validation.capture_checks import find as checks
from cboxlab.validation.capture_checks import find_scene_suspicions, with_scene_checks
from helpers.captures.calibrations import quick_calibration
from helpers.fakes.capture import FakeCapture
from helpers.places import ROOT

DEMO = ROOT / "validate" / "data" / "demo-capture"


@pytest.mark.parametrize("lacking", [{}, {"flats": False}, {"darks": False}, {"references": False}], ids=str)
def test_a_small_sound_capture_raises_none(tmp_path, lacking):
    """False-alarm rate of all checks together below 1 in 1000 captures; seed 3."""
    folder = FakeCapture(tmp_path / "capture", seed=3).write(**lacking)
    assert with_scene_checks(calibrate_capture(load_capture(folder))).suspicions == ()


@pytest.mark.parametrize("compiled", [variant.compiled(), False])
def test_the_bundled_capture_raises_none(compiled, monkeypatch):
    """Also without a compiled variant: a note says that the scene was not rendered."""
    if not compiled:
        monkeypatch.setattr(variant, "compiled", lambda: False)
    calibration = with_scene_checks(quick_calibration(DEMO))
    assert calibration.suspicions == ()
    assert any("rendering of the scene" in note for note in calibration.notes) != compiled


def test_suspicions_of_the_scene_follow_those_of_the_calibration_and_none_twice(monkeypatch):
    calibration = quick_calibration(DEMO)
    first, second = ({"what": name, "where": "", "why": ""} for name in ("first", "second"))
    first, second = checks.Suspicion(**first), checks.Suspicion(**second)
    monkeypatch.setattr(checks, "find_scene_suspicions", lambda _: (first, second))
    object.__setattr__(calibration, "suspicions", (first,))
    assert with_scene_checks(calibration).suspicions == (first, second)


def test_without_a_scene_only_the_bands_are_compared(monkeypatch):
    calibration = quick_calibration(DEMO)
    monkeypatch.setitem(vars(calibration.capture), "scene", None)
    monkeypatch.setattr(checks, "check_lamp", lambda *arguments: [arguments[-1]])
    assert find_scene_suspicions(calibration) == (None,)
