"""Things in one place: where they are looked for, and the odds of what they are."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.explain import explain
from cboxlab.validation.diagnose.explain.prior_odds import spot_log_odds
from cboxlab.validation.diagnose.families import families
from cboxlab.validation.diagnose.field_fit import FitInput, hot_spot, hot_spot_of_one_band
from helpers.captures.small_excess import BANDS, COLUMNS, FLOOR, ROWS, SIGNAL, SIZE, small_excess


def _spot(x, y, radius):
    return np.exp(-((COLUMNS - x) ** 2 + (ROWS - y) ** 2) / (2 * radius**2))


def _sensor_forms(excess, spot, spot_of_one_band):
    """All offsets and gains on the sensor."""
    fit_input = FitInput(excess, spot, spot_of_one_band)
    return [form for family in families().values() if family.acts_on == "sensor" for form in family.generate(fit_input)]


def _scene_forms(excess):
    """All forms in the scene."""
    fit_input = FitInput.of(excess)
    return [form for family in families().values() if family.acts_on == "scene" for form in family.generate(fit_input)]


def test_a_spot_of_one_band_is_found_next_to_a_denser_one_of_all_bands():
    of_one = 70.0 * _spot(12, 10, 2) * np.eye(BANDS)[1][:, None, None]
    excess = small_excess(of_one + 80.0 * _spot(36, 20, 2))
    everywhere, alone = hot_spot(excess), hot_spot_of_one_band(excess)
    assert everywhere[20, 36] and not everywhere[10, 12]
    assert alone[10, 12] and not alone[20, 36]


def test_where_one_band_is_off_nothing_is_fitted_to_all_bands():
    excess = small_excess(70.0 * _spot(12, 10, 2) * np.eye(BANDS)[1][:, None, None])
    spot = hot_spot_of_one_band(excess)
    alone, both = (
        [form for form in _sensor_forms(excess, *spots) if form.local] for spots in ((None, spot), (spot, spot))
    )
    assert {form.form for form in alone} == {"a spot in one band"}
    assert {form.form for form in both} == {"a spot", "a spot in one band"}


@pytest.mark.parametrize("sign", [1, -1])
def test_an_offset_is_likely_where_it_adds_counts_at_the_border_of_the_picture(sign):
    def odds(x, y):
        excess = small_excess(np.broadcast_to(sign * 60.0 * _spot(x, y, 3), (BANDS, SIZE, SIZE)))
        forms = _sensor_forms(excess, hot_spot(excess), None)
        glow = next(f for f in forms if (f.family.id, f.form) == ("sensor-offset", "a spot"))
        return spot_log_odds(excess, glow, soft=True)

    corner, inside = odds(0, SIZE - 1), odds(20, 20)
    assert inside < corner
    assert (corner == 0) == (sign == 1)


def test_a_stain_is_seen_in_more_than_one_band():
    def odds(bands, form):
        excess = small_excess(-0.08 * SIGNAL * _spot(20, 20, 3) * bands[:, None, None])
        forms = _sensor_forms(excess, hot_spot(excess), None)
        gain = next(f for f in forms if (f.family.id, f.form) == ("sensor-gain", form))
        return spot_log_odds(excess, replace(gain, family=families()["reflectance-map"]), soft=False)

    assert odds(np.eye(BANDS)[2], "a spot in one band") < odds(np.ones(BANDS), "a spot") == 0


def test_light_makes_no_place_darker():
    def odds(shape):
        excess = small_excess(np.broadcast_to(60.0 * shape, (BANDS, SIZE, SIZE)))
        forms = _sensor_forms(excess, hot_spot(excess), None)
        added = next(f for f in forms if (f.family.id, f.form) == ("sensor-offset", "a spot"))
        return spot_log_odds(excess, replace(added, family=families()["reflection-lobe"]), soft=True)

    bulge = _spot(22, 15, 3) - 0.8 * _spot(22, 22, 3)  # lit on one side, turned from the light on the other
    assert odds(bulge) < odds(_spot(22, 18, 3)) == 0


def _line(x_of_row, depth, end=44):
    """(y, x) part of each pixel that a thin line before wall and floor covers, down to a row."""
    at = x_of_row(ROWS[:, :1].astype(float))
    return depth * np.clip(1 - np.abs(COLUMNS - at), 0.0, 1.0) * (ROWS > 18) * (ROWS < end)


@pytest.mark.parametrize(
    ("x_of_row", "end", "family"),
    [
        (lambda y: 30 - 0.08 * y, 44, "object"),  # a thread
        (lambda y: 30 + 0 * y, 44, "object"),  # a wire that hangs
        (lambda y: 30 + 0 * y, SIZE, "sensor-gain"),  # a column from a trap on
        (lambda y: 20 + 0.02 * (y - 31) ** 2, 44, "sensor-gain"),  # a bent hair
    ],
)
def test_a_thin_straight_line_is_a_thing_in_the_scene_but_for_a_column_up_to_a_side(x_of_row, end, family):
    line = _line(x_of_row, 0.12, end)
    explanation = explain(small_excess(line * (100.0 - SIGNAL)))
    assert explanation.family == family
    assert explanation.share > 0.8


def test_a_bump_that_is_lit_on_one_side_is_no_light():
    bulge = _spot(22, 15, 3) - 0.8 * _spot(22, 22, 3)
    explanation = explain(small_excess(0.06 * bulge * SIGNAL))
    assert (explanation.family, explanation.surface) == ("reflectance-map", "wall")
    assert "bump" in explanation.form


def test_a_thin_straight_line_in_one_band_alone_is_on_that_bands_filter():
    line = _line(lambda y: 30 - 0.08 * y, 0.22)
    explanation = explain(small_excess(-line * SIGNAL * np.eye(BANDS)[2][:, None, None]))
    assert (explanation.family, explanation.bands) == ("sensor-gain", ("b2",))


def test_a_primer_that_shows_through_paint_is_no_light():
    """In the blue the place is many times brighter, as no light without any red would make it."""
    excess = small_excess(np.zeros(SIGNAL.shape))
    red, white = np.array([0.05, 0.08, 0.4, 0.6]), np.full(BANDS, 0.7)
    transport = replace(excess.transport, reflectance=np.array([red, white]))
    primer = 0.3 * _spot(33, 38, 3) * FLOOR * (white / red - 1)[:, None, None]
    explanation = explain(replace(small_excess(SIGNAL * primer), transport=transport))
    assert (explanation.family, explanation.form, explanation.surface) == (
        "reflectance-map",
        "the paint pale shows",
        "floor",
    )
    assert explanation.field.spectrum[3] == pytest.approx((0.7 / 0.6 - 1) / (0.7 / 0.05 - 1), rel=1e-3)


def test_a_dark_rod_is_no_coat_however_strong_it_is():
    """Coats have fewer numbers than an outline and a radiance, by more the more there is to explain."""
    rod = np.clip(1.6 - np.abs(COLUMNS - 25 - 0.05 * ROWS), 0, 1) * (ROWS > 14) * (ROWS < 26)
    excess = small_excess(0.6 * rod * (60.0 - SIGNAL))
    coats = [f for f in _scene_forms(excess) if f.local and f.mirrored_dn is not None]
    assert coats
    assert all(spot_log_odds(excess, coat, soft=False) == -coat.fit.gain for coat in coats)


@pytest.mark.parametrize("family", ["extra-light", "object"])
def test_a_bright_place_with_its_surfaces_colour_is_lit_and_another_is_a_thing(family):
    """Both have outlines. Daylight on a red floor leaves it red; an object there has another colour."""
    excess = small_excess(np.zeros(SIGNAL.shape))
    red, white = np.array([0.05, 0.08, 0.4, 0.6]), np.full(BANDS, 0.7)
    transport = replace(excess.transport, reflectance=np.array([red, white]))
    region = (np.abs(ROWS - 36) < 3) & (np.abs(COLUMNS - 22) < 8)
    daylight = 0.5 * (excess.nm / 550) ** -3
    grey = 0.7 * 0.8 / red - 1
    more = {"extra-light": daylight, "object": np.minimum(grey, 4.0)}[family]
    explanation = explain(replace(small_excess(SIGNAL * region * more[:, None, None]), transport=transport))
    assert explanation.family == family


@pytest.mark.parametrize(("part", "family"), [(0.5, "object"), (2.5, "extra-light")])
def test_no_thing_is_much_brighter_than_a_white_one(part, family):
    """On paint of 0.7, in the light's own colour, a thing would need a reflectance of 1.05 or 2.45."""
    region = (np.abs(ROWS - 16) < 5) & (np.abs(COLUMNS - 34) < 5)
    assert explain(small_excess(part * SIGNAL * region)).family == family


