"""When each band is photographed: effects of drift act by it."""

from dataclasses import replace

import cboxlab
import pytest
from cboxlab.validation.predict.sensing import minutes_of_bands
from helpers.places import ROOT


def test_a_band_is_dated_by_the_middle_of_its_frames():
    """Readout 1 s: three frames of 2 s from 0 s to 8 s, then, at 9 s or at a stated start, one of 4 s."""
    capture = cboxlab.load_capture(ROOT / "validate" / "data" / "demo-capture")
    m = capture.manifest

    def minutes(start_s):
        first = m.band[0].model_copy(update={"frames": ["a", "b", "c"], "exposure_s": 2.0, "start_s": None})
        second = m.band[1].model_copy(update={"frames": ["d"], "exposure_s": 4.0, "start_s": start_s})
        camera = m.camera.model_copy(update={"readout_s": 1.0})
        manifest = m.model_copy(update={"band": [first, second], "camera": camera})
        return minutes_of_bands(replace(capture, manifest=manifest))

    assert minutes(None) * 60 == pytest.approx([4, 11])
    assert minutes(100.0) * 60 == pytest.approx([4, 102])
