"""Marking corners in a photograph: what the server answers, and the page in a real browser."""

import shutil

import numpy as np
import pytest
from cboxlab.calibration.geometry import read_points
from cboxlab.rendering.model import Model
from cboxlab.validation.app.studio import Workbench, build_app
from cboxlab.validation.compare import scene_corners
from cboxlab.validation.synthetic import perturbed_camera
from helpers.captures.glare_capture import glare_capture
from helpers.pages.browser import open_browser
from helpers.pages.canvas import colour_at, grey_at
from helpers.pages.page_faults import FAULTS
from helpers.pages.server import served
from starlette.testclient import TestClient

CORNERS = {corner.id: corner for corner in scene_corners(Model().scene)}
#: The camera of the capture.
CAMERA = perturbed_camera(32, 3)
#: Corners in view, at several depths.
IDS = ("c02", "c03", "c06", "c08", "c10", "c12", "c18", "c22", "c24")
#: Longest side of the scene, which fills the plan.
SPAN_MM = np.ptp([corner.position_mm for corner in CORNERS.values()], axis=0).max()
POSITIONS = {name: CAMERA.project(CORNERS[name].position_mm[None])[0] for name in CORNERS}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with a capture whose corners nobody has marked yet."""
    root = tmp_path_factory.mktemp("points")
    capture = glare_capture(root / "capture")
    manifest = (capture / "capture.toml").read_text()
    begin, geometry, rest = manifest.partition("[geometry]")
    assert geometry
    (capture / "capture.toml").write_text(begin + (rest[rest.index("\n[") :] if "\n[" in rest else ""))
    (capture / "points.csv").unlink()
    return Workbench(root, None)


def test_wrong_marks_are_refused_in_a_line(bench):
    app = build_app(bench, "", frozenset({"127.0.0.1"}), idle_s=1e9)
    wrong = [[{"id": "c99", "u": 1, "v": 1}], [{"id": "c02", "u": "1", "v": 1}], [{"id": "c02", "u": 900, "v": 1}]]
    wrong += [[], [3], [{"id": "c02", "u": 1, "v": 1}] * 2, {"a": 1}, [{"id": "c02", "u": True, "v": 2}]]
    # pixels' centres are whole numbers: the picture of 32 px ends at -0.5 and 31.5
    wrong += [[{"id": "c02", "u": u, "v": v}] for u, v in ((-0.6, 1), (1, -0.6), (31.6, 1), (1, 31.6))]
    with TestClient(app, base_url="http://127.0.0.1") as client:
        for marks in wrong:
            answer = client.post("/api/points/locate", json={"capture": "capture", "points": marks})
            assert answer.status_code == 400 and "\n" not in answer.json()["error"], marks
        for u, v in ((-0.4, 31.4), (31.4, -0.4)):
            marks = [{"id": "c02", "u": u, "v": v}]
            assert client.post("/api/points/locate", json={"capture": "capture", "points": marks}).status_code == 200
        for name in ("../capture", "/etc", "nowhere", ""):
            answer = client.post("/api/points/picture", json={"capture": name})
            assert answer.status_code == 400
        assert client.post("/api/points/dance", json={"capture": "capture"}).status_code == 400
    assert not (bench.root / "capture" / "points.csv").exists()


def test_corners_are_clicked_and_written_in_the_browser(bench):
    with served(bench) as address, open_browser() as page:
        page.open(f"{address}points.html?capture=capture")
        page.until("!document.getElementById('work').hidden")
        assert page.run("document.querySelectorAll('#corners input').length") == len(CORNERS)
        for name in IDS:
            page.run(f"document.querySelector('input[value={name}]').click()")
            box = page.run(
                "(() => {const c = document.getElementById('photograph'); c.scrollIntoView();"
                "const b = c.getBoundingClientRect(); return [b.left, b.top, photograph.zoom]})()"
            )
            u, v = POSITIONS[name]
            page.click(box[0] + (u + 0.5) * box[2], box[1] + (v + 0.5) * box[2])
            page.until(f"page.marks.has('{name}') && document.body.dataset.busy === 'false'")
        page.until("document.getElementById('fit').textContent.includes('rms')")
        # the camera of the clicks sees a corner that nobody marked where it is
        np.testing.assert_allclose(page.run("page.expected.c16"), POSITIONS["c16"], atol=0.5)
        assert "residual" in page.run("document.querySelector('input[value=c02]').parentElement.innerText")
        assert page.run("[0.004, -0.004, -0.126, 0.3].map(signed)") == ["0.00", "0.00", "−0.13", "+0.30"]
        # marks are crosses at their place, and the plan shows the corner from the front and from above
        u, v = POSITIONS["c03"]
        assert not grey_at(page, u, v) and colour_at(page, u, v)[0] > colour_at(page, u, v)[2]
        circles = {}
        for name in ("c02", "c24"):
            page.run(f"document.querySelector('input[value={name}]').click()")
            circles[name] = page.run(
                "[...document.querySelectorAll('#plan circle')].map((c) => [c.cx.baseVal.value, c.cy.baseVal.value])"
            )
        (front, above), (other_front, other_above) = circles["c02"], circles["c24"]
        x, y, z = CORNERS["c24"].position_mm - CORNERS["c02"].position_mm
        np.testing.assert_allclose(np.subtract(other_front, front), np.array([-x, -y]) * 130 / SPAN_MM, atol=0.01)
        np.testing.assert_allclose(np.subtract(other_above, above), np.array([-x, -z]) * 130 / SPAN_MM, atol=0.01)
        sides = page.run("[...document.querySelectorAll('#plan polygon')].map((p) => p.points.length)")
        assert max(sides) == 4 and min(sides) >= 2
        sizes = page.run("[...document.querySelectorAll('#corners input')].map((i) => i.offsetWidth)")
        assert len(set(sizes)) == 1  # also next to text of two lines
        page.run("document.getElementById('photograph').focus()")
        before = page.run("page.marks.get('c24').u")
        page.key("ArrowRight")
        page.until(f"Math.abs(page.marks.get('c24').u - {before} - 0.5) < 1e-6")
        page.key("ArrowLeft")
        page.run("document.getElementById('write').click()")
        page.until("document.getElementById('saved').textContent.includes('points.csv')")
        points = read_points(bench.root / "capture" / "points.csv")
        assert points.ids == IDS
        # a click is a whole pixel of the screen, 20 of them a pixel of the photograph
        np.testing.assert_allclose(points.image_px, [POSITIONS[name] for name in IDS], atol=0.06)
        np.testing.assert_allclose(points.points_mm, [CORNERS[name].position_mm for name in IDS], atol=0.01)
        assert page.errors == []
        page.run("document.getElementById('write').click()")  # a second time nothing is replaced
        page.until("document.getElementById('mistake').textContent.includes('exists already')")
        for width in (1280, 400):
            page.size(width)
            assert page.run("document.documentElement.scrollWidth") <= width
            assert page.run(FAULTS) == []
    shutil.rmtree(bench.root)
