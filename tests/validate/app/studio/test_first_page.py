"""A folder of frames becomes a capture in the browser, with the file that `cbox calibrate --init` writes."""

import json
import shutil

import pytest
from cboxlab.calibration.capture import load_capture, write_first_manifest
from cboxlab.utils.errors import InputError
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.app.studio import Workbench
from cboxlab.validation.app.studio.first_capture import FirstCaptures
from helpers.pages.browser import open_browser
from helpers.pages.page_faults import FAULTS
from helpers.pages.server import served

FRAMES = ("f450-0.tif", "f450-1.tif", "f550-0.tif", "dark-0.6s-0.tif", "dark-2.5s-0.tif")
LACKING = "document.getElementById('lacking').innerText"


def frames_in(folder, *names):
    """Some frames of the bundled capture, under their names or those of a camera."""
    folder.mkdir(parents=True)
    for k, frame in enumerate(FRAMES):
        shutil.copy(DEMO_CAPTURE / "frames" / frame, folder / (names[k] if names else frame))


def ready(page):
    page.until("document.body.dataset.busy === 'false'")


def field(key, where):
    return f"inputs().find((e) => e.dataset.key === '{key}' && e.dataset.where.includes('{where}'))"


def enter(page, key, value, where=""):
    page.run(f"{field(key, where)}.focus()")
    page.run("document.activeElement.select()")
    page.call("Input.insertText", text=value)
    page.run("document.activeElement.blur()")
    ready(page)


def test_frames_become_a_capture(tmp_path, monkeypatch):
    root = tmp_path / "root"
    bench, captures = Workbench(root, None), []
    monkeypatch.setattr(bench, "open", lambda capture, model, progress: captures.append(capture))
    for name in ("frames", "plain"):
        frames_in(root / name)
    with served(bench) as address, open_browser() as page:
        page.open(f"{address}first.html?folder=frames")
        ready(page)
        groups = page.run("[...document.querySelectorAll('#rows .group')].map((e) => e.getAttribute('aria-label'))")
        assert groups == ["Photographs of the box", "Dark frames"]
        assert page.run(LACKING) == "3 required values are missing. Nothing that you entered is wrong."
        bits = field("bit_depth", "camera")
        for value, fault in (("99", "a number of 16 or less"), ("twelve", "a number, such as 12")):
            enter(page, "bit_depth", value)
            assert page.run(f"{bits}.getAttribute('aria-invalid')") == "true"
            assert fault in page.run(f"document.getElementById({bits}.getAttribute('aria-describedby')).innerText")
        enter(page, "bit_depth", "12")
        assert page.run(f"{bits}.getAttribute('aria-invalid')") == "false"
        shades = (
            "[...document.querySelectorAll('#rows canvas')].map((c) => {"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "return [c.ariaLabel, Math.max(...d.filter((_, i) => i % 4 === 0))]})"
        )
        page.until("document.querySelectorAll('#rows canvas').length === 4")
        pictures = page.run(shades)
        assert all(largest == 255 for name, largest in pictures if name.startswith("f"))
        assert all(largest < 150 for name, largest in pictures if name.startswith("dark"))
        assert all("counts from" in name for name, _ in pictures)
        enter(page, "exposure_s", "0.6", "f450")
        page.run("[...document.querySelectorAll('button.small')].find((b) => !b.hidden).click()")
        ready(page)
        assert page.run(LACKING) == "No required value is missing. Nothing that you entered is wrong."
        enter(page, "exposure_s", "2.5", "f450")
        # an entry that the program does not answer is sent with the next one
        page.run("globalThis.there = fetch; globalThis.fetch = () => Promise.reject(new Error())")
        enter(page, "f_number", "8")
        assert "does not answer" in page.run("document.getElementById('mistake').innerText")
        page.run("globalThis.fetch = there")
        enter(page, "focal_length_mm", "35,0")
        assert "focal_length_mm = 35.0" in page.run("document.getElementById('text').textContent")
        enter(page, "start_s", "7.5", "f550")
        enter(page, "start_s", "60", "f450")
        enter(page, "scene", "cornell-box")
        for width in (1280, 400):
            page.size(width)
            assert page.run("document.documentElement.scrollWidth") <= width
            assert page.run(FAULTS) == []
        text = page.run("document.getElementById('text').textContent")
        page.run("document.getElementById('write').click()")
        page.until("document.getElementById('saved').innerText.includes('Written')")
        assert (root / "frames" / "capture.toml").read_text() == text
        page.run("globalThis.link = [...document.querySelectorAll('#saved a')].at(-1), 0")
        page.run("document.getElementById('write').click()")  # nothing is replaced
        page.until("document.getElementById('mistake').innerText.includes('exists already')")
        assert (root / "frames" / "capture.toml").read_text() == text
        page.run("link.click()")  # the workbench opens it
        page.until("typeof events === 'object' && sessionStorage.getItem('open') === null && page.requests === 0")
        page.until("!page.job")
        assert captures == ["frames"]
        # without entries the file is that of the command
        page.open(f"{address}first.html?folder=plain")
        ready(page)
        text = page.run("document.getElementById('text').textContent")
        assert [error for error in page.errors if "400 (Bad Request)" not in error] == []
    write_first_manifest(root / "plain")
    assert (root / "plain" / "capture.toml").read_text() == text
    manifest = load_capture(root / "frames").manifest
    assert manifest.camera.bit_depth == 12 and manifest.scene == "cornell-box"
    assert {band.id: (len(band.frames), band.exposure_s) for band in manifest.band} == {
        "f450": (2, 2.5),
        "f550": (1, 0.6),
    }
    assert all(band.f_number == 8 for band in manifest.band)
    assert [(band.id, band.start_s) for band in manifest.band] == [("f550", 7.5), ("f450", 60.0)]  # in the order taken
    assert list((root / ".cbox-unsaved").iterdir()) == []


