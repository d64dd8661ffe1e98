"""The pages by keyboard alone, for a screen reader, and by the rules of axe."""

import json
import shutil

import pytest
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.app.studio import Workbench
from helpers.pages.axe import nameless, violations
from helpers.pages.browser import open_browser
from helpers.pages.keyboard import reached_by_tab
from helpers.pages.server import served
from helpers.pages.studio import add


def looks(page):
    """Faults that axe finds on a screen in light and on a telephone in the dark."""
    faults = []
    for width, scheme in ((1280, "light"), (400, "dark")):
        page.size(width)
        page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        faults += [f"{width} {scheme} {fault}" for fault in violations(page)]
    page.size(1280)
    return faults


def test_the_workbench_is_reached_by_keys_and_read_aloud(page):
    add(page, "block-pose")
    page.run("document.getElementById('parts').open = true; page.viewer.select(16, 20)")
    assert reached_by_tab(page) == [[], []]
    assert nameless(page) == []
    assert looks(page) == []


def test_a_capture_is_opened_and_an_effect_found_moved_saved_and_removed_by_keys(page, bench, monkeypatch):
    """Letters, Tab and Enter alone, as somebody without a mouse."""

    def go_to(condition):
        for _ in range(60):
            if page.run(f"(() => {{const e = document.activeElement; return Boolean({condition})}})()"):
                return
            page.key("Tab")
        raise AssertionError(f"never reached: {condition}")

    page.run("document.activeElement.blur()")
    captures = []
    monkeypatch.setattr(bench, "open", lambda capture, model, progress: captures.append((capture, model)))
    go_to("e.id === 'show-open'")
    page.key("Enter")
    page.until("!document.getElementById('found').hidden")
    go_to("e.getAttribute('aria-label') === 'Open capture'")
    page.key("Enter")
    page.until("document.getElementById('open').hidden && !page.job && page.loading === 0 && page.requests === 0")
    assert captures == [("capture", None)]
    page.run("document.activeElement.blur()")
    go_to("e.id === 'search'")
    for letter in "veiling":
        page.key(letter)
    page.until("document.getElementById('new-effect').value === 'veiling-glare'")
    go_to("e.id === 'add'")
    page.key("Enter")
    page.until("page.controls.length === 1 && page.requests === 0")
    page.run("document.activeElement.blur(); window.scrollTo(0, 0)")
    go_to("e.type === 'range' && e.id === 'p-0-fraction'")
    page.key("ArrowRight")
    page.until("page.record.effects[0].values.fraction > 0 && !page.asking")
    page.run("document.activeElement.blur(); window.scrollTo(0, 0)")
    go_to("e.id === 'show-save'")
    page.key("Enter")
    go_to("e.id === 'save-folder'")
    page.call("Input.insertText", text="by-keys")
    page.key("Enter")
    page.until("document.getElementById('saved').textContent.includes('study.json')")
    saved = json.loads((bench.root / "by-keys" / "study.json").read_text())
    shutil.rmtree(bench.root / "by-keys")
    assert "veiling-glare" in json.dumps(saved)
    go_to("e.getAttribute('aria-label') === 'Remove veiling-glare'")
    page.key("Enter")
    page.until("page.controls.length === 0")
    assert bench.study.effects == ()


@pytest.mark.parametrize(
    "name", ["", "first.html?folder=frames", "points.html?capture=capture", "labels.html?capture=capture"]
)
def test_other_pages_are_reached_by_keys_and_read_aloud(bench, tmp_path, name):
    shutil.copytree(bench.root / "capture", tmp_path / "capture")
    (tmp_path / "frames").mkdir()
    for frame in ("f450-0.tif", "dark-2.5s-0.tif"):
        shutil.copy(DEMO_CAPTURE / "frames" / frame, tmp_path / "frames" / frame)
    with served(Workbench(tmp_path, None)) as address, open_browser() as page:
        page.open(address + name)
        page.until("document.querySelectorAll('.field, #found-list li, #corners input, #labels input').length > 0")
        page.until("document.body.dataset.busy !== 'true'")
        assert reached_by_tab(page) == [[], []]
        assert nameless(page) == []
        assert looks(page) == []
        assert page.errors == []
