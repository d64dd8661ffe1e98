"""Mistakes made in a small sound capture are named.

benchmarks/mistakes/spoilt_captures.py counts them over many captures.
"""

import re

import frame_mistakes  # noqa: F401  (fills the list)
import further_mistakes  # noqa: F401
import manifest_mistakes  # noqa: F401
import numpy as np
import pytest
from capture_mistakes import MISTAKES, Draft
from cboxlab.rendering.device.variant import compiled
from cboxlab.validation.capture_checks import with_scene_checks
from helpers.captures.calibrations import quick_calibration
from helpers.places import ROOT

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")


#: Mistakes made at once, in which nothing of one hides another.
CHOSEN = (
    ("all exposures in milliseconds", "photographs read from a region 4 px next to the flats'"),
    ("sphere a thousand times too bright", "two bands' frames exchanged"),
    ("a dark repeat of another exposure", "points in inches"),
    ("all frames mirrored left to right", "rows with another noise"),
    ("the photographs mirrored, not the flats",),
    ("lamp table in micrometres", "photographs already divided by the flat"),
    ("exposure of one band twice too long", "sphere in quanta, not energy"),
    ("points with v upwards", "photographs binned by two and enlarged again"),
    ("a repeat shows another band", "points in m"),
    ("lamp in quanta, not energy", "photographs cropped and enlarged by a tenth"),
)


@pytest.mark.parametrize("names", CHOSEN, ids=lambda names: names[-1])
def test_mistakes_in_the_bundled_capture_are_named(tmp_path, names):
    """The mistakes are deterministic (seed 5); the sound capture raises none (test_sound)."""
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    mistakes = [next(m for m in MISTAKES if m.name == name) for name in names]
    for mistake in mistakes:
        mistake.make(draft, np.random.default_rng(5))
    draft.save()
    suspicions = with_scene_checks(quick_calibration(draft.folder)).suspicions
    for mistake in mistakes:
        assert any(re.search(mistake.expected, str(suspicion)) for suspicion in suspicions), (mistake.name, suspicions)
