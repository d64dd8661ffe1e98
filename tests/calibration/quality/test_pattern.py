"""A mosaic that begins at another pixel than the manifest says."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture import channel_mask
from cboxlab.calibration.quality.frame_checks import fields
from cboxlab.calibration.quality.frame_checks.stacks import Stack

LEVEL = {"R": 300.0, "G": 1000.0, "B": 650.0}
X_TRANS = "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG"


def suspicions(monkeypatch, sensor, manifest, *, units=None, greens=0.0):
    """Suspicions of a flat field of ``sensor``; greens : relative difference of the greens of even and odd rows."""
    draw, shape = np.random.default_rng(4), (48, 48)
    light = sum(LEVEL[letter] * channel_mask(sensor, shape, letter) for letter in LEVEL)
    uneven = 1 - 0.3 * np.hypot(*np.mgrid[-1:1:48j, -1:1:48j]) ** 2
    rows = 1 + greens / 2 * np.where(np.arange(48) % 2, 1, -1)[:, None] * channel_mask(sensor, shape, "G")
    frames = (100 + draw.poisson(light * uneven * rows, (2, *shape))).astype(np.uint16)
    kind = "flat" if units is None else "reference"
    stack = Stack(kind, "flat[0] (r)", "r", 1.0, None, ("flat.tif",), frames, None, "R")
    table = SimpleNamespace(mosaic=SimpleNamespace(pattern=manifest), reference=[] if units is None else [stack])
    monkeypatch.setattr(fields, "_expected", lambda *_: units)
    dark = SimpleNamespace(at=lambda exposure_s: np.full(shape, 100.0))
    return [*fields.check_pattern(SimpleNamespace(manifest=table), [stack], dark, {"r": "R"})]


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", X_TRANS])
def test_the_stated_pattern_is_right(monkeypatch, pattern):
    """Unlike greens and rough tables of the sensitivities are no wrong pattern."""
    assert not suspicions(monkeypatch, pattern, pattern)
    assert not suspicions(monkeypatch, pattern, pattern, greens=0.04)
    rough = {letter: level * (1 + 0.05 * i) for i, (letter, level) in enumerate(LEVEL.items())}
    assert not suspicions(monkeypatch, pattern, pattern, units=rough)


def test_a_shifted_pattern_is_named(monkeypatch):
    """Sensitivities say which of two patterns with equal greens is right, and find red and blue exchanged."""
    (either,) = suspicions(monkeypatch, "RGGB", "GRBG")
    assert either.where == "mosaic.pattern"
    assert '"RGGB" or "BGGR"' in either.what or '"BGGR" or "RGGB"' in either.what
    for manifest in ("GRBG", "GBRG", "BGGR"):
        (suspicion,) = suspicions(monkeypatch, "RGGB", manifest, units=LEVEL)
        assert 'the pattern is "RGGB"' in suspicion.what
        assert ("sensitivities of B and R are exchanged" in suspicion.what) is (manifest == "BGGR")
    assert not suspicions(monkeypatch, "RGGB", "BGGR")
    shifted = " ".join(row[1:] + row[0] for row in X_TRANS.split())
    (suspicion,) = suspicions(monkeypatch, X_TRANS, shifted, units=LEVEL)
    assert f'"{X_TRANS}"' in suspicion.what


def test_levels_that_fit_no_pattern_say_nothing(monkeypatch):
    assert not suspicions(monkeypatch, "RGGB", "RGGB", units={"R": 1000.0, "G": 300.0, "B": 100.0})
