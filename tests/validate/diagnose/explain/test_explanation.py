"""Which family explains a residual: causes with separate formulas, far above noise."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from cboxlab.utils.progress import Cancelled, ProgressReporter
from cboxlab.validation.diagnose.explain import NONE, competition, explain, motions
from cboxlab.validation.diagnose.families import families
from cboxlab.validation.report.explanation import explanation_record, explanation_sentence
from helpers.captures.small_excess import (
    BANDS,
    COAT,
    COLUMNS,
    EXPOSURE_S,
    FLOOR,
    INCIDENCE,
    ROWS,
    SIGMA,
    SIGNAL,
    SIZE,
    VIEW,
    small_excess,
)
from helpers.programs.manual_commands import described
from scipy.ndimage import gaussian_filter, shift

NOISE = np.random.default_rng(11)


def _spot(x, y, radius):
    return np.exp(-((COLUMNS - x) ** 2 + (ROWS - y) ** 2) / (2 * radius**2))


def _moved(by):
    return shift(SIGNAL, (0, 0, by), order=3, mode="nearest") - SIGNAL


def _motion():
    return (_moved(1) + _moved(-1)) / 6


CAUSES = {
    "sensor-offset": SIGMA * NOISE.normal(0, 1.0, (BANDS, SIZE, 1)),
    "sensor-gain": SIGNAL * NOISE.normal(0, 0.01, (1, 1, SIZE)),
    "blur": _motion(),
    "paint-spectrum": SIGNAL * FLOOR * np.array([0.0, 0.01, 0.04, -0.02])[:, None, None],
    "extra-light": 60.0 * _spot(40, 30, 6) * np.array([1.0, 0.9, 0.3, 0.1])[:, None, None],
    "object": np.where((abs(COLUMNS - 34) < 5) & (abs(ROWS - 36) < 5), 300.0 - SIGNAL, 0.0),
}


@pytest.mark.parametrize("family", CAUSES)
def test_a_cause_is_given_its_family(family):
    explanation = explain(small_excess(CAUSES[family]))
    assert explanation.family == family
    assert explanation.share > 0.7
    assert explanation.rivals[0].family == family
    assert explanation.runner_up != family


def test_a_cancelled_explanation_ends_on_both_threads(monkeypatch):
    """The thread that does not cancel ends at its next form, not after all of its thousand."""
    calls = []

    def slow(excess):
        for number in range(1000):
            calls.append(number)
            time.sleep(0.01)
            yield None

    stopping = ProgressReporter(lambda stage, done: None)
    stopping.cancel()
    blur = replace(families()["blur"], generate=slow)
    monkeypatch.setattr(competition, "families", lambda: {**families(), "blur": blur})
    with pytest.raises(Cancelled):
        explain(small_excess(CAUSES["blur"]), stopping)
    assert len(calls) < 1000


def _of_one_paint(change):
    """Floor and wall have the same paint, of reflectance 0.5; four fifths of their light come from the lamp."""
    excess = small_excess(change)
    return replace(excess, transport=replace(excess.transport, material=np.zeros(SIZE * SIZE, int)))


@pytest.mark.parametrize(
    "lobe", [0.1 * np.log(VIEW) + 0.08 * np.log(INCIDENCE), 0.2 * (1 - VIEW) ** 3, 0.16 * INCIDENCE**2]
)
def test_a_paint_that_is_matte_but_not_as_lamberts_is_a_lobe_on_all_of_its_surfaces(lobe):
    explanation = explain(_of_one_paint(500.0 * np.broadcast_to(lobe, SIGNAL.shape)))
    assert (explanation.family, explanation.field.acts) == ("reflection-lobe", "radiance")
    assert explanation.rivals[0].surface is None
    assert explanation.rivals[0].form == "the paint grey, not Lambertian"
    assert explanation.share > 0.8
    assert {surface.surface for surface in explanation.field.surfaces} == {"floor", "wall"}


def test_a_pattern_that_does_not_follow_the_angles_is_no_lobe():
    explanation = explain(_of_one_paint(SIGNAL * FLOOR * 0.03 * np.cos(np.pi * COLUMNS / 48)))
    assert explanation.family == "reflectance-map"


@pytest.mark.parametrize(
    ("family", "change", "phrase"),
    [
        ("sensor-offset", EXPOSURE_S[:, None, None] * np.ones(SIGNAL.shape), "grows with the exposure"),
        ("sensor-gain", (1 / EXPOSURE_S - 1 / 4)[:, None, None] * SIGNAL / 100, "shutter"),
    ],
)
def test_offsets_and_gains_by_the_time_of_exposure(family, change, phrase):
    """Rows that glow while a frame is exposed, and a slit that opens unevenly before photographs and flats."""
    rows = np.random.default_rng(5).normal(0, 1.0, (1, SIZE, 1))
    explanation = explain(small_excess(5 * rows * change))
    assert (
        explanation.family == family
        and phrase in explanation.form
        and explanation.told_apart
        and explanation.share > 0.9
    )


@pytest.mark.parametrize("where", [abs(COLUMNS - 36) + abs(ROWS - 36) < 7, FLOOR], ids=["film", "sheen"])
def test_a_mirroring_surface_is_recognised_by_the_mirrored_colours(where):
    explanation = explain(small_excess(np.where(where, 0.6 * (1000 * COAT - 0.14 * SIGNAL), 0.0)))
    assert explanation.family == "reflection-lobe" and "roughness 0.1" in explanation.form
    assert explanation.surface == "floor" and explanation.share > 0.7
    field = explanation.field
    assert field.surfaces[0].surface == "floor"
    mean = explanation.change[:, where].mean(axis=1)
    np.testing.assert_allclose(field.spectrum, mean / mean[np.argmax(np.abs(field.spectrum))], rtol=0.05, atol=0.02)


@pytest.mark.parametrize("factor", [-0.6, 5.0])
def test_no_film_mirrors_less_than_nothing_or_more_than_two_faces(factor):
    film = abs(COLUMNS - 36) + abs(ROWS - 36) < 7
    explanation = explain(small_excess(np.where(film, factor * (1000 * COAT - 0.14 * SIGNAL), 0.0)))
    assert explanation.family != "reflection-lobe"


def test_an_explanation_is_given_in_words_and_in_json():
    explanation = explain(small_excess(CAUSES["object"]))
    record = json.loads(json.dumps(explanation_record(explanation), allow_nan=False))
    assert (record["family"], record["runner_up"]) == ("object", explanation.runner_up)
    assert set(record["bands"]) <= set(record["relative_change"])
    sentence = explanation_sentence(explanation)
    assert "object" in sentence and "about pixel (34, 36)" in sentence
    assert set(record) == described("docs/reference/files.md", "explanation")
    assert explanation_record(None)["family"] == NONE


def test_a_family_that_is_not_likely_enough_is_not_named_and_its_change_stays():
    explanation = explain(small_excess(CAUSES["object"]))
    doubtful = replace(explanation, odds={**explanation.odds, "object": 0.4})
    assert (doubtful.named_if_likely().family, doubtful.named_if_likely().field) == (NONE, None)
    np.testing.assert_array_equal(doubtful.named_if_likely().change, explanation.change)


def test_noise_is_given_no_family():
    explanation = explain(small_excess(np.zeros(SIGNAL.shape)))
    assert (explanation.family, explanation.share, explanation.bands) == (NONE, 0.0, ())


def test_a_stain_has_surface_place_and_spectrum():
    depth = np.array([0.12, 0.08, 0.03, 0.0])[:, None, None]
    explanation = explain(small_excess(-SIGNAL * depth * _spot(33, 38, 4) * FLOOR))
    assert (explanation.family, explanation.surface) == ("reflectance-map", "floor")
    assert np.hypot(explanation.centre_px[0] - 33, explanation.centre_px[1] - 38) < 1.5
    assert explanation.bands[:2] == ("b0", "b1")
    assert explanation.spectrum[0] < explanation.spectrum[1] < explanation.spectrum[2] < 0.01


def test_changes_of_pixels_without_light_have_a_finite_spectrum():
    """Light scattered outside the box: in DN, over 5 % of the band's mean signal."""
    data = small_excess(np.zeros(SIGNAL.shape))
    outside = _spot(33, 38, 4) > 0.5
    data = replace(data, signal=np.where(outside, 0.0, SIGNAL))
    change = np.broadcast_to(np.where(outside, 3.0, 0.0), SIGNAL.shape)
    expected = 3.0 / (0.05 * data.signal.mean(axis=(1, 2)))
    np.testing.assert_allclose(competition._spectrum(data, change, change[0] ** 2), expected)


