"""Forms of the families by causes of other formulas: copies, trails, single pixels, filters, the lamp's lobe."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.fitted_fields import PictureCopy, exchanges, field_effect, field_record
from cboxlab.rendering.fitted_fields.fitted_field import field_of_record
from cboxlab.validation.diagnose.explain import advice, appearance, explain, registration
from cboxlab.validation.diagnose.explain.as_field import fitted_field
from cboxlab.validation.diagnose.families import families
from cboxlab.validation.diagnose.shared_forms.image_copies import copies
from cboxlab.validation.report.explanation import explanation_record, laboratory_sentences
from helpers.captures.small_excess import (
    BANDS,
    COLUMNS,
    EMISSION,
    EXPOSURE_S,
    ROWS,
    SIDE,
    SIGMA,
    SIGNAL,
    SIZE,
    small_excess,
)
from scipy.ndimage import gaussian_filter

DRAW = np.random.default_rng(8)


def _moved(picture, down, right):
    """A picture moved by whole pixels; dark where it does not reach."""
    moved = np.zeros_like(picture)
    rows, columns = (slice(max(n, 0), SIZE + min(n, 0)) for n in (down, right))
    old_rows, old_columns = (slice(max(-n, 0), SIZE + min(-n, 0)) for n in (down, right))
    moved[:, rows, columns] = picture[:, old_rows, old_columns]
    return moved


@pytest.mark.parametrize(
    ("copy", "form"),
    [
        (_moved(SIGNAL, 5, -7), "a faint copy of the picture, shifted by (-7, 5)"),
        (SIGNAL[:, :, ::-1], "a mirrored copy of the picture"),
        (_moved(SIGNAL[:, ::-1, ::-1], 3, 0), "a turned copy of the picture"),
    ],
    ids=["pane", "mirror", "ghost"],
)
def test_a_copy_of_the_picture_is_stray_light(copy, form):
    explanation = explain(small_excess(0.03 * copy))
    assert explanation.family == "blur" and explanation.form.startswith(form)
    assert explanation.share > 0.9
    again = field_of_record(json.loads(json.dumps(field_record(explanation.field))), "field.toml")
    assert again.picture_copy == explanation.field.picture_copy
    assert field_effect("copy", again, "", "").stage == "optics"


def test_a_copy_out_of_focus_in_one_band_is_found_there():
    """A filter in its holder the wrong way round mirrors an unsharp copy, a disc of four pixels for each point."""
    change = np.zeros_like(SIGNAL)
    disc = [(i, j) for i in range(-4, 5) for j in range(-4, 5) if i * i + j * j <= 16]
    change[2] = 0.05 * np.mean([_moved(SIGNAL, 5 + i, -7 + j)[2] for i, j in disc], axis=0)
    excess = small_excess(change)
    forms = {copy.form.split(", shifted")[0]: copy for copy in copies(excess, families()["blur"])}
    copy = max(forms.values(), key=lambda form: form.evidence)
    assert copy is forms["a blurred copy of the picture in one band"]
    assert np.abs(np.subtract(copy.picture_copy.shift_px, (5, -7))).max() <= 1
    assert copy.fit.predicts > 0.8
    assert np.argmax(np.abs(copy.fit.coefficients).sum(axis=1)) == 2
    again = field_of_record(json.loads(json.dumps(field_record(fitted_field(excess, copy)))), "field.toml")
    assert again.picture_copy == copy.picture_copy


@pytest.mark.parametrize("blur", [3.0, 7.0])
def test_a_mirrored_copy_out_of_focus_is_no_pattern_of_the_sensor(blur):
    """A pane far from the focus: smooth counts that no sensor adds, since the picture itself has their shape."""
    copy = np.array([gaussian_filter(band[:, ::-1], blur, mode="nearest") for band in SIGNAL])
    explanation = explain(small_excess(0.03 * copy))
    assert explanation.family == "blur"
    assert explanation.form.startswith("a mirrored copy of the picture, out of focus")


def test_a_copy_is_that_of_numpy():
    picture = np.arange(12.0).reshape(3, 4)
    middle = exchanges("copy", picture, picture_copy=PictureCopy(2, False, (0, 1)))[4]
    np.testing.assert_array_equal(middle[:, 1:], picture[::-1, ::-1][:, :-1])
    assert (middle[:, 0] == 0).all()


@pytest.mark.parametrize(("angle", "form"), [(0, "to the right"), (90, "down"), (180, "to the left"), (270, "up")])
def test_trails_keep_the_charge_and_their_way(angle, form):
    point = np.zeros((31, 31))
    point[15, 15] = 1.0
    for trail in exchanges("trail", point, angle_deg=angle):
        assert trail[15, 15] == pytest.approx(-1)
        assert trail.sum() == pytest.approx(0, abs=0.2)  # a long tail leaves the picture
        way = {0: trail[15, 16:], 90: trail[16:, 15], 180: trail[15, :15], 270: trail[:15, 15]}[angle]
        assert way.sum() == pytest.approx(trail[trail > 0].sum())
    turned = np.rot90(SIGNAL, angle // 90, axes=(1, 2))
    late = np.zeros_like(turned)
    for column in range(1, SIZE):
        late[:, :, column] = 0.6 * late[:, :, column - 1] + 0.4 * turned[:, :, column - 1]
    change = 0.1 * np.rot90(late - turned, -(angle // 90), axes=(1, 2))
    explanation = explain(small_excess(change))
    assert (explanation.family, explanation.form) == ("blur", f"trails {form}")


@pytest.mark.parametrize(
    ("change", "family", "form"),
    [
        (0.03 * SIGNAL * DRAW.normal(0, 1, (SIZE, SIZE)), "sensor-gain", "single pixels, alike in all bands"),
        (
            5 * SIGMA * EXPOSURE_S[:, None, None] * (DRAW.random((SIZE, SIZE)) < 0.03),
            "sensor-offset",
            "single pixels, that grows with the exposure",
        ),
    ],
    ids=["old flats", "hot pixels"],
)
def test_single_pixels_that_bands_share_are_the_sensors(change, family, form):
    explanation = explain(small_excess(change))
    assert (explanation.family, explanation.form) == (family, form)
    assert explanation.heldout > 0.3
    assert explanation.sharp == (family == "sensor-offset")  # a rendering's own noise is alike in all bands
    assert np.corrcoef(explanation.change.ravel(), change.ravel())[0, 1] > 0.9
    assert explanation.registration.in_pixels > 0.2 or family == "sensor-offset"


def test_pixels_of_single_bands_have_no_family():
    """As cosmic rays have: no other band knows of them."""
    hits = (DRAW.random(SIGNAL.shape) < 0.02) * 8 * SIGMA
    assert explain(small_excess(hits)).family == "none"


def test_light_of_another_band_is_a_filters():
    """Colours that differ over the picture show where the light comes from."""
    rosy = np.where(COLUMNS < 20, 0.6, 1.0)
    signal = SIGNAL.copy()
    signal[3] = signal[3] * rosy
    excess = replace(small_excess(np.eye(BANDS)[0][:, None, None] * 0.05 * signal[3]), signal=signal)
    explanation = explain(excess)
    assert (explanation.family, explanation.bands) == ("filter-curve", ("b0",))
    assert explanation.form in ("light of b3 in b0", "other light in b0")


@pytest.mark.parametrize(
    ("shape", "form"),
    [
        (EMISSION - EMISSION.mean(), "by the angle at which light leaves it"),
        (0.2 + SIDE @ [1.5, 1.0], "in a part of the lamp"),
    ],
)
def test_a_lamp_whose_lobe_or_side_has_a_colour_is_the_lamps(shape, form):
    colour = np.array([-0.06, -0.02, 0.02, 0.06])[:, None, None]
    explanation = explain(small_excess(500 * colour * shape))
    assert (explanation.family, explanation.form) == ("lamp-spectrum", form)
    assert not explanation.levels


@pytest.mark.parametrize(
    ("change", "form"),
    [
        (-0.05 * SIGNAL * (np.hypot(ROWS - 15, COLUMNS - 30) < 4), "counts are missing, in proportion to the signal"),
        (np.ones(BANDS)[:, None, None] * 40.0 * (ROWS == 20), "there are counts too many, the same number in all"),
    ],
)
def test_sign_and_scaling_are_measured(change, form):
    assert appearance(registration(small_excess(change))).startswith(form)


def test_every_form_has_words_for_the_laboratory():
    for family in families().values():
        assert family.advice and family.advice[-1].form == ""
        for entry in family.advice:
            assert 2 <= len(entry.causes) <= 3 and entry.experiment.endswith(".")


def test_what_no_family_explains_has_an_experiment_too():
    explanation = explain(small_excess((DRAW.random(SIGNAL.shape) < 0.02) * 8 * SIGMA))
    assert "noise" in advice(explanation).experiment
    assert any("cosmic rays" in sentence for sentence in laboratory_sentences(explanation))


def test_probabilities_are_no_constants():
    weak, strong = (explain(small_excess(part * SIGNAL * DRAW.normal(0, 1, (1, SIZE, 1)))) for part in (0.002, 0.03))
    for probability in (weak, strong):
        assert sum(probability.odds.values()) == pytest.approx(1)
        assert explanation_record(probability)["probability"] == pytest.approx(probability.probability, abs=1e-4)
    assert strong.probability > weak.probability
    assert strong.cause_probability > weak.cause_probability
