"""Effects against forms of unlisted causes: blurs, leaks of a filter, levels in the order of time."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.explain import lead_of_forms, rival_forms
from helpers.captures.small_excess import FLOOR, SIGNAL, small_excess
from scipy.ndimage import correlate

#: Chi2 that one number must gain.
PRICE = 4.6

#: Exchange with all four neighbours, and with those along the rows, per unit.
ROUND = np.array([[[0, 1, 0], [1, -4, 1], [0, 1, 0]]]) / 4
LINE = np.array([[[0, 0, 0], [1, -2, 1], [0, 0, 0]]]) / 2

#: Pictures whose floor is redder than the wall.
COLOURED = SIGNAL * np.where(FLOOR, np.array([0.5, 0.8, 1.2, 1.8])[:, None, None], 1.0)


def _best_form(data, shape, averaging=0.0, on_things=False):
    """Best form over an effect of one number with this shape (band, y, x), DN, at its best amplitude."""
    change = data.whitened(shape)
    amplitude = np.sum(change * data.residual) / np.sum(change**2)
    together = (data.residual - amplitude * change)[data.used]
    return lead_of_forms(data, together, PRICE, averaging, 0.01, on_things)


def _lead(data, shape):
    """Lead of the best form over such an effect."""
    return _best_form(data, shape).lead


@pytest.mark.parametrize(("kernel", "imitates"), [(ROUND, False), (LINE, True)])
def test_a_camera_that_shook_is_no_crosstalk(kernel, imitates):
    """Charge goes to all four neighbours alike; a shaken camera moves light along one line."""
    data = small_excess(0.2 * correlate(SIGNAL, kernel, mode="nearest"))
    lead = _lead(data, correlate(SIGNAL, ROUND, mode="nearest"))
    assert lead > 0 if imitates else lead < -20


@pytest.mark.parametrize("leaks", [False, True])
def test_a_filter_that_leaks_is_no_paint_that_glows(leaks):
    """A leak shows on every paint by its reflectance beyond the band; a glow on one paint alone."""
    glow, leak = np.zeros_like(SIGNAL), np.zeros_like(SIGNAL)
    glow[0] = np.where(FLOOR, COLOURED[2] * (1 + 0.4 * np.sin(np.arange(48) / 6)), 0)
    leak[0] = COLOURED[3]
    data = replace(small_excess(0.05 * (leak if leaks else glow)), signal=COLOURED)
    lead = _lead(data, glow)
    assert lead > 0 if leaks else lead < -20
    if leaks:
        assert rival_forms(data)[0].family.id == "filter-curve"


def test_noise_has_no_form():
    assert all(form.evidence < 10 for form in rival_forms(small_excess(np.zeros_like(SIGNAL))))


def test_an_effect_next_to_a_larger_leak_is_no_imitation():
    """The leak has more evidence than crosstalk alone, but crosstalk gains as much next to it."""
    leak = np.zeros_like(SIGNAL)
    leak[0] = 0.3 * COLOURED[3]
    shape = correlate(COLOURED, ROUND, mode="nearest")
    data = replace(small_excess(leak + 0.2 * shape), signal=COLOURED)
    assert rival_forms(data)[0].family.id == "filter-curve"
    assert _lead(data, shape) < -20


def _behind_mosaic(excess):
    """Data of four channels: each sees every second pixel of every second row."""
    rows, columns = np.indices(SIGNAL.shape[1:])
    used = (2 * (rows % 2) + columns % 2)[None] == np.arange(4)[:, None, None]
    data = small_excess(excess)
    hidden = {"residual": data.residual * used, "marginal_residual": data.marginal_residual * used}
    return replace(data, signal=COLOURED, used=used, nuisances=data.nuisances * used[..., None], **hidden)


@pytest.mark.parametrize("dyes", [False, True])
def test_other_sensitivities_of_the_channels_are_no_paint_that_glows(dyes):
    """Dyes that pass the light of others show in all channels, on every paint by its colour there."""
    glow = np.where(FLOOR, COLOURED[2] * (1 + 0.4 * np.sin(np.arange(48) / 6)), 0)
    glow = glow * np.array([1.0, 0.3, 0.0, 0.0])[:, None, None]
    mixed = np.array([1.0, 0.5, 0.3, 0.0])[:, None, None] * COLOURED[3]
    data = _behind_mosaic(0.1 * (mixed if dyes else glow))
    lead = _lead(data, glow)
    assert lead > 0 if dyes else lead < -20
    if dyes:
        assert "all channels" in rival_forms(data)[0].form


@pytest.mark.parametrize("leaks", [(0, 1, 0, 0), (1, 0.6, 1.3, 0.8)])
def test_a_second_pass_band_of_colour_filters_is_found_at_its_wavelength(leaks):
    """Light of 540 nm, by a third paint on the right half that no channel's own picture shows."""
    lines = small_excess(np.zeros_like(SIGNAL)).transport.lines
    leak = 0.06 * 1000 * np.array(leaks)[:, None, None] * lines[1]
    every = rival_forms(_behind_mosaic(leak))
    in_all = next(form for form in every if form.form == "light of 540 nm in all channels")
    in_one, other, *_ = [form for form in every if "all channels" not in form.form]
    if all(leaks):
        assert in_all is every[0] and in_all.evidence > in_one.evidence + 20
        size = np.sqrt(in_all.fit.size / np.array(leaks) ** 2)
        assert size.max() < 1.5 * size.min()
    else:
        assert in_one.form == "light of 540 nm in b1" and in_one.evidence > other.evidence + 20
        assert in_all.fit.size.argmax() == 1
    assert not any(" nm in " in form.form for form in rival_forms(small_excess(leak)))