def test_numbered_frames_get_their_kinds_and_nothing_entered_is_lost(tmp_path):
    """A reload, a second tab and a program that is started again have all that was entered."""
    frames_in(tmp_path / "box", *(f"IMG_{k:04d}.tif" for k in range(1, 6)))

    def set_roles(page, frames, kind, name, exposure):
        page.run(
            f"for (const tick of document.querySelectorAll('#rows input[data-frames]'))"
            f"tick.checked = {frames}.some((k) => tick.dataset.frames.includes(k))"
        )
        page.run("countTicks()")
        set_ticked(page, kind, name, exposure)

    def set_ticked(page, kind, name, exposure):
        for key, value in (("kind", kind), ("filter", name), ("exposure", exposure)):
            page.run(f"document.getElementById('role-{key}').value = '{value}'")
        page.run("document.getElementById('set-roles').click()")
        ready(page)

    draft = "document.getElementById('text').textContent"
    with open_browser() as page:
        with served(Workbench(tmp_path, None)) as address:
            page.open(f"{address}first.html?folder=box")
            ready(page)
            # what a covered lens saw is no photograph: it can be ticked, too
            assert page.run(
                "document.querySelector('[aria-label=\"Frames that are not used\"]').innerText.includes('0004')"
            )
            set_roles(page, ["0001", "0002", "0003"], "band", "f450", "2,5")
            # the third is no repeat of the others: its own tick takes it out of the row
            page.run("document.querySelector('.singles').open = true")
            page.until("document.querySelectorAll('.singles canvas').length === 3")
            counts = page.run("[...document.querySelectorAll('.singles small')].map((e) => e.innerText)")
            assert counts[2] != counts[0] and all("counts from" in text for text in counts)
            assert page.run(FAULTS) == []
            page.run("[...document.querySelectorAll('.singles input')].at(-1).click()")
            assert page.run("document.querySelector('.singles').closest('.entry').querySelector('input').indeterminate")
            assert page.run("document.getElementById('set-roles').innerText") == "Set 1 ticked frame"
            set_ticked(page, "band", "f550", "0.6")
            set_roles(page, ["0004"], "dark", "", "0.6")
            set_roles(page, ["0005"], "dark", "", "-1")
            assert "found the exposure -1 s" in page.run("document.getElementById('mistake').innerText")
            set_roles(page, ["0005"], "dark", "", "2.5")
            enter(page, "bit_depth", "12")
            text = page.run(draft)
            page.reload()
            ready(page)
            assert page.run(draft) == text
            other = page.tab()
            other.open(f"{address}first.html?folder=box")
            ready(other)
            enter(other, "scene", "cornell-box")
            enter(page, "gain_e_per_dn", "12")  # the entry of the other tab stays
            text = page.run(draft)
            other.call("Page.close")
        assert 'scene = "cornell-box"' in text and "gain_e_per_dn = 12" in text
        with served(Workbench(tmp_path, None)) as address:
            page.open(f"{address}first.html?folder=box")
            ready(page)
            assert page.run(draft) == text
            page.run("document.getElementById('write').click()")
            page.until("document.getElementById('saved').innerText.includes('Written')")
    manifest = load_capture(tmp_path / "box").manifest
    assert {band.id: (len(band.frames), band.exposure_s) for band in manifest.band} == {
        "f450": (2, 2.5),
        "f550": (1, 0.6),
    }
    assert [(dark.frames, dark.exposure_s) for dark in manifest.dark] == [
        (("IMG_0004.tif",), 0.6),
        (("IMG_0005.tif",), 2.5),
    ]


