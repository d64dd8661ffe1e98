"""Two runs of a renderer in one folder of an export."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import pytest
from cboxlab.rendering.export import renderer_of
from cboxlab.validation.compare_renders.renderers import run_renderer, running

#: What the scripts of exports do: a part of a picture, and its name when it is whole.
SCRIPT = """
import os, time
if not os.path.exists("picture"):
    open("part", "w").write("half")
    time.sleep(0.5)
    os.replace("part", "picture")
"""


def test_the_second_run_waits_and_finds_the_picture_made(monkeypatch, tmp_path):
    """Run at once, both would rename one part: the second would find none."""
    plain = renderer_of("mitsuba")
    monkeypatch.setattr(running, "renderer_of", lambda name: replace(plain, command=("{python}", "-c", SCRIPT)))
    monkeypatch.setattr(running, "missing", lambda renderer: "")
    (tmp_path / "mitsuba").mkdir()
    with ThreadPoolExecutor(2) as both:
        runs = [both.submit(run_renderer, tmp_path, "mitsuba") for _ in range(2)]
        assert all(run.result().renderer == "mitsuba" for run in runs)
    assert [path.name for path in (tmp_path / "mitsuba").iterdir()] == ["picture"]


def test_the_processor_time_is_that_of_this_run_alone(monkeypatch, tmp_path):
    """Of user and system, 3 and 0.5 s more than all earlier programs took."""
    used = iter([SimpleNamespace(ru_utime=10.0, ru_stime=4.0), SimpleNamespace(ru_utime=13.0, ru_stime=4.5)])
    plain = renderer_of("mitsuba")
    monkeypatch.setattr(running, "renderer_of", lambda name: replace(plain, command=("{python}", "-c", "")))
    monkeypatch.setattr(running, "missing", lambda renderer: "")
    monkeypatch.setattr(running, "resource", SimpleNamespace(getrusage=lambda _: next(used), RUSAGE_CHILDREN=0))
    (tmp_path / "mitsuba").mkdir()
    assert run_renderer(tmp_path, "mitsuba").cpu_s == pytest.approx(3.5)