def test_charge_that_goes_from_colour_to_colour_is_crosstalk():
    """Other sensitivities do nearly the same to even surfaces, with many more numbers."""
    used = _behind_mosaic(np.zeros_like(SIGNAL)).used
    raw = np.sum(np.where(used, COLOURED, 0), axis=0)
    shape = np.broadcast_to(correlate(raw, ROUND[0], mode="nearest"), SIGNAL.shape)
    assert _lead(_behind_mosaic(0.02 * shape), shape) < -10


def _levels(levels):
    return SIGNAL * np.array(levels)[:, None, None]


@pytest.mark.parametrize("steps", [False, True])
def test_a_step_of_the_gain_is_no_shutter_that_opens_late(steps):
    """Exposures that shorten from band to band make both look alike; each has its own levels of the bands."""
    late, step = _levels([0.001, 0.004, 0.009, 0.018]), _levels([0.0, 0.0, 0.015, 0.015])
    lead = _lead(small_excess(step if steps else late), late)
    assert lead > 0 if steps else lead < 0


def test_the_same_levels_in_other_words_are_no_rival():
    """One band's level is a step of the last band, too: nothing distinguishes them, and the effect is named."""
    last = _levels([0.0, 0.0, 0.0, 0.02])
    data = small_excess(last)
    best = _best_form(data, last)
    assert best.lead < -9.2
    assert best.form != rival_forms(data)[0].form


def test_what_an_effect_gains_by_averaging_noise_is_not_its_evidence():
    shape = correlate(SIGNAL, ROUND, mode="nearest")
    data = small_excess(0.2 * shape)
    assert _best_form(data, shape, averaging=10.0).lead == pytest.approx(_lead(data, shape) + 10, abs=1e-6)


def test_a_paint_and_a_filter_of_one_pattern_are_two_causes():
    """In one band both add the same light: the paint has no evidence over the filter, and the form is shown."""
    last = _levels([0.0, 0.0, 0.0, 0.02])
    data = small_excess(last)
    best = _best_form(data, last, on_things=True)
    assert best.form == rival_forms(data)[0].form
    assert -9.2 < best.lead < 9.2
