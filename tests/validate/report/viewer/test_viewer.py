"""The viewer in a real browser: its numbers are those of the comparison, and every control does what it says."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.image import RenderedImage
from cboxlab.validation.compare import srgb_preview
from cboxlab.validation.report.metrics import metrics
from cboxlab.validation.report.viewer import encoded, picture_data, viewer_fragment
from cboxlab.validation.report.viewer.light import pixel_spectra
from helpers.fakes.box import BANDS, SURFACES, FakeBox, fake_run
from helpers.pages.browser import open_browser

BOX = FakeBox(size=48)
#: The bands' wavelengths out of order, so that sorting shows.
NM = [550.0, 450.0, 500.0, 650.0, 600.0]
ORDER = np.argsort(NM)


@pytest.fixture(scope="module")
def comparison():
    return BOX.compare(seed=4, factor=1.02)


@pytest.fixture(scope="module")
def browser():
    with open_browser() as page:
        yield page


#: Two spectra, and how much of each a pixel has; the light by number of reflections; the bands' responses.
SPECTRA_NM = np.arange(400.0, 701.0, 10.0)
BASIS = np.stack([np.ones(31), np.linspace(0, 1, 31)])
AMOUNTS = np.stack([np.full((48, 48), 2.0), np.indices((48, 48))[1] / 10])
SHARES = np.stack([np.full((48, 48), share) for share in (0.6, 0.3, 0.1)])
CURVES = np.exp(-0.5 * ((SPECTRA_NM - np.array(NM)[ORDER][:, None]) / 20) ** 2)


@pytest.fixture(scope="module")
def data(comparison):
    return {
        **picture_data(comparison, NM),
        "spectrum": {
            "wavelength_nm": SPECTRA_NM.tolist(),
            "rank": 2,
            "basis": encoded(BASIS),
            "coefficients": encoded(AMOUNTS),
            "unit": "W m⁻² sr⁻¹ nm⁻¹",
        },
        "light": {"names": ["reflected once", "twice", "more often"], "share": encoded(SHARES)},
        "filters": {"wavelength_nm": SPECTRA_NM.tolist(), "curves": encoded(CURVES)},
    }


@pytest.fixture
def page(browser, data, tmp_path):
    file = tmp_path / "viewer.html"
    fragment = viewer_fragment(data, "v")
    head = '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"/></head><body>'
    file.write_text(f"{head}{fragment}</body></html>", encoding="utf-8")
    browser.errors.clear()
    browser.open(file)
    browser.run("globalThis.v = document.getElementById('v').viewer; v.ready.then(() => null)")
    yield browser
    assert browser.errors == []


def _at(page, canvas, x, y):
    """Point of the window of pixel (x, y) in the n-th picture, whole picture shown."""
    box = page.run(
        f"(() => {{const b = document.querySelectorAll('canvas')[{canvas}].getBoundingClientRect();"
        "return [b.left, b.top, b.width]})()"
    )
    cell = box[2] / BOX.size
    return box[0] + (x + 0.5) * cell, box[1] + (y + 0.5) * cell


def _layer(page, name, band=-1):
    """Values of a layer in the browser, (y, x)."""
    page.run(f"v.set({{c: '{name}', band: {band}}})")
    values = page.run(f"Array.from(v._paintedLayer('{name}').values, (n) => Number.isNaN(n) ? null : n)")
    return np.array(values, float).reshape(BOX.size, BOX.size)


def test_a_click_shows_the_numbers_of_the_comparison(page, comparison):
    x, y = 30, 12
    page.run("globalThis.received = null; addEventListener('cbox-pixel', (e) => { received = e.detail; })")
    page.click(*_at(page, 0, x, y))
    record = page.run("received")
    maps = comparison.maps
    assert (record["x"], record["y"]) == (x, y)
    assert record["surface"] == SURFACES[int(maps["surface"].values[y, x])]
    assert [b["nm"] for b in record["bands"]] == sorted(NM)
    for entry, i in zip(record["bands"], ORDER, strict=True):
        assert entry["id"] == BANDS[i]
        for name in ("measured", "rendered", "sigma"):
            assert entry[name] == pytest.approx(maps[name].values[i, y, x], rel=1e-6)
        assert entry["residual"] == pytest.approx(maps["residual_over_sigma"].values[i, y, x], abs=1e-4)
    assert record["xyz_measured"] == pytest.approx(maps["xyz_measured"].values[y, x], rel=1e-5)
    assert record["delta_e_ab"] == pytest.approx(maps["delta_e_ab"].values[y, x], rel=1e-3)
    panel = page.run("document.querySelector('.cbv-pixel').innerText")
    assert f"Pixel {x}, {y}: {record['surface']}" in panel
    assert f"{maps['measured'].values[ORDER[0], y, x]:.5g}" in panel
    page.run("document.querySelector('canvas').focus()")
    page.key("Escape")
    assert page.run("document.querySelector('.cbv-pixel').hidden && received === null")


def test_a_pixel_shows_its_spectrum_the_filters_and_its_light(page):
    page.run("v.select(20, 10)")
    record = page.run("v.values(20, 10)")
    np.testing.assert_allclose(record["spectrum"]["values"], 2 * BASIS[0] + 2 * BASIS[1], rtol=1e-6)
    charts = "document.querySelectorAll('.cbv-charts svg')"
    assert page.run(f"{charts}.length") == 3
    assert page.run(f"{charts}[2].querySelectorAll('.filter').length") == len(BANDS)
    assert page.run(f"{charts}[2].querySelectorAll('.spectrum').length") == 1
    # one dot with an error bar and one square for each band
    assert page.run(f"{charts}[0].querySelectorAll('circle.measured').length") == len(BANDS)
    assert page.run(f"{charts}[0].querySelectorAll('path.measured').length") == len(BANDS)
    assert page.run(f"{charts}[0].querySelectorAll('rect.predicted').length") == len(BANDS)
    text = page.run("document.querySelector('.cbv-light').parentElement.innerText")
    for part in ("reflected once: 60.0\xa0%", "twice: 30.0\xa0%", "more often: 10.0\xa0%"):
        assert part in text


def test_spectra_of_pixels_are_those_of_the_render():
    """The basis of few spectra gives back every pixel's own, the lamp's fitted power in it."""
    generator = np.random.default_rng(5)
    spectra = np.exp(-0.5 * ((SPECTRA_NM - np.linspace(420, 680, 6)[:, None]) / 60) ** 2)
    image = RenderedImage(
        generator.random((3, 8, 9, 6)).astype(np.float32),
        spectra,
        SPECTRA_NM,
        np.ones((8, 9, 1)),
        np.zeros(1, int),
        ("wall",),
    )
    _, basis, amounts = pixel_spectra(image, 0.9)
    expected = 0.9 * image.project(np.eye(31))[0]
    np.testing.assert_allclose(np.einsum("kyx,kw->yxw", amounts, basis), expected, rtol=2e-3)


@pytest.mark.parametrize(
    ("layer", "name", "scale"),
    [
        ("delta_e_ab", "delta_e_ab", 1),
        ("delta_e_2000", "delta_e_2000", 1),
        ("luminance", "luminance_relative_difference", 100),
    ],
)
def test_layers_are_the_maps_of_the_comparison(page, comparison, layer, name, scale):
    expected = scale * comparison.maps[name].values
    np.testing.assert_allclose(_layer(page, layer), expected, rtol=2e-3, atol=2e-4)


def test_residuals_by_band_and_of_all_bands(page, comparison):
    residual = comparison.maps["residual_over_sigma"].values[ORDER]
    np.testing.assert_allclose(_layer(page, "residual", 3), residual[3], atol=2e-4)
    pooled = residual.sum(axis=0) / np.sqrt(len(BANDS))
    np.testing.assert_allclose(_layer(page, "residual"), pooled, atol=5e-4)


def test_the_pictures_hold_the_figures_of_the_metrics(page, comparison):
    """chi2 of all and of a band, mean and largest colour differences, and pixels left out, from what is shown."""
    written = metrics(comparison, fake_run())
    for layer in ("delta_e_ab", "delta_e_2000"):
        image = _layer(page, layer)
        assert np.nanmean(image) == pytest.approx(written[layer]["mean"], rel=1e-4)
        assert np.nanmax(image) == pytest.approx(written[layer]["max"], rel=1e-3)
    squares = [np.nansum(_layer(page, "residual", i) ** 2) for i in range(len(BANDS))]
    assert sum(squares) / written["residuals"] == pytest.approx(written["chi2_per_dof"], rel=1e-4)
    band = written["bands"][BANDS[ORDER[1]]]
    assert squares[1] / band["residuals"] == pytest.approx(band["chi2_per_dof"], rel=1e-4)
    assert np.sum(_layer(page, "masks") > 0) == written["masked"]["lamp"]


def test_srgb_is_that_of_the_files(page, comparison):
    page.run("v.set({band: -1, exposure: 0})")
    rgba = np.array(page.run("Array.from(v._paintedLayer('measured').rgba)")).reshape(BOX.size, BOX.size, 4)
    expected = srgb_preview(comparison.maps["xyz_measured"].values, comparison.white)
    assert np.abs(rgba[..., :3] - expected.astype(int)).max() <= 1
    page.run("v.set({exposure: -1})")
    assert "Photograph, sRGB, −1.0 stops" in page.run("document.querySelector('figcaption').textContent")
    darker = np.array(page.run("Array.from(v._paintedLayer('measured').rgba)")).reshape(BOX.size, BOX.size, 4)
    halved = srgb_preview(0.5 * comparison.maps["xyz_measured"].values, comparison.white)
    assert np.abs(darker[..., :3] - halved.astype(int)).max() <= 1


def test_masks_by_reason(page):
    masks = _layer(page, "masks")
    np.testing.assert_array_equal(masks > 0, BOX.lamp)
    assert f"lamp: {BOX.lamp.sum()}\xa0px" in page.run("document.querySelector('.cbv-legend').innerText")
    page.click(*_at(page, 1, *np.argwhere(BOX.lamp)[0][::-1]))
    assert "saturated, lamp" in page.run("document.querySelector('.cbv-pixel').innerText")


def _colour(page, canvas, x, y):
    """RGBA that a canvas shows at the centre of pixel (x, y), read from a copy."""
    at = f"x = {x}, y = {y}, c = document.querySelectorAll('canvas')[{canvas}]"
    return page.run(
        f"(() => {{ const {at}, k = c.width / {BOX.size}, copy = new OffscreenCanvas(1, 1).getContext('2d');"
        "copy.drawImage(c, -Math.floor((x + .5) * k), -Math.floor((y + .5) * k));"
        "return Array.from(copy.getImageData(0, 0, 1, 1).data) })()"
    )


def test_slider_shows_a_left_and_b_right_of_the_line(page):
    """A photograph, B the difference: right of the line is what C shows there, left of it is not."""
    page.run("v.set({b: 'residual', split: 50})")
    assert _colour(page, 0, 40, 20) == _colour(page, 1, 40, 20)
    assert _colour(page, 0, 8, 20) != _colour(page, 1, 8, 20)
    line, right_pixel = _at(page, 0, 23.5, 20), _at(page, 0, 44, 20)
    page.drag(line, right_pixel)
    assert page.run("v.state.split") == pytest.approx(100 * 44.5 / 48, abs=0.5)
    assert _colour(page, 0, 40, 20) != _colour(page, 1, 40, 20)


def test_slider_by_keyboard_moves_at_least_one_percent(page):
    page.run("document.querySelector('input[data-cbv=split]').focus()")
    page.key("ArrowRight")
    assert page.run("v.state.split") == 51
    page.run("document.querySelector('canvas').focus()")
    page.key(",")
    assert page.run("v.state.split") == 50


def test_flip(page):
    page.run("v.set({mode: 'flip', b: 'residual'})")
    before = _colour(page, 0, 20, 20)
    page.run("document.querySelector('button[data-cbv=flip]').click()")
    assert _colour(page, 0, 20, 20) == _colour(page, 1, 20, 20) != before
    page.run("document.querySelector('canvas').focus()")
    page.key("f")
    assert _colour(page, 0, 20, 20) == before


def test_zoom_is_linked_and_a_click_finds_its_pixel(page):
    page.run("v.set({mode: 'side', pixel: [10, 30]})")
    for _ in range(4):
        page.run("document.querySelector('button[data-cbv=in]').click()")
    zoom = page.run("v.state.zoom")
    assert zoom == pytest.approx(1.5**4)
    # the marked pixel stays in place: 10.5 of 48 from the left in every picture
    for canvas in range(3):
        page.click(*_at(page, canvas, 10, 30))
        assert page.run("v.state.pixel") == [10, 30]
    # one pixel to the right is zoom times as far
    page.click(*_at(page, 1, 10 + zoom, 30))
    assert page.run("v.state.pixel") == [11, 30]
    page.key("0")
    assert page.run("v.state.zoom") == 1


@pytest.mark.parametrize("zoom", [1, 3])
def test_axes_number_the_pixels_at_their_centres(page, zoom):
    """A pixel's centre (n + 0.5) lies zoom times its distance from the view's centre, in shares of 48 px, off 50 %."""
    page.run(f"v.set({{mode: 'side', zoom: {zoom}, x: 24, y: 28}})")
    centres = (24, 24 if zoom == 1 else 28)
    for axis, marks in enumerate(("across", "down")):
        outcome = page.run(
            f"[...document.querySelectorAll('.cbv-{marks} span')].map("
            "e => [parseInt(e.textContent), parseFloat(e.style.left || e.style.top)])"
        )
        assert len(outcome) >= 3 * 2
        for number, percent in outcome:
            assert percent == pytest.approx(50 + 100 * zoom * (number + 0.5 - centres[axis]) / 48, abs=0.1)


def test_numbers_stand_within_their_pixels(page):
    page.run(
        "globalThis.texts = []; globalThis.draw = CanvasRenderingContext2D.prototype.fillText;"
        "CanvasRenderingContext2D.prototype.fillText = function (text, x, y, width) {"
        "  texts.push([text, Math.min(this.measureText(text).width, width ?? Infinity)]);"
        "  return draw.call(this, text, x, y, width); }; null"
    )
    page.run("v.picture.xyz_per_dn = v.picture.xyz_per_dn.map((row) => row.map((weight) => weight / 10)); null")
    page.run("v.set({mode: 'side', c: 'residual', band: -1})")
    cell = 46.5  # hardly larger than where numbers begin
    zoom = cell * BOX.size / page.run("document.querySelector('canvas').clientWidth")
    page.run(f"v.set({{zoom: {zoom}, x: 24, y: 28}})")
    texts = page.run("texts")
    page.run("CanvasRenderingContext2D.prototype.fillText = draw; null")
    assert len(texts) > 50 and max(width for _, width in texts) < cell
    assert any(text.startswith("Y ") for text, _ in texts)


def test_wheel_zooms_about_the_pointer_and_dragging_moves(page):
    """Ctrl + wheel: the pixel under the pointer stays there. A drag by a quarter of the width moves by a quarter."""
    pixel = _at(page, 0, 12, 12)
    event = {"type": "mouseWheel", "x": pixel[0], "y": pixel[1], "deltaX": 0, "modifiers": 2}
    page.call("Input.dispatchMouseEvent", deltaY=-300, **event)
    page.until("v.state.zoom === 2")
    page.click(*pixel)
    assert page.run("v.state.pixel") == [12, 12]
    before = page.run("v.state.x")
    start = _at(page, 1, 12, 24)
    page.drag(start, (start[0] - 12 * (_at(page, 1, 1, 0)[0] - _at(page, 1, 0, 0)[0]), start[1]))
    assert page.run("v.state.x") - before == pytest.approx(12 / 2, abs=0.1)
    # without Ctrl and without the focus the wheel scrolls the page
    page.run("v.set({zoom: 1}), document.activeElement.blur()")
    page.call("Input.dispatchMouseEvent", deltaY=-300, **{**event, "modifiers": 0})
    assert page.run("new Promise((done) => setTimeout(() => done(v.state.zoom), 100))") == 1


def test_arrow_keys_mark_pixels_and_show_their_values(page):
    page.run("v.select(20, 20); document.querySelector('canvas').focus()")
    page.key("ArrowRight")
    page.key("ArrowDown")
    assert page.run("v.state.pixel") == [21, 21]
    assert "Pixel 21, 21" in page.run("document.querySelector('[role=status]').textContent")


def test_new_predictions_live(page):
    other = BOX.compare(seed=4, factor=1.1)
    page.run("v.select(20, 20)")
    data = picture_data(other, NM)
    page.run(f"v.update({json.dumps({name: data[name] for name in ('rendered', 'sigma')})})")
    residual = other.maps["residual_over_sigma"].values[ORDER]
    # measured pixels are still the first comparison's
    now = _layer(page, "residual", 2)
    measured = BOX.compare(seed=4, factor=1.02).maps["measured"].values[ORDER][2]
    expected = (measured - other.maps["rendered"].values[ORDER][2]) / other.maps["sigma"].values[ORDER][2]
    np.testing.assert_allclose(now[~BOX.lamp], expected[~BOX.lamp], atol=5e-4)
    assert residual.shape[0] == len(BANDS)


def test_scales_are_fixed_until_switched(page):
    def ends():
        return page.run("(() => { const s = v._paintedLayer('residual').scale; return [s.low, s.high] })()")

    page.run("v.set({c: 'residual', band: 0})")
    assert ends() == [-5, 5]
    page.run("v.set({scale: 'fine'})")
    assert ends() == [-1, 1]


def test_a_large_picture_stays_small(comparison):
    """Two million noisy numbers take less than 9 MB; more are shown as means of blocks, with the sigma of a mean."""
    generator = np.random.default_rng(0)
    shape = (5, 640, 640)
    stack = ("band", "y", "x")
    maps = xr.Dataset(
        {
            "measured": (stack, generator.normal(1000, 30, shape)),
            "rendered": (stack, generator.normal(1000, 9, shape)),
            "sigma": (stack, np.full(shape, 30.0)),
            "mask": (stack, np.zeros(shape, np.uint8)),
            "surface": (stack[1:], np.zeros(shape[1:], np.int16)),
        }
    )
    data = picture_data(replace(comparison, maps=maps))
    assert data["block"] == 1
    assert sum(len(data[name]["data"]) for name in ("measured", "rendered", "sigma")) < 9e6
    larger = maps.pad(x=(0, 160), y=(0, 160), mode="edge")
    data = picture_data(replace(comparison, maps=larger))
    assert (data["block"], data["width"], data["height"]) == (2, 400, 400)
    assert data["sigma"]["offset"] == pytest.approx([15.0] * 5)


def test_numbers_that_are_many_are_stored_in_sixteen_bits(page):
    generator = np.random.default_rng(1)
    values = generator.normal(500, 100, (2, 600, 450))
    values[1] *= 3
    values[0, 3, 4] = np.nan
    stored = encoded(values)
    assert stored["type"] == "u2"
    page.run(f"v.update({{maps: [{{id: 'm', name: 'm', values: {json.dumps(stored)}}}]}})")
    back = np.array(page.run("Array.from(v.picture.maps[0].values, (n) => Number.isNaN(n) ? null : n)"), float).reshape(
        values.shape
    )
    span = np.nanmax(values, axis=(1, 2)) - np.nanmin(values, axis=(1, 2))
    assert np.isnan(back[0, 3, 4]) and np.isnan(back).sum() == 1
    for plane in (0, 1):
        assert np.nanmax(np.abs(back[plane] - values[plane])) < span[plane] / 120000