@pytest.mark.parametrize(
    "content", ["", "[]", '{"entries": [{}], "roles": []}', '{"entries": 1, "roles": 2}', "[" * 9999]
)
def test_damaged_stored_entries_are_as_none(tmp_path, content, caplog):
    frames_in(tmp_path / "box")
    FirstCaptures(tmp_path).draft("box", [{"where": "[camera]", "key": "bit_depth", "value": "12"}], [])
    (stored,) = (tmp_path / ".cbox-unsaved").iterdir()
    assert json.loads(stored.read_text())["entries"][0]["value"] == "12"
    assert "bit_depth = 12" in FirstCaptures(tmp_path).draft("box", [], [])["text"]
    stored.write_text(content)
    assert "bit_depth = 12" not in FirstCaptures(tmp_path).draft("box", [], [])["text"]
    assert "not read" in caplog.text


def test_entries_are_not_stored_behind_a_link(tmp_path, caplog):
    root, outside = tmp_path / "root", tmp_path / "outside"
    frames_in(root / "box")
    outside.mkdir()
    (root / ".cbox-unsaved").symlink_to(outside)
    firsts = FirstCaptures(root)
    firsts.draft("box", [{"where": "[camera]", "key": "bit_depth", "value": "12"}], [])
    assert "bit_depth = 12" in firsts.draft("box", [], [])["text"]  # in memory
    assert list(outside.iterdir()) == [] and "may lead anywhere" in caplog.text


def test_entries_of_another_form_are_refused_and_change_nothing(tmp_path):
    frames_in(tmp_path / "box")
    firsts = FirstCaptures(tmp_path)
    record = {"where": "[camera]", "key": "bit_depth", "value": "12"}
    role = {"file": "f450-0.tif", "kind": "dark", "filter": "", "exposure_s": ""}
    for entries, roles in (
        ([{**record, "value": 12}], []),
        ([{**record, "value": "1" * 301}], []),
        ([], [{**role, "exposure_s": "soon"}]),
        ([], [{**role, "file": "../capture.toml"}]),
        ([], [{**role, "kind": "photo"}]),
    ):
        with pytest.raises(InputError):
            firsts.draft("box", entries, roles)
    with pytest.raises(InputError, match="a frame of the form"):
        firsts.thumbnails("box", ["../capture.toml"])
    assert firsts.draft("box", [], [])["lacking"] == 3
    assert not (tmp_path / ".cbox-unsaved").exists()