def test_bands_that_only_the_lamps_fit_changes_do_not_show_the_cause():
    """The lamp's scale takes up a quarter of what one band gains, and with it changes all others."""
    change = np.zeros(SIGNAL.shape)
    change[1] = 0.05 * SIGNAL[1] * (1 + (COLUMNS % 3 == 0))
    explanation = explain(small_excess(change))
    assert explanation.family == "sensor-gain"
    assert explanation.bands == ("b1",)


def test_streaks_of_a_wiped_lens_are_a_blur_along_their_line():
    """Exponential tails at 30 degrees, in place of the Gaussians that are fitted."""
    steps = np.arange(-30, 31)
    parts = np.exp(-abs(steps) / 9.0) * (steps != 0)
    angle = np.deg2rad(30)
    moved = [shift(SIGNAL, (0, s * np.sin(angle), s * np.cos(angle)), order=1, mode="nearest") for s in steps]
    streaked = np.tensordot(parts / parts.sum(), moved, 1)
    explanation = explain(small_excess(0.06 * (streaked - SIGNAL)))
    assert explanation.family == "blur" and "streaks at 30 degrees" in explanation.form and explanation.share > 0.8
    assert explanation.field.acts == "streak" and explanation.field.angle_deg == 30


def test_a_shift_of_one_band_is_a_displacement_in_that_band():
    change = np.zeros(SIGNAL.shape)
    change[2] = _moved(0.2)[2]
    explanation = explain(small_excess(change))
    assert explanation.family == "displacement"
    assert explanation.bands == ("b2",)
    motion = motions(explanation)["b2"]
    assert 0.2 < motion.right_px < 0.3 and abs(motion.down_px) < 0.01  # differences of pixels are flatter than steps
    assert f"displaced by {motion.rms_px:.3f}" in explanation_sentence(explanation)


