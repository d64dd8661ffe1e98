"""FLIP in the viewer: by its evaluator, and one line where that is not installed."""

import csv
import io
import sys

import numpy as np
import pytest
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare import White
from cboxlab.validation.report.viewer import picture_data, viewer_fragment
from cboxlab.validation.report.viewer.flip import flip_map
from helpers.fakes.box import FakeBox
from helpers.pages.browser import open_browser

WHITE = White(0.3127, 0.3290, 100.0)
GREY = np.broadcast_to(50 * np.array([0.9505, 1.0, 1.089]), (24, 32, 3))


def test_flip_is_zero_for_equal_pictures_and_grows_where_they_differ():
    pytest.importorskip("flip_evaluator")
    assert np.abs(flip_map(GREY, GREY, WHITE)).max() < 1e-6
    changed = GREY.copy()
    changed[:, 16:] *= 1.2
    stronger = GREY.copy()
    stronger[:, 16:] *= 1.6
    first, second = flip_map(GREY, changed, WHITE), flip_map(GREY, stronger, WHITE)
    assert first.shape == (24, 32) and first[:, 24:].min() > 0.03
    assert first[:, 24:].mean() > 5 * first[:, :8].mean()
    assert second[:, 24:].mean() > 1.5 * first[:, 24:].mean() and second.max() <= 1


def test_pixels_left_out_have_no_flip_and_change_none():
    pytest.importorskip("flip_evaluator")
    measured = GREY.copy()
    measured[5, 6] = np.nan
    values = flip_map(measured, GREY, WHITE)
    assert np.isnan(values[5, 6]) and np.nanmax(values) < 1e-6


def test_without_the_evaluator_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(InputError, match=r"cboxlab\[flip\]"):
        flip_map(GREY, GREY, WHITE)


def test_the_viewer_shows_flip_and_drops_it_with_another_rendering(tmp_path):
    pytest.importorskip("flip_evaluator")
    comparison = FakeBox(size=48).compare(seed=4, factor=1.1)
    data = picture_data(comparison)
    file = tmp_path / "viewer.html"
    head = '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"/></head><body>'
    file.write_text(f"{head}{viewer_fragment(data, 'v')}</body></html>", encoding="utf-8")
    option = "document.querySelector('[data-cbv=c] option[value=flip]')"
    with open_browser() as page:
        page.open(file)
        page.run("globalThis.v = document.getElementById('v').viewer; v.ready.then(() => null)")
        page.run("v.set({c: 'flip', scale: 'coarse'})")
        assert page.run(f"[{option}.disabled, {option}.textContent]") == [False, "FLIP"]
        table = list(csv.DictReader(io.StringIO(page.run("v.csv('panes')"))))
        column = next(name for name in table[0] if "FLIP" in name)
        values = np.array([float(row[column] or "nan") for row in table])
        signals = [np.moveaxis(comparison.maps[name].values, 0, -1) for name in ("measured", "rendered")]
        out = (comparison.maps["mask"].values != 0).any(axis=0)
        xyz = [np.where(out[..., None], np.nan, signal @ comparison.xyz_per_dn.T) for signal in signals]
        expected = flip_map(*xyz, comparison.white).ravel()
        assert np.array_equal(np.isnan(values), np.isnan(expected)) and np.nanmax(values) > 0.01
        np.testing.assert_allclose(values, expected, atol=1e-3)
        page.run("v.update({rendered: v.picture.measured.slice(), sigma: v.picture.sigma})")
        assert page.run(f"[{option}.disabled, {option}.textContent]") == [
            True,
            "FLIP: of another rendering; see its report",
        ]
        assert page.errors == []
