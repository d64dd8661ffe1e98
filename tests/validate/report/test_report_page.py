"""The report in a real browser: complete, readable at any width, in light and dark, and on paper."""

import re
import unicodedata
from io import BytesIO

import pytest
from cboxlab.validation.report.page import ReportInputs, build_report
from helpers.fakes.box import FakeBox, fake_run, fake_weights
from helpers.pages.axe import nameless, violations
from helpers.pages.browser import open_browser
from pypdf import PdfReader

BOX = FakeBox(size=48)

#: Contrast of text with the ground behind it, after WCAG 2.2 (1.4.3), for every visible text; and its size.
TEXTS = """
(() => {
  const light = (c) => c.map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const parsed = (text) => { const n = text.match(/[\\d.]+/g).map(Number); return n.length < 4 ? [...n, 1] : n; };
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const c = parsed(getComputedStyle(e).backgroundColor);
      if (c[3] === 1) return c.slice(0, 3);
    }
    return [255, 255, 255];
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, e = node.parentElement, text = node.textContent.trim();
    if (!text || !e.checkVisibility() || ['STYLE', 'SCRIPT', 'OPTION'].includes(e.tagName)) continue;
    const style = getComputedStyle(e);
    const inPlot = e.closest('svg');
    const colour = parsed(inPlot ? style.fill : style.color).slice(0, 3);
    const [a, b] = [light(colour), light(ground(e))].sort((p, q) => q - p);
    const scale = inPlot ? inPlot.getScreenCTM().a : 1;
    found.push([text.slice(0, 40), (a + 0.05) / (b + 0.05), parseFloat(style.fontSize) * scale]);
  }
  return found;
})()
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    build_report(path, ReportInputs(BOX.compare(seed=2, factor=1.03), fake_run(), ["One & another."], *fake_weights()))
    return path


@pytest.fixture(scope="module")
def browser():
    with open_browser() as page:
        yield page


def _open(browser, report, width, dark=False):
    browser.errors.clear()
    browser.open(report, width=width, dark=dark)
    browser.run("document.getElementById('viewer').viewer.ready.then(() => null)")
    browser.run("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    browser.run("document.getElementById('viewer').viewer.select(20, 30)")


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1280, 400])
def test_every_text_can_be_read(browser, report, width, dark):
    """Contrast of WCAG AA, 11 px at least, nothing wider than the window, no error on the console."""
    _open(browser, report, width, dark)
    texts = browser.run(TEXTS)
    assert len(texts) > 200
    assert [t for t in texts if t[1] < 4.5] == []
    assert [t for t in texts if t[2] < 10.95] == []
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.errors == []


def _squeezed(text):
    """Without spaces, letters joined in one sign apart."""
    return re.sub(r"\s", "", unicodedata.normalize("NFKC", text))


def test_tables_are_whole_on_a_telephone(browser, report):
    """No table of the report is cut at 400 px, its caption stands outside the scroller, and numbers stay whole."""
    _open(browser, report, 400)
    cut = browser.run(
        "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth + 1)"
        ".map((e) => [e.ariaLabel.slice(0, 60), e.scrollWidth, e.clientWidth])"
    )
    assert cut == []
    assert browser.run("document.querySelectorAll('.scroll .caption, table caption').length") == 0
    broken = browser.run(
        "[...document.querySelectorAll('td:not(.words)')].filter((cell) => [...cell.childNodes].some((node) =>"
        "{const range = document.createRange(); range.selectNodeContents(node);"
        "return new Set([...range.getClientRects()].map((box) => box.top)).size > 1;})).map((cell) => cell.innerText)"
    )
    assert broken == []


def test_maps_of_the_bands_share_their_axes(browser, report):
    """Of five maps in a row only the first has numbers of pixels; all are of one size."""
    _open(browser, report, 1280)
    widths, plain = browser.run(
        "(() => {const all = [...document.querySelector('.nany').querySelectorAll('.panel')];"
        "return [all.map((e) => e.querySelector('img').getBoundingClientRect().width),"
        "all.map((e) => getComputedStyle(e.querySelector('.down')).visibility === 'hidden')]})()"
    )
    assert plain == [False, True, True, True, True] and max(widths) - min(widths) < 0.5


def test_every_control_and_picture_has_a_name(browser, report):
    _open(browser, report, 1280)
    nameless = browser.run(
        "[...document.querySelectorAll('img:not([alt]), svg[role=img]:not([aria-label]), canvas:not([aria-label])'),"
        "...[...document.querySelectorAll('button, select, input')].filter("
        "(e) => !(e.innerText || e.labels?.length || e.ariaLabel))].map((e) => e.outerHTML.slice(0, 80))"
    )
    assert nameless == []


def test_pixels_are_marked_where_they_are(browser, report):
    """The mark of pixel v stands at (v + 0.5) / n of the picture, below it and next to it."""
    _open(browser, report, 1280)
    outcome = browser.run("""[...document.querySelectorAll('.framed')].flatMap((frame) => {
      const picture = frame.querySelector('img').getBoundingClientRect();
      const marks = (where) => [...frame.querySelectorAll(where)].map(
        (e) => [parseInt(e.textContent), e.getBoundingClientRect()]);
      return [
        ...marks('.across span').map(([n, box]) => [n, (box.left + 0.3 * 11.5 - picture.left) / picture.width]),
        ...marks('.down span').map(([n, box]) => [n, ((box.top + box.bottom) / 2 - picture.top) / picture.height]),
      ];
    })""")
    assert len(outcome) > 20
    for pixel, position in outcome:
        assert position == pytest.approx((pixel + 0.5) / BOX.size, abs=0.02)


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (400, True)])
def test_axe_finds_nothing(browser, report, width, dark):
    _open(browser, report, width, dark)
    assert violations(browser) == []
    assert nameless(browser) == []


def test_printed_it_is_complete_and_keeps_its_columns(browser, report):
    """Folded chapters are in the PDF; pictures of a row stand side by side, and colour bars keep colours."""
    _open(browser, report, 1280)
    browser.run("document.querySelectorAll('details').forEach((one) => { one.open = false; })")
    printed = PdfReader(BytesIO(browser.pdf()))
    # ligatures and line breaks are the printer's
    text = _squeezed("".join(page.extract_text() for page in printed.pages))
    titles = browser.run(
        "[...document.querySelectorAll('h1, h2, .folded summary, .caption, th, figcaption')].map((e) => e.textContent)"
    )
    assert len(printed.pages) >= 6 and len(titles) > 50
    assert [title for title in titles if _squeezed(title) not in text] == []
    shades = sum(len(page["/Resources"].get("/Pattern", {})) for page in printed.pages)
    assert shades >= browser.run("document.querySelectorAll('.ramp').length") > 5
    assert browser.run("Array.from(document.querySelectorAll('.folded details')).every((one) => one.open)")
    # as the printer lays it out: A4 less its margins
    browser.call("Emulation.setEmulatedMedia", media="print")
    browser.size(688)
    columns = browser.run(
        "Array.from(document.querySelectorAll('.n3'), (e) => getComputedStyle(e).gridTemplateColumns.split(' ').length)"
    )
    assert columns and set(columns) == {3}
    exact = browser.run("Array.from(document.querySelectorAll('.ramp'), (e) => getComputedStyle(e).printColorAdjust)")
    assert len(exact) > 5 and set(exact) == {"exact"}
    browser.call("Emulation.setEmulatedMedia", media="")
