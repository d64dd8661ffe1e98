"""When each band is photographed: effects of drift act by it."""

from dataclasses import replace
from types import SimpleNamespace

import cboxlab
import numpy as np
import pytest
from cboxlab.validation.predict.sensing import _merged, minutes_of_bands
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


def test_each_merged_exposure_is_at_the_middle_of_its_frames():
    """Three frames of 2 s, each read out in 4 s, from 100 s on: the middle is 100 + 1 + 6 s. Darks by the exposure."""
    tables = [SimpleNamespace(exposure_s=s, start_s=t, frames=f) for s, t, f in ((8.0, 0.0, "a"), (2.0, 100.0, "abc"))]
    merged = {"f550": SimpleNamespace(tables=tables, weights=np.full((2, 2, 3), 0.5), ratios=np.array([1.0, 0.25]))}
    manifest = SimpleNamespace(camera=SimpleNamespace(readout_s=4.0))
    capture = SimpleNamespace(band_ids=("f550", "f650"), manifest=manifest, shape=(2, 3), band=lambda _: tables[0])
    calibration = SimpleNamespace(
        capture=capture,
        bands=SimpleNamespace(merged=merged),
        dark=SimpleNamespace(at=lambda seconds: np.full((2, 3), 100 + seconds)),
    )
    first, second = _merged(calibration, np.ones((2, 2, 3), bool), np.array([0.5, 0.7]))
    assert first.minutes.tolist() == [0.5, 0.7]
    assert second.minutes == pytest.approx([107.0 / 60.0, 0.7])
    assert first.ratio.tolist() == [1.0, 1.0] and second.ratio.tolist() == [0.25, 1.0]
    assert second.weight[:, 0, 0].tolist() == [0.5, 0.0]
    assert second.dark.tolist() == [102.0, 0.0]
