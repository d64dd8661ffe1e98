"""Mistakes made in a small sound capture are named; benchmarks/spoilt_captures.py counts them over many captures."""

import re
import shutil
import sys

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import correct_bands, measure_noise, read_darks
from cboxlab.calibration.geometry import calibrate_camera
from cboxlab.calibration.radiometry import measure_constant
from cboxlab.calibration.suspicions import explain_points, find_suspicions
from cboxlab.scenes.errors import InputError
from helpers.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

import frame_mistakes  # noqa: F401  (fills the list)
import manifest_mistakes  # noqa: F401
from capture_mistakes import MISTAKES, Draft


def suspicions(folder):
    """Those of ``calibrate``, without its costly parts."""
    capture = load_capture(folder)
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    bands = correct_bands(capture, dark, noise)
    fit, explained = None, ()
    try:
        fit = calibrate_camera(capture)[0]
    except InputError as fault:
        explained = (explain_points(capture, fault),)
    constant = measure_constant(capture, bands, dark, noise)
    return find_suspicions(capture, bands, dark, noise, constant, fit, already=explained)


CHOSEN = (
    "all exposures in milliseconds",
    "sphere a thousand times too bright",
    "two bands' frames exchanged",
    "a repeat shows another band",
    "all frames mirrored left to right",
    "the photographs mirrored, not the flats",
    "lamp table in micrometres",
    "a dark repeat of another exposure",
    "points with v upwards",
)


@pytest.mark.parametrize("name", CHOSEN)
def test_a_mistake_in_the_bundled_capture_is_named(tmp_path, name):
    """The mistakes are deterministic (seed 5); the sound capture raises none (test_sound)."""
    mistake = next(m for m in MISTAKES if m.name == name)
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    mistake.make(draft, np.random.default_rng(5))
    draft.save()
    found = suspicions(draft.folder)
    assert any(re.search(mistake.expected, str(suspicion)) for suspicion in found), found


def test_a_suspicion_says_what_where_and_why(tmp_path):
    shutil.copytree(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    table = tmp_path / "capture" / "spectra" / "lamp.csv"
    header, *rows = table.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    table.write_text("\n".join([header, *(f"{float(nm) / 1000},{y}" for nm, y in cells)]) + "\n")
    (found,) = [s for s in suspicions(tmp_path / "capture") if "micromet" in s.record["what"]]
    assert found.where == "spectra/lamp.csv:radiance"
    assert "0.4 to 0.7" in found.why
    assert set(found.record) == {"what", "where", "why"}
