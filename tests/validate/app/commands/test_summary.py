"""What a validation prints in the terminal."""

import re
from pathlib import Path
from types import SimpleNamespace

from cboxlab.validation.app.commands import summary
from helpers.fakes.box import SURFACES, FakeBox, fake_weights


def test_a_surface_that_is_not_seen_has_dashes(capsys, monkeypatch):
    comparison = FakeBox(size=48).compare(seed=7, surface_names=(*SURFACES, "hidden"))
    calibration = SimpleNamespace(suspicions=(), capture=SimpleNamespace(folder=Path("a-capture")))
    result = SimpleNamespace(
        comparison=comparison,
        fit=SimpleNamespace(lamp_scale=1.0),
        seconds=1.0,
        prepared=SimpleNamespace(calibration=calibration, responses=fake_weights()[1]),
    )
    monkeypatch.setattr(summary, "failures", lambda result: (None, []))
    summary.print_validation(result)
    printed = capsys.readouterr().out
    assert "nan" not in printed and re.search(r"(?m)^ hidden( +–){7} *$", printed)
    assert re.search(r"(?m)^ floor +[+-]\d", printed)
