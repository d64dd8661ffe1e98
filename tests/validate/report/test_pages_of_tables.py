"""Pages that commands write of their sentences and tables, in a browser."""

from cboxlab.utils.table import Table
from cboxlab.validation.report import write_tables
from helpers.pages.axe import nameless, violations
from helpers.pages.browser import open_browser
from helpers.pages.page_faults import FAULTS


def test_notes_are_a_list_and_names_break_only_at_hyphens(tmp_path):
    page = tmp_path / "page.html"
    names = ("reflectance-gradient", "veiling-glare", "unknown")
    rows = [(name, "white, roughness 0.263 ± 0.014, specular 0.0739 ± 0.0030", "90.7", "94.8") for name in names]
    table = Table("What decided", ("effect", "parameters", "explains of the excess, %", "probability, %"), rows)
    sentences = ("DIFFERENT: mean light +1.4 %", "Cause: unknown", "• a.exr: no unit", "• b.exr: no unit")
    write_tables(page, "b.exr against a.exr", sentences, [table])
    with open_browser() as browser:
        for width, dark in ((1280, False), (400, True)):
            browser.open(page, width, dark=dark)
            assert violations(browser) == [] and nameless(browser) == [] and browser.run(FAULTS) == []
            assert browser.run("document.documentElement.scrollWidth") <= width
        assert browser.run("[...document.querySelectorAll('li')].map((e) => e.innerText)") == [
            "a.exr: no unit",
            "b.exr: no unit",
        ]
        assert "•" not in browser.run("document.body.innerText")
        # one line for each part between hyphens
        lines = browser.run(
            "[...document.querySelectorAll('tbody th')].map((e) => {const r = document.createRange(); "
            "r.selectNodeContents(e); return r.getClientRects().length})"
        )
        assert all(count <= name.count("-") + 1 for count, name in zip(lines, names, strict=True))
        assert browser.errors == []
