"""Patterns, profiles, earlier pictures and small pictures, against the study's own predictions."""

import numpy as np
import pytest
from cboxlab.calibration.instrument import band_centres
from helpers.pages.studio import add, chi2, finished, present, press, record_of, step


def test_the_pattern_of_an_effect_that_is_not_added(client, bench):
    record, numbers = record_of(client.post("/secret/api/pattern", json={"effect": "veiling-glare"}))
    assert [each["name"] for each in record["numbers"]] == ["fraction"] and bench.study.effects == ()
    without = bench.study.predictions()[0]
    added = bench.study.add("veiling-glare", fraction=record["numbers"][0]["value"]).predictions()[0]
    order = np.argsort(band_centres(bench.study.prepared[0].responses))
    expected = ((added.signal - without.signal) / without.sigma)[order]
    np.testing.assert_allclose(numbers.reshape(7, 32, 32), expected, atol=1e-5)
    assert np.percentile(np.abs(numbers), 99) == pytest.approx(3.0, rel=0.1)


def test_chi_square_over_a_number_holds_until_anything_else_changes(client, bench):
    step(client, "add", effect="veiling-glare", values={"fraction": 0.01})
    finished(client, "profile", effect=0, parameter="fraction", revision=present(client))
    profile = client.get("/secret/api/state").json()["profile"]
    assert (profile["which"], profile["name"], profile["values"][0]) == (0, "fraction", 0.0)
    at_present = profile["chi2_per_dof"][profile["values"].index(0.01)]
    assert at_present == pytest.approx(bench.prediction.chi2.per_dof)
    assert profile["chi2_per_dof"][0] == pytest.approx(
        bench.study.change(0, fraction=0.0).predictions()[0].chi2.per_dof
    )
    moved, _ = step(client, "change", which=0, values={"fraction": 0.004}, commit=True)
    assert moved["profile"] == profile
    assert step(client, "add", effect="ghost")[0]["profile"] is None


def test_earlier_pictures_leave_the_study_as_it_is(client, bench):
    first = step(client, "add", effect="veiling-glare", values={"fraction": 0.02})[0]
    step(client, "change", which=0, values={"fraction": 0.01}, commit=True)
    before, numbers = record_of(client.post("/secret/api/earlier", json={"first": False}))
    assert before["chi2_per_dof"] == pytest.approx(first["chi2_per_dof"]) and numbers.size == 2 * 7 * 32 * 32
    opened, _ = record_of(client.post("/secret/api/earlier", json={"first": True}))
    first_effects = bench.study.history.states[0].effects
    expected = bench.study.with_effects(first_effects).predictions()[0].chi2.per_dof
    assert opened["chi2_per_dof"] == pytest.approx(expected, rel=1e-3)
    assert bench.study.effects[0].values["fraction"] == 0.01 and not bench.study.history.can_redo


def test_a_pattern_a_flip_and_a_curve_are_shown_and_put_away(page, bench):
    pixel = "JSON.stringify(page.viewer.values(16, 20).bands.map((b) => b.rendered))"
    opened = page.run(pixel)
    page.run("document.getElementById('new-effect').value = 'veiling-glare'")
    press(page, "pattern")
    page.until("document.getElementById('pattern-words').textContent.includes('veiling-glare, fraction')")
    assert page.run("page.viewer.state.b") == "pattern-fraction" and bench.study.effects == ()
    assert "σ; red: brighter with the effect" in page.run("document.getElementById('viewer').innerText")
    add(page, "veiling-glare")
    assert page.run("page.viewer.state.b") == "rendered" and not page.run("page.viewer.picture.maps.length")
    page.run("move({which: 0, values: {fraction: 0.01}, commit: true})")
    page.until("page.record.effects[0].values.fraction === 0.01 && !page.asking")
    present_pixel = page.run(pixel)
    press(page, "before")
    page.until("document.getElementById('earlier').textContent.includes('before the last change')")
    assert page.run(pixel) != present_pixel and page.run("page.record.effects[0].values.fraction") == 0.01
    page.key("b")
    page.until("document.getElementById('earlier').textContent === ''")
    assert page.run(pixel) == present_pixel != opened
    page.run("document.querySelector('.parameter button.small').click()")
    page.until("document.querySelector('.profile svg') !== null && !page.job")
    assert "at the ends" in page.run("document.querySelector('.profile').innerText")
    page.run("document.getElementById('parts').open = true")
    page.until("document.querySelectorAll('#parts tbody tr').length === 14")
    per_band = page.run("[...document.querySelectorAll('#parts table')][0].innerText")
    assert "550\xa0nm" in per_band and "NaN" not in per_band


def test_difference_and_slider_are_in_view_together_on_a_telephone_and_use_a_wide_window(page):
    add(page, "veiling-glare")
    page.size(400, 800)
    page.run("document.querySelector('#effects input[type=range]').scrollIntoView({block: 'end'})")
    inside = (
        "['mini', 'glance-chi2', 'p-0-fraction'].every((id) => {const b = document.getElementById(id)"
        ".getBoundingClientRect(); return b.width > 0 && b.top >= 0 && b.bottom <= innerHeight})"
    )
    page.until(inside)
    page.size(1280)
    page.run("page.viewer.set({mode: 'side'}); page.viewer.select(16, 20)")
    widths = page.run("[...document.querySelectorAll('.cbv-panes figure')].map((f) => f.offsetWidth)")
    assert len(widths) == 3 and widths[2] > 1.9 * widths[0]  # the difference, with the pixel's panel open
    assert float(page.run("document.getElementById('glance-chi2').textContent")) == chi2(page)


def test_flip_follows_the_slider(page):
    """FLIP is asked for where it is shown, and is that of the present prediction."""
    pytest.importorskip("flip_evaluator")
    page.run("page.viewer.set({mode: 'side', c: 'flip'})")
    page.until("page.viewer.picture.flip !== null")
    before = page.run("[...page.viewer.picture.flip].filter(Number.isFinite).reduce((a, b) => a + b, 0)")
    add(page, "veiling-glare")
    page.run(
        "(() => {const n = document.querySelector('.parameter input[type=text]'); n.value = '0.05';"
        "n.dispatchEvent(new Event('change'))})()"
    )
    page.until("page.record.effects[0].values.fraction === 0.05 && page.requests === 0 && !page.asking")
    page.until("page.viewer.picture.flip !== null")
    after = page.run("[...page.viewer.picture.flip].filter(Number.isFinite).reduce((a, b) => a + b, 0)")
    assert after > 1.2 * before
    page.run("page.viewer.set({c: 'residual'})")