def test_levels_that_step_in_time_are_a_matter_of_order_and_those_of_a_line_are_not():
    """In time the bands come as b1, b2, b0, b3; neighbours in wavelength are b0 and b1."""
    step = small_excess(SIGNAL * np.array([0.02, 0, 0, 0.02])[:, None, None])
    assert explain(step).family == "time-order"
    line = small_excess(SIGNAL * np.array([0.0, 0.02, 0.013, 0])[:, None, None])
    assert explain(line).family == "lamp-spectrum"


def test_repeats_that_differ_speak_for_the_order_in_time():
    levels = SIGNAL * np.array([0.02, -0.01, 0.004, 0.015])[:, None, None]
    jumps = 0.003 * np.array([[1.0, -1], [-1, 1], [1, -1], [-1, 1]])
    assert explain(small_excess(levels)).family != "time-order"
    assert explain(small_excess(levels, jumps)).family == "time-order"


def test_what_stays_of_the_frame_before_is_a_matter_of_order():
    """Bands are taken as b1, b2, b0, b3, twice each; 4 % of every frame is seen again in the next."""
    pictures = np.array([np.rot90(picture, turns) for turns, picture in enumerate(SIGNAL)])
    mean = pictures / 2
    mean[[2, 0, 3]] += pictures[[1, 2, 0]] / 2
    explanation = explain(replace(small_excess(0.04 * mean), signal=pictures))
    assert (explanation.family, explanation.form) == ("time-order", "a part of each frame stays in the next")
    assert explanation.field.acts == "previous" and not explanation.levels
    per_band = np.diag([0.02] * 4)
    per_band[[2, 0, 3], [1, 2, 0]] = 0.02
    np.testing.assert_allclose(explanation.field.coefficients, per_band, atol=0.002)


