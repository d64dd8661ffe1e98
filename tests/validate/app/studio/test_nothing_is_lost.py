"""Two tabs, back and forward, reload at each stage of a computation, and a server that is killed."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request

import pytest
from helpers.captures.large_patches import PATCHES
from helpers.pages.studio import add, press

#: A server on a capture, as `cbox studio` starts it, at a port that stays the same.
SERVER = """
import sys
from pathlib import Path
from cboxlab.rendering.radiosity import patched_scene
from cboxlab.validation.app.studio import Workbench, serve
patched_scene.PATCHES_PER_DIAGONAL = int(sys.argv[4])  # as of `bench`, whose pictures are in the cache
root, capture, port = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
bench = Workbench(root, root / ".cache", noise=3.0, seed=1)
begin = (lambda progress: bench.open(capture, None, progress)) if capture else None
serve(bench, begin, print, port=port, token=False)
"""
READY = "page.viewer !== null && page.record?.open && !page.job && !page.loading"


def remove_button(effect):
    return f"document.querySelector('[data-effect={effect}] .row button:last-child').click()"


def test_a_tab_that_is_behind_removes_nothing_and_follows(page, bench):
    """The other tab has heard nothing of the removed effect, and asks to remove the second one of its list."""
    for effect in ("veiling-glare", "ghost", "lamp-drift"):
        add(page, effect)
    other = page.tab()
    other.open(page.run("location.href"))
    other.until(f"{READY} && page.controls.length === 3")
    other.run("events.onmessage = null")
    page.run(remove_button("veiling-glare"))
    page.until("page.controls.length === 2")
    other.run(remove_button("ghost"))
    other.until("document.getElementById('mistake').textContent.includes('earlier state')")
    other.until("page.controls.length === 2 && page.record.effects[0].id === 'ghost'")
    assert [effect.id for effect in bench.study.effects] == ["ghost", "lamp-drift"]
    other.run(remove_button("ghost"))  # now it shows the present state
    page.until("page.controls.length === 1 && page.record.effects[0].id === 'lamp-drift' && !page.loading")
    assert [effect.id for effect in bench.study.effects] == ["lamp-drift"]
    press(page, "undo")
    page.until("page.controls.length === 2")
    assert page.errors == [] and [error for error in other.errors if "409" not in error] == []
    other.call("Page.close")


def test_every_stage_survives_reload_back_and_forward(page, bench, monkeypatch):
    stages, go = ("rendering", "trying every effect", "choosing among effects"), threading.Semaphore(0)

    def staged(progress):
        for number, stage in enumerate(stages):
            progress.stage(stage)
            progress.part(number / len(stages))
            assert go.acquire(timeout=60)

    add(page, "veiling-glare")
    chi2 = page.run("document.getElementById('chi2').textContent")
    monkeypatch.setattr(bench, "diagnose", staged)
    press(page, "diagnose")
    at_work = "page.viewer !== null && page.controls.length === 1 && page.job !== null"
    for stage in stages:
        page.until(f"document.getElementById('stage').textContent.includes('{stage}')")
        page.reload()
        page.until(f"{at_work} && document.getElementById('stage').textContent.includes('{stage}')")
        assert page.run("document.getElementById('chi2').textContent") == chi2
        assert page.run("document.getElementById('add').disabled && !document.getElementById('cancel').disabled")
        page.open(page.run("location.href.split('#')[0]") + "points.html")
        page.run("setTimeout(() => history.back())")
        page.until(f"typeof events === 'object' && {at_work}")
        page.run("setTimeout(() => history.forward())")
        page.until("document.title === 'Corners in the photograph' && document.readyState === 'complete'")
        page.run("setTimeout(() => history.back())")
        page.until(f"typeof events === 'object' && {at_work}")
        assert page.run("document.getElementById('chi2').textContent") == chi2
        go.release()
    page.until("page.job === null && !document.getElementById('add').disabled")


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return listening.getsockname()[1]


def answer_of(port, path, body=None):
    """Answer of the server in JSON, once it listens; None for bytes."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"http://127.0.0.1:{port}/api/{path}", data, {"Content-Type": "application/json"})
    end = time.monotonic() + 60
    while True:
        try:
            content = urllib.request.urlopen(request, timeout=60).read()
            return json.loads(content) if content[:1] in b"{[" else None
        except (ConnectionError, urllib.error.URLError) as error:
            if isinstance(error, urllib.error.HTTPError) or time.monotonic() > end:
                raise
            time.sleep(0.1)


def test_a_killed_server_loses_no_work(browser, bench, tmp_path):
    """The page says so, finds the program that is started again, and goes on where it was.

    That program removes the temporary folder of the killed one, and its own when it is asked to end.
    """
    root, port = bench.root, free_port()
    shutil.rmtree(root / ".cbox-unsaved", ignore_errors=True)
    command = [sys.executable, "-c", SERVER, str(root)]
    where = str(port), str(PATCHES)
    settings = {**os.environ, "TMPDIR": str(tmp_path), "BROWSER": "true"}
    process = subprocess.Popen([*command, "capture", *where], stdout=subprocess.DEVNULL, env=settings)
    try:
        while not (state := answer_of(port, "state"))["open"] or state["job"]:
            time.sleep(0.1)
        browser.open(f"http://127.0.0.1:{port}/")
        browser.until(READY)
        add(browser, "veiling-glare")
        browser.run("move({which: 0, values: {fraction: 0.01}, commit: true})")
        browser.until("page.record.effects[0].values.fraction === 0.01 && !page.asking")
        press(browser, "fit-all")  # killed while it computes
        browser.until("page.job !== null")
        os.kill(process.pid, signal.SIGKILL)
        process.wait(20)
        browser.until("document.getElementById('mistake').textContent.includes('Start `cbox studio` again')")
        (folder_of_killed,) = tmp_path.iterdir()
        process = subprocess.Popen([*command, "", *where], stdout=subprocess.DEVNULL, env=settings)
        browser.until("!document.getElementById('unsaved').hidden && !page.record.open")
        assert "capture, " in browser.run("document.getElementById('unsaved-list').innerText")
        browser.run("document.querySelector('#unsaved-list button').click()")
        browser.until(f"{READY} && page.controls.length === 1 && page.record.can_undo && !page.record.saved")
        assert browser.run("page.record.effects[0].values.fraction") == pytest.approx(0.01)
        assert not folder_of_killed.exists() and [*tmp_path.iterdir()]
        process.terminate()
        assert process.wait(20) == 128 + signal.SIGTERM
        assert not [*tmp_path.iterdir()]
    finally:
        process.kill()
        process.wait(20)
        browser.open("about:blank?")
        browser.errors.clear()  # the browser reports the connection
        shutil.rmtree(root / ".cbox-unsaved", ignore_errors=True)
