"""Drawing labels in a photograph: what the server refuses, and the page in a real browser, by mouse and by keys."""

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.validation.app.studio import Workbench, build_app
from helpers.captures.glare_capture import glare_capture
from helpers.pages.browser import open_browser
from helpers.pages.canvas import colour_at, grey_at
from helpers.pages.page_faults import FAULTS
from helpers.pages.server import served
from starlette.testclient import TestClient

SQUARE = {"label": 1, "corners": [[2, 3], [20, 3], [20, 15], [2, 15]]}
NAME = {"label": 1, "name": "white", "column": ""}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    root = tmp_path_factory.mktemp("labels")
    glare_capture(root / "capture")
    return Workbench(root, None)


def test_wrong_shapes_and_names_are_refused_in_a_line(bench):
    app = build_app(bench, "", frozenset({"127.0.0.1"}), idle_s=1e9)
    square = SQUARE["corners"]
    wrong = [{"label": 256, "corners": square}, {"label": True, "corners": square}, {"label": 1, "corners": square[:2]}]
    wrong += [3, {"label": 1, "corners": [[1, "2"]] * 3}, {"label": 1, "corners": [[1, 2, 3]] * 3}, {"label": 1}]
    names = [[], [{**NAME, "name": " "}], [NAME, NAME], [{**NAME, "label": 0}], [{**NAME, "name": "a\nb"}], [4]]
    with TestClient(app, base_url="http://127.0.0.1") as client:

        def refused(step, **body):
            answer = client.post(f"/api/labels/{step}", json={"capture": "capture", **body})
            assert answer.status_code == 400 and "\n" not in answer.json()["error"], body

        for shape in wrong:
            refused("count", shapes=[shape])
        for rows in names:
            refused("write", shapes=[SQUARE], names=rows)
        refused("write", shapes=[], names=[NAME])
        refused("count", shapes={"a": 1})
        refused("picture", capture="../capture")
        refused("dance")
        refused("chart")  # a box has no chart
    assert not (bench.root / "capture" / "labels.png").exists()


def test_labels_are_drawn_and_written_in_the_browser(bench):
    capture = bench.root / "capture"
    with served(bench) as address, open_browser() as page:
        page.open(f"{address}labels.html?capture=capture")
        page.until("!document.getElementById('work').hidden && document.body.dataset.busy === 'false'")

        def label(name, column=""):
            page.run(f"$('name').value = '{name}'; $('column').value = '{column}'; $('new').requestSubmit()")

        def click(u, v):
            x, y, zoom = page.run(
                "(() => {photograph.canvas.scrollIntoView(); const b = photograph.canvas.getBoundingClientRect();"
                "return [b.left, b.top, photograph.zoom]})()"
            )
            page.click(x + (u + 0.5) * zoom, y + (v + 0.5) * zoom)

        def settle():
            page.until("document.body.dataset.busy === 'false'")

        label("paper", "white_paper")
        click(2.5, 3.5)
        click(21.5, 15.5)  # pixels 3 to 21 and 4 to 15
        settle()
        assert "19" not in page.run("$('progress').textContent")
        assert "228 px, 44 px without a rim" in page.run("$('labels').innerText").replace("\xa0", " ")
        # the rectangle is seen where it is, and the photograph is brighter when that is asked for
        assert [grey_at(page, u, 10) for u in (1, 4, 20, 23)] == [True, False, False, True]
        assert [grey_at(page, 12, v) for v in (2, 5, 14, 17)] == [True, False, False, True]
        before = colour_at(page, 28, 28)
        page.run("photograph.gain.value = 1; photograph.gain.dispatchEvent(new Event('input'))")
        brighter = colour_at(page, 28, 28)
        assert brighter[0] > 1.2 * before[0] and grey_at(page, 28, 28)
        page.run("photograph.gain.value = 0; photograph.gain.dispatchEvent(new Event('input'))")
        # by keys: a triangle of another label, its corners 8 px apart from the middle of the picture, 15.5 px
        label("wall")
        page.run("document.querySelector('input[value=polygon]').click(); photograph.canvas.focus()")
        for keys in (("ArrowDown",), ("ArrowRight",), ("ArrowDown",)):
            for key in keys:
                page.key(key, shift=True)
            page.key("Enter")
        page.key("c")
        settle()
        assert page.run("page.shapes.map((s) => [s.label, s.corners.length])") == [[1, 4], [2, 3]]
        assert page.run("page.shapes[1].corners") == [[15.5, 23.5], [23.5, 23.5], [23.5, 31.49]]
        for button, count in (("undo", 1), ("undo", 0), ("redo", 1), ("redo", 2)):
            page.run(f"$('{button}').click()")
            settle()
            assert page.run("page.shapes.length") == count
        # a highlight is cut out
        page.run("document.querySelector('input[name=label][value=\"0\"]').click()")
        page.run("document.querySelector('input[value=rectangle]').click()")
        click(9.5, 6.5)
        click(11.5, 8.5)
        settle()
        page.run("$('write').click()")
        page.until("$('saved').textContent.includes('Added to capture.toml')")
        expected = np.zeros((32, 32), int)
        expected[4:16, 3:22] = 1
        expected[7:9, 10:12] = 0
        loaded = load_capture(capture)
        image = loaded.labels()
        assert np.array_equal(np.where(image == 2, 0, image), expected)
        assert (image == 2).sum() == 28 and image[24, 17] == 2 and image[31, 16] == 0
        assert [(row.label, row.name, row.column) for row in loaded.label_names()] == [
            (1, "paper", "white_paper"),
            (2, "wall", None),
        ]
        # files are replaced only after a question; labels of the capture are the ground of a second drawing
        page.open(f"{address}labels.html?capture=capture")
        page.until("page.names.length === 2 && document.body.dataset.busy === 'false'")
        assert [grey_at(page, u, 10) for u in (2, 3, 21, 22)] == [True, False, False, True]
        assert [grey_at(page, 5, v) for v in (3, 4, 15, 16)] == [True, False, False, True]
        page.run("$('exclude').click()")
        click(25.5, 1.5)
        click(29.5, 5.5)
        settle()
        assert "255 excluded: 16 px that no comparison" in page.run("$('labels').innerText").replace("\xa0", " ")
        page.run("$('write').click()")
        page.until("$('saved').textContent.includes('Written')")
        assert page.questions[-1] == "confirm"
        again = load_capture(capture)
        assert np.array_equal(np.where(again.labels() == 255, 0, again.labels()), image)
        assert np.argwhere(again.excluded_pixels()).tolist() == [[v, u] for v in range(2, 6) for u in range(26, 30)]
        assert page.errors == []
        for width in (1280, 400):
            page.size(width)
            assert page.run("document.documentElement.scrollWidth") <= width
            assert page.run(FAULTS) == []
