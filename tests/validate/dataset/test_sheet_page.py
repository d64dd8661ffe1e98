"""The quality sheet in a browser: whole on a telephone, in the dark, for a keyboard and a screen reader."""

import base64
import io

import pytest
from cboxlab.validation.dataset.sheet import histograms, write_page
from helpers.pages.axe import nameless, violations
from helpers.pages.browser import open_browser
from helpers.pages.page_faults import FAULTS
from PIL import Image


def test_a_sheet_fits_a_telephone_and_breaks_no_rule_of_axe(tmp_path):
    stream = io.BytesIO()
    Image.new("RGB", (8, 8), "grey").save(stream, format="PNG")
    picture = base64.b64encode(stream.getvalue()).decode()
    plots = histograms({"room width, mm": [460.0, 470.0, 475.0], "number of blocks": [1, 2, 2], "lamp power, W": []})
    assert [name for name, _ in plots] == ["Histogram: room width, mm", "Histogram: number of blocks"]
    faults = [("000003 main", "light is below the noise in 45 of 100 pixels " + 40 * "x")]
    page = tmp_path / "quality.html"
    write_page(page, "Quality of boxes", ["Two boxes."], [("000000 main", picture)], [("Drawn values", plots)], faults)
    with open_browser() as browser:
        for width, dark in ((1280, False), (400, True)):
            browser.open(page, width, dark=dark)
            assert violations(browser) == [] and nameless(browser) == [] and browser.run(FAULTS) == []
            assert browser.run("document.documentElement.scrollWidth") <= width
            sizes = browser.run("[...document.images].map((i) => [i.getBoundingClientRect().right, i.naturalWidth])")
            assert len(sizes) == 3 and all(right <= width and pixels > 0 for right, pixels in sizes)
            first, second = (browser.run(f"document.querySelectorAll('.plots img')[{i}].width") for i in (0, 1))
            assert first == pytest.approx(240) == second
        assert browser.errors == []
