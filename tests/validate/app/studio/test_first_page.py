"""A folder of frames becomes a capture in the browser, with the file that `cbox calibrate --init` writes."""

import shutil
from pathlib import Path

import cboxlab.validation
from cboxlab.calibration.capture import load_capture, write_first_manifest
from cboxlab.validation.app.studio import Workbench
from helpers.pages.browser import open_browser
from helpers.pages.page_faults import FAULTS
from helpers.pages.server import served

DEMO = Path(cboxlab.validation.__file__).parent / "data" / "demo-capture"
FRAMES = ("f450-0.tif", "f450-1.tif", "f550-0.tif", "dark-0.6s-0.tif", "dark-2.5s-0.tif")


def test_frames_become_a_capture(tmp_path):
    root = tmp_path / "root"
    for name in ("frames", "plain"):
        (root / name).mkdir(parents=True)
        for frame in FRAMES:
            shutil.copy(DEMO / "frames" / frame, root / name / frame)
    bench = Workbench(root, None)
    with served(bench) as address, open_browser() as page:
        page.open(f"{address}first.html?folder=frames")
        page.until("!document.getElementById('work').hidden")
        assert "band f550" in page.run("document.getElementById('recognised').innerText")

        def enter(key, value, where=""):
            page.run(
                f"(() => {{const found = [...document.querySelectorAll('input[data-key={key}]')].find("
                f"(e) => e.labels[0].innerText.includes('{where}')); found.value = '{value}';"
                "found.dispatchEvent(new Event('change'))})()"
            )
            page.until("document.body.dataset.busy === 'false'")

        faults = "document.getElementById('faults').innerText"
        assert "camera.bit_depth" in page.run(faults)
        enter("bit_depth", "99")
        assert "bit_depth" in page.run(faults)
        assert page.run("document.querySelector('input[data-key=bit_depth]').getAttribute('aria-invalid')") == "true"
        enter("bit_depth", "twelve")
        assert page.run("document.querySelector('input[data-key=bit_depth]').getAttribute('aria-invalid')") == "true"
        assert "a number, such as 12" in page.run("document.getElementById('mistake').innerText")
        enter("bit_depth", "12")
        assert "bit_depth" not in page.run(faults)
        shades = (
            "[...document.querySelectorAll('#recognised canvas')].map((c) => {"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "return [c.ariaLabel, Math.max(...d.filter((_, i) => i % 4 === 0))]})"
        )
        frames = "document.querySelectorAll('#recognised {}').length"
        page.until(f"{frames.format('canvas')} === {frames.format('li')}")
        pictures = page.run(shades)
        assert all(largest == 255 for name, largest in pictures if "band" in name)
        assert all("counts from" in name for name, _ in pictures)
        enter("exposure_s", "0.6", "f450")
        page.run("[...document.querySelectorAll('button.small')].find((b) => !b.hidden).click()")
        page.until("document.body.dataset.busy === 'false'")
        assert page.run("document.getElementById('wrong').innerText") == "Nothing is wrong"
        for band, exposure in (("f450", "2.5"), ("f550", "0.6")):
            enter("exposure_s", exposure, band)
        assert page.run("document.getElementById('wrong').innerText") == "Nothing is wrong"
        enter("f_number", "8")
        enter("focal_length_mm", "35,0")
        assert "focal_length_mm = 35.0" in page.run("document.getElementById('text').textContent")
        enter("start_s", "7.5", "f550")
        enter("start_s", "60", "f450")
        enter("scene", "cornell-box")
        text = page.run("document.getElementById('text').textContent")
        page.run("document.getElementById('write').click()")
        page.until("document.getElementById('saved').innerText.includes('Written')")
        assert (root / "frames" / "capture.toml").read_text() == text
        page.run("document.getElementById('write').click()")  # nothing is replaced
        page.until("document.getElementById('mistake').innerText.includes('exists already')")
        for width in (1280, 400):
            page.size(width)
            assert page.run("document.documentElement.scrollWidth") <= width
            assert page.run(FAULTS) == []
        assert [error for error in page.errors if "400 (Bad Request)" not in error] == []
    manifest = load_capture(root / "frames").manifest
    assert manifest.camera.bit_depth == 12 and manifest.scene == "cornell-box"
    assert {band.id: (len(band.frames), band.exposure_s) for band in manifest.band} == {
        "f450": (2, 2.5),
        "f550": (1, 0.6),
    }
    assert all(band.f_number == 8 for band in manifest.band)
    assert [(band.id, band.start_s) for band in manifest.band] == [("f550", 7.5), ("f450", 60.0)]  # in the order taken
    # without entries the file is that of the command
    with served(bench) as address, open_browser() as page:
        page.open(f"{address}first.html?folder=plain")
        page.until("!document.getElementById('work').hidden")
        text = page.run("document.getElementById('text').textContent")
    write_first_manifest(root / "plain")
    assert (root / "plain" / "capture.toml").read_text() == text