def test_a_fringe_in_one_band_is_a_gain_of_that_band():
    change = np.zeros(SIGNAL.shape)
    change[1] = 0.02 * SIGNAL[1] * np.sin(0.9 * COLUMNS + 0.3 * ROWS)
    explanation = explain(small_excess(change))
    assert explanation.family in ("sensor-gain", "sensor-offset")
    assert explanation.bands == ("b1",)


@pytest.mark.parametrize("centre", [(-30.0, 10.0), (35.0, 20.0)])
def test_rings_in_one_band_are_found_about_any_centre(centre):
    """Interference between curved faces: the phase grows with the square of the distance."""
    square = (COLUMNS - centre[0]) ** 2 + (ROWS - centre[1]) ** 2
    change = np.zeros(SIGNAL.shape)
    change[1] = 0.02 * SIGNAL[1] * np.cos(0.012 * square + 0.4)
    explanation = explain(small_excess(change))
    assert explanation.family in ("sensor-gain", "sensor-offset")
    assert explanation.form.startswith("rings") and explanation.bands == ("b1",)
    assert explanation.share > 0.7


def test_rings_in_all_bands_go_by_the_wavelength():
    """Newton's rings: the phase is 4 pi gap / wavelength; they fade where a band holds several orders."""
    square = (COLUMNS - 35.0) ** 2 + (ROWS - 20.0) ** 2
    nm = small_excess(0 * SIGNAL).nm[:, None, None]
    phase = 0.012 * square * nm.min() / nm
    explanation = explain(small_excess(0.02 * SIGNAL * np.cos(phase) * np.exp(-((phase / 20) ** 2))))
    assert explanation.family == "sensor-gain" and explanation.form.startswith("rings by the wavelength")
    assert explanation.share > 0.8 and len(explanation.bands) == BANDS


def test_a_glow_with_wide_flanks_has_its_place_in_the_corner():
    away = np.hypot(ROWS - (SIZE - 1), COLUMNS)
    explanation = explain(small_excess(np.broadcast_to(40.0 / (1 + (away / 5) ** 2), SIGNAL.shape)))
    assert explanation.family == "sensor-offset"
    assert np.hypot(explanation.centre_px[0], explanation.centre_px[1] - (SIZE - 1)) < 0.1 * SIZE


def test_a_sensor_takes_no_counts_away_in_one_place():
    """A spot between what a gain and what an offset makes of the bands: counts that lack are no offset, which adds."""
    between = 0.06 * (SIGNAL + 6 * SIGNAL.mean()) / 7 * _spot(33, 30, 2)
    assert explain(small_excess(-between)).family == "sensor-gain"


def test_colours_of_one_place_are_distinguished_by_two_hundredths():
    """All forms in one place have the same bells, and so the same errors of its outline."""
    added = 120.0 * np.reshape((1.15, 0.85, 1.15, 0.85), (BANDS, 1, 1))
    explanation = explain(small_excess(added * np.exp(-((COLUMNS - 20) ** 2 + (ROWS - 20) ** 2) / 18)))
    gains = {rival.family: rival.share for rival in explanation.rivals}
    assert gains["reflection-lobe"] == pytest.approx(gains[explanation.family], rel=0.04)
    assert explanation.family == "reflectance-map"


