"""Regions, files and links of the viewer in a real browser, against numpy on the comparison's maps."""

import csv

import numpy as np
import pytest
from cboxlab.validation.report.viewer import picture_data, viewer_fragment
from helpers.fakes.box import FakeBox
from helpers.pages.browser import open_browser
from matplotlib.path import Path as Outline

BOX = FakeBox(size=48)
COMPARISON = BOX.compare(seed=4, factor=1.02)
MAPS = COMPARISON.maps
#: Bands in the order of their wavelengths, which is not that of the comparison.
NM = [550.0, 450.0, 500.0, 650.0, 600.0]
ORDER = np.argsort(NM)
USED = MAPS["mask"].values == 0


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    file = tmp_path_factory.mktemp("viewer") / "viewer.html"
    fragment = viewer_fragment(picture_data(COMPARISON, NM), "v", {"link": True})
    file.write_text(f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"/><body>{fragment}</body></html>', "utf-8")
    with open_browser() as page:
        page.file = file
        yield page


@pytest.fixture
def page(browser):
    browser.errors.clear()
    open_at(browser, "")
    yield browser
    assert browser.errors == []


def open_at(browser, fragment):
    browser.open(f"{browser.file.resolve().as_uri()}?{np.random.default_rng().integers(1 << 60)}{fragment}")
    browser.run("globalThis.v = document.getElementById('v').viewer; v.ready.then(() => null)")


def point(page, x, y):
    """Point of the window of pixel (x, y) in the first picture, whole picture shown."""
    box = page.run(
        "(() => {const b = document.querySelector('canvas').getBoundingClientRect();return [b.left, b.top, b.width]})()"
    )
    return box[0] + (x + 0.5) * box[2] / BOX.size, box[1] + (y + 0.5) * box[2] / BOX.size


def table(page, what):
    return list(csv.DictReader(page.run(f"v.csv('{what}')").splitlines()))


def test_a_dragged_rectangle_has_the_figures_of_its_pixels(page):
    page.run("v.set({tool: 'rectangle'})")
    page.drag(point(page, 8, 5), point(page, 30, 20))
    assert page.run("v.state.region") == {"kind": "rectangle", "points": [[8, 5], [30, 20]]}
    rows = table(page, "region")
    for row, i in zip(rows, ORDER, strict=True):
        used = np.zeros_like(USED[i])
        used[5:21, 8:31] = USED[i, 5:21, 8:31]
        measured, rendered, sigma = (MAPS[name].values[i][used] for name in ("measured", "rendered", "sigma"))
        assert int(row["pixels"]) == used.sum() > 200
        assert float(row["measured_dn"]) == pytest.approx(measured.mean(), rel=1e-6)
        assert float(row["measured_scatter_dn"]) == pytest.approx(measured.std(ddof=1), rel=1e-5)
        assert float(row["measured_mean_sigma_dn"]) == pytest.approx(np.sqrt(np.sum(sigma**2)) / sigma.size, rel=1e-5)
        assert float(row["predicted_dn"]) == pytest.approx(rendered.mean(), rel=1e-6)
        percent = 100 * (measured.mean() / rendered.mean() - 1)
        assert float(row["difference_percent"]) == pytest.approx(percent, abs=1e-4)
    panel = page.run("document.querySelector('.cbv-pixel[aria-label=Region]').innerText")
    assert "Rectangle from 8, 5 to 30, 20, 368\xa0px" in panel
    assert page.run("[...document.querySelectorAll('.cbv-scroll')].every((e) => e.scrollWidth <= e.clientWidth)")
    # the panel stands next to the pictures, not below them
    assert page.run("document.querySelector('.cbv-side').getBoundingClientRect().left") > point(page, 47, 0)[0]
    page.run("document.querySelector('canvas').focus()")
    page.key("Escape")
    assert page.run("v.state.region === null && document.querySelector('[aria-label=Region]').hidden")


def test_a_clicked_polygon_holds_the_pixels_within(page):
    corners = [(6, 40), (20, 12), (33, 17), (44, 44)]
    page.run("v.set({tool: 'polygon'})")
    for corner in corners:
        page.click(*point(page, *corner))
    rows = table(page, "region")
    y, x = np.indices((BOX.size, BOX.size))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    inner, outer = (Outline(corners).contains_points(points, radius=r).reshape(x.shape) for r in (-1e-9, 1e-9))
    for row, i in zip(rows, ORDER, strict=True):
        assert int(row["pixels"]) in {(inner & USED[i]).sum(), (outer & USED[i]).sum()}
        assert float(row["measured_dn"]) == pytest.approx(MAPS["measured"].values[i][outer & USED[i]].mean(), rel=1e-3)


def test_a_line_by_keyboard_has_a_profile_in_the_band_shown(page):
    page.run("v.set({tool: 'line', band: 2}); v.select(3, 30); document.querySelector('canvas').focus()")
    page.key("Enter")
    for _ in range(40):
        page.key("ArrowRight")
    page.key("Enter")
    rows = table(page, "region")
    assert [(int(row["x"]), int(row["y"])) for row in rows] == [(x, 30) for x in range(3, 44)]
    for name, column in (("measured", "measured (DN)"), ("rendered", "predicted (DN)"), ("sigma", "sigma (DN)")):
        values = MAPS[name].values[ORDER[2], 30, 3:44]
        np.testing.assert_allclose([float(row[column]) for row in rows], values, rtol=1e-6)
    chart = "document.querySelector('[aria-label=Region] svg')"
    assert page.run(f"{chart}.querySelectorAll('circle.measured').length") == 41
    # of all bands: the luminance, with the noise of the bands added by their squares
    page.run("v.set({band: -1})")
    weights = COMPARISON.xyz_per_dn[1]
    sigma = np.sqrt(np.einsum("b,bx->x", weights**2, MAPS["sigma"].values[:, 30, 3:44] ** 2))
    rows = table(page, "region")
    np.testing.assert_allclose([float(row["sigma (cd m⁻²)"]) for row in rows], sigma, rtol=1e-5)


def test_differences_and_files(page):
    page.run("v.set({mode: 'side', band: 1, a: 'absolute', b: 'relative', c: 'residual'})")
    rows = table(page, "panes")
    names = list(rows[0])
    assert names[3].endswith("500 nm, DN") and names[4].endswith("%") and "σ" in names[5]
    i = ORDER[1]
    measured, rendered = (MAPS[name].values[i] for name in ("measured", "rendered"))
    relative = np.where(rendered > 0, 100 * (measured / rendered - 1), np.nan)
    differences = measured - rendered, relative, (measured - rendered) / MAPS["sigma"].values[i]
    for name, expected in zip(names[3:], differences, strict=True):
        values = np.array([float(row[name] or "nan") for row in rows]).reshape(BOX.size, BOX.size)
        np.testing.assert_allclose(values, np.where(USED[i], expected, np.nan), rtol=1e-3, atol=2e-3)
    page.run("globalThis.saved = []; HTMLAnchorElement.prototype.click = function () { saved.push(this.download); }")
    page.run("document.querySelector('[data-cbv=png]').click(); document.querySelector('[data-cbv=csv]').click()")
    page.until("saved.length === 4")
    assert set(page.run("saved")) == {"absolute.png", "relative.png", "residual.png", "pixels.csv"}
    # the picture in the file has the colours of the picture shown
    assert page.run("""(() => {
      const made = v.figure(2), shown = document.querySelectorAll('canvas')[2];
      const colour = (canvas, x, y) => { const copy = new OffscreenCanvas(1, 1).getContext('2d');
        copy.drawImage(canvas, -x, -y); return copy.getImageData(0, 0, 1, 1).data.join(); };
      const k = (made.width - 32) / shown.width;
      const there = ([x, y]) => [Math.round(16 + k * x), Math.round(34 + k * y)];
      return [[100, 90], [200, 150]].every((at) => colour(made, ...there(at)) === colour(shown, ...at));
    })()""")


def test_a_link_keeps_the_view_and_a_wrong_one_harms_nothing(page):
    page.run(
        "v.set({mode: 'side', c: 'delta_e_2000', band: 3, zoom: 4, x: 20.5, y: 30, pixel: [12, 30],"
        "tool: 'polygon', region: {kind: 'polygon', points: [[1, 2], [9, 4], [5, 12]]}})"
    )
    page.until("location.hash.startsWith('#view&')")
    state, link = page.run("v.state"), page.run("location.hash")
    open_at(page, link)
    assert page.run("v.state") == state
    wrong = "#view&mode=dance&c=nothing&band=77&zoom=1e9&x=NaN&pixel=900,1&region=polygon:1,2;x,3&__proto__=1"
    open_at(page, wrong + "&scale=own")
    outcome = page.run("v.state")
    untouched = {"mode": "slider", "c": "residual", "band": -1, "pixel": None, "region": None}
    assert {key: outcome[key] for key in untouched} == untouched
    assert outcome["zoom"] == 12 and outcome["scale"] == "own"
