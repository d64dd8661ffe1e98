"""Boards that the program finds: views, residuals and the removal of a wrong one, in a real browser."""

import base64
import tomllib
import zlib

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.geometry import calibrate_camera
from cboxlab.validation.app.studio import Workbench, build_app
from helpers.captures.board_capture import (
    FOCAL_LENGTH_PX,
    TILTS_DEG,
    board_capture,
    camera_before,
    centre,
)
from helpers.pages.axe import nameless, violations
from helpers.pages.browser import open_browser
from helpers.pages.canvas import colour_at
from helpers.pages.keyboard import reached_by_tab
from helpers.pages.page_faults import FAULTS
from helpers.pages.server import served
from starlette.testclient import TestClient


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    root = tmp_path_factory.mktemp("boards")
    (root / "capture").mkdir()
    board_capture(root / "capture")
    return Workbench(root, None)


def test_a_wrong_view_is_seen_and_removed_in_the_browser(bench):
    manifest = bench.root / "capture" / "capture.toml"
    before = tomllib.loads(manifest.read_text())
    with served(bench) as address, open_browser() as page:
        page.open(f"{address}boards.html?capture=capture")
        page.until("!document.getElementById('work').hidden && document.body.dataset.busy === 'false'")
        lines = page.run("[...document.querySelectorAll('#views li')].map((e) => e.innerText)")
        assert len(lines) == 5 and "not used: target-2.tif: its points scatter by" in lines[2]
        assert all("35 points, rms 0." in line for line in lines if "target-2" not in line)
        # the corners lie where the camera sees them
        corners = np.array(page.run("points()"))
        x, y = np.meshgrid(np.arange(7), np.arange(5))
        grid = 20.0 * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
        truth = camera_before(centre(5, 7), TILTS_DEG[0], 42.0 * 8).project(grid)
        assert min(np.abs(corners - truth).max(), np.abs(corners - truth[::-1]).max()) < 0.3
        page.run("photograph.canvas.focus()")
        page.key("ArrowRight")
        assert "Point 2 of 35" in page.run("$('saved').textContent")
        for step, number in (("ArrowLeft", 1), ("ArrowLeft", 35), ("ArrowDown", 1)):
            page.key(step)
            assert f"Point {number} of 35" in page.run("$('saved').textContent")
        # a residual is drawn from its point, a hundred times as long, towards where the camera sees it
        residuals = np.array(page.run("page.fit.views[page.chosen].residuals_px"))
        longest = int(np.argmax(np.linalg.norm(residuals, axis=1)))
        red, _, blue = colour_at(page, *(corners[longest] - 60 * residuals[longest]))
        assert blue > red + 50
        x_px, y_px, zoom = page.run(
            "(() => {photograph.canvas.scrollIntoView(); const b = photograph.canvas.getBoundingClientRect();"
            "return [b.left, b.top, photograph.zoom]})()"
        )
        page.click(x_px + (corners[17][0] + 0.5) * zoom, y_px + (corners[17][1] + 0.5) * zoom)
        assert "Point 18 of 35" in page.run("$('saved').textContent")
        # two views less: the lens is less certain at once
        sigma = page.run("page.fit.focal_length_px[1]")
        page.run("document.querySelectorAll('#views input')[0].click()")
        page.until("document.body.dataset.busy === 'false' && !page.fit.views['target-0.tif']")
        assert page.run("page.fit.focal_length_px[1]") > sigma
        page.run("document.querySelectorAll('#views input')[0].click()")
        page.until("document.body.dataset.busy === 'false' && page.fit.views['target-0.tif'] !== undefined")
        page.run("document.querySelectorAll('#views input')[2].click()")
        page.until("document.body.dataset.busy === 'false' && page.dropped.size === 1")
        assert abs(page.run("page.fit.focal_length_px[0]") - FOCAL_LENGTH_PX) < 5
        assert reached_by_tab(page) == [[], []]
        for width, scheme in ((1280, "light"), (400, "dark")):
            page.size(width)
            page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            assert page.run("document.documentElement.scrollWidth") <= width
            assert page.run(FAULTS) == [] and violations(page) == [] and nameless(page) == []
        page.run("$('accept').click()")
        page.until("$('saved').textContent.includes('Written')")
        assert page.questions == ["confirm"]
        assert page.errors == []
    before["target"][0]["frames"].remove("target-2.tif")
    assert tomllib.loads(manifest.read_text()) == before
    _, fit, _ = calibrate_camera(load_capture(manifest.parent))
    assert fit.discordant == () and len(fit.cameras) == 4


def test_a_frame_is_shown_from_its_darkest_pixel_to_white(bench):
    app = build_app(bench, "", frozenset({"127.0.0.1"}), idle_s=1e9)
    frame = tomllib.loads((bench.root / "capture" / "capture.toml").read_text())["target"][0]["frames"][0]
    with TestClient(app, base_url="http://127.0.0.1") as client:
        stored = client.post("/api/boards/frame", json={"capture": "capture", "frame": frame}).json()["photograph"]
    planes = np.frombuffer(zlib.decompress(base64.b64decode(stored["data"])), np.uint8)
    values = planes.reshape(4, -1).T.copy().view("<f4")
    assert values.min() == 0 and np.percentile(values, 99.5) == pytest.approx(1, abs=1e-3)


def test_wrong_frames_are_refused_in_a_line(bench):
    app = build_app(bench, "", frozenset({"127.0.0.1"}), idle_s=1e9)
    manifest = bench.root / "capture" / "capture.toml"
    before = manifest.read_text()
    every = tomllib.loads(before)["target"][0]["frames"]
    with TestClient(app, base_url="http://127.0.0.1") as client:
        for step, body in (
            ("fit", {"dropped": ["scene.tif"]}),
            ("fit", {"dropped": [3]}),
            ("write", {"dropped": []}),
            ("write", {"dropped": every}),
            ("frame", {"frame": "../secret"}),
            ("views", {"capture": "nowhere"}),
            ("dance", {}),
        ):
            answer = client.post(f"/api/boards/{step}", json={"capture": "capture", **body})
            assert answer.status_code == 400 and "\n" not in answer.json()["error"], (step, body)
        reason = client.post("/api/boards/fit", json={"capture": "capture", "dropped": every[1:]}).json()["reason"]
        assert "at least two" in reason
    assert manifest.read_text() == before