@pytest.mark.parametrize(("blue", "family"), [(0.05, "extra-light"), (-0.05, "reflectance-map")])
def test_a_place_that_is_darker_in_some_bands_has_another_paint(blue, family):
    """Brighter in all bands it may be lit, and paint is the runner-up."""
    region = (np.abs(ROWS - 16) < 5) & (np.abs(COLUMNS - 34) < 5)
    change = np.array([blue, blue, 0.1, 0.1])
    explanation = explain(small_excess(SIGNAL * region * change[:, None, None]))
    assert explanation.family == family


@pytest.mark.parametrize("spectrum", [np.full(BANDS, 0.2), np.array([0.4, 0.2, 0.1, 0.05])])
def test_a_stain_has_a_spectrum_only_where_it_shows_one(spectrum):
    """One number for each band further is paid for; grey dirt does not need them."""
    excess = small_excess(-SIGNAL * _spot(33, 40, 3) * spectrum[:, None, None])
    stain = next(f for f in _scene_forms(excess) if f.form == "a stain")
    sizes = np.abs(stain.fit.coefficients).max(axis=1)
    assert sizes / sizes[0] == pytest.approx(spectrum / spectrum[0], rel=0.15)
    assert (np.ptp(sizes) == 0) == (np.ptp(spectrum) == 0)


def test_light_through_a_seam_that_shows_on_one_wall_alone_is_no_stain():
    """Next to a corner the searched place has a part of the floor, too, whose numbers light need not pay for."""
    line = np.exp(-np.abs(ROWS - 29.0)) * ~FLOOR * (np.abs(COLUMNS - 30) < 9)
    explanation = explain(small_excess(SIGNAL * line * np.array([0.5, 0.2, 0.1, 0.06])[:, None, None]))
    assert (explanation.family, explanation.surface) == ("extra-light", "wall")
    assert explanation.runner_up == "reflectance-map" and not explanation.told_apart


@pytest.mark.parametrize(
    ("parts", "likelier"),
    [((0.08, 0.07, 0.065, 0.06), "reflectance-map"), ((0.12, 0.09, 0.05, 0.02), "extra-light")],
    ids=["fresh paint", "bluer light"],
)
def test_other_light_has_another_colour_and_fresh_paint_brightens_all_bands_alike(parts, likelier):
    excess = small_excess(np.reshape(parts, (BANDS, 1, 1)) * SIGNAL * _spot(20, 20, 3))
    forms = _scene_forms(excess)
    odds = {form.family.id: spot_log_odds(excess, form, soft=False) for form in forms if form.local}
    assert odds[likelier] == 0 > min(odds["reflectance-map"], odds["extra-light"])