def test_light_on_a_part_of_the_picture_without_signal_is_explained():
    """Relative changes have no meaning there, and a gain changes nothing."""
    mask = (COLUMNS < 20) | (COLUMNS > 60)
    light = 60.0 * _spot(40, 30, 4) * np.array([1.0, 0.9, 0.3, 0.1])[:, None, None]
    excess = small_excess(light)
    transport = replace(excess.transport, picture=mask * excess.transport.picture)
    with np.errstate(divide="raise", invalid="raise"):
        explanation = explain(replace(excess, signal=mask * SIGNAL, transport=transport))
    assert explanation.family in ("extra-light", "sensor-offset", "object")
    assert np.hypot(explanation.centre_px[0] - 40, explanation.centre_px[1] - 30) < 3


def test_a_hair_on_one_filter_is_found_next_to_a_larger_flaw_of_all_bands():
    """The flaw is two places in deep shadow, of opposite sign, as an error of the rendered picture may be."""
    bend = 30 + 0.02 * (ROWS - 14.0) ** 2
    hair = np.zeros(SIGNAL.shape)
    hair[2] = -0.04 * SIGNAL[2] * np.clip(1.5 - abs(COLUMNS - bend), 0, 1) * (abs(ROWS - 14) < 10)
    flaw = SIGNAL * (0.08 * _spot(5, 42, 1.0) - 0.08 * _spot(9, 42, 1.0))
    explanation = explain(small_excess(hair + flaw))
    assert (explanation.family, explanation.bands) == ("sensor-gain", ("b2",))
    assert explanation.form.startswith("a spot in one band")
    assert np.hypot(explanation.centre_px[0] - 31, explanation.centre_px[1] - 14) < 4
    densest = [np.sum((change / SIGMA) ** 2, axis=0).max() for change in (flaw, hair)]
    assert densest[0] > 2 * densest[1]


@pytest.mark.parametrize("height", [2.5, 5.0])
def test_a_bright_place_without_outline_is_light_and_one_with_an_outline_a_thing(height):
    """A lamp at a height before a wall, h^4 / (h^2 + r^2)^2, and a thing as large as where that is one half."""
    square = (COLUMNS - 34) ** 2 + (ROWS - 14) ** 2
    colour = np.array([0.02, 0.7, 0.3, 0.0])[:, None, None]
    lamp = (height**2 / (height**2 + square)) ** 2
    plate = 1.0 * (square < (np.sqrt(2) - 1) * height**2)
    assert explain(small_excess(SIGNAL * colour * lamp * ~FLOOR)).family == "extra-light"
    assert explain(small_excess(SIGNAL * colour * plate)).family == "object"


def test_a_dark_place_without_outline_is_no_light():
    """A third of the light is taken away, as by a thing out of focus; light only adds."""
    explanation = explain(small_excess(-0.35 * SIGNAL * _spot(34, 14, 3) * ~FLOOR))
    assert explanation.family == "object"


def test_a_lamp_at_another_level_for_a_while_is_a_matter_of_order():
    """Taken as b1, b2, b0, b3; b2 and b0 are no neighbours in wavelength."""
    explanation = explain(small_excess(SIGNAL * np.array([0.02, 0, 0.02, 0])[:, None, None]))
    assert explanation.family == "time-order" and "for a while" in explanation.form


def test_the_explained_change_is_the_cause():
    """The sign too: what is left is noise."""
    cause = SIGNAL * 0.03 * FLOOR * np.cos(COLUMNS / 15)
    explanation = explain(small_excess(cause + 0.0))
    assert np.corrcoef(explanation.change.ravel(), cause.ravel())[0, 1] > 0.95
    assert np.nanstd(explanation.remaining) < 1.1


def test_blurs_by_a_lens_are_blurs():
    wide = gaussian_filter(SIGNAL, (0, 0.6, 0.6), mode="nearest")
    assert explain(small_excess(wide - SIGNAL)).family == "blur"
