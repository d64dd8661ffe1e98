"""Forms of the families behind a mosaic: charge in one way, amplifiers in turn, black levels and bends of a channel."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.fitted_fields import field_effect
from cboxlab.validation.diagnose.explain.as_field import fitted_field
from cboxlab.validation.diagnose.families import families
from cboxlab.validation.diagnose.field_fit import FitInput, change_dn
from cboxlab.validation.diagnose.shared_forms.charge import moved_charge
from helpers.captures.small_excess import BANDS, COLUMNS, ROWS, SIGNAL, small_excess

#: Letters of one repeat: each of the four channels has two places.
PATTERN = np.array([list("ABCD"), list("CADB")])
USED = np.stack([PATTERN[ROWS % 2, COLUMNS % 4] == letter for letter in "ABCD"])
#: A raw frame: each pixel has its channel's light.
RAW = np.sum(SIGNAL * USED, axis=0)


def behind_mosaic(change):
    """The residual of one raw frame that a change (band, y, x) in DN makes."""
    plain = small_excess(change)
    used = USED & plain.used
    lamp = np.where(used[..., None], plain.nuisances, 0.0)
    lamp = lamp / np.linalg.norm(lamp)
    residual = np.where(used, plain.residual, 0.0)
    residual = residual - lamp[..., 0] * np.sum(lamp[..., 0] * residual)

    def charge(moved):
        return moved(np.broadcast_to(RAW, SIGNAL.shape))

    return replace(
        plain,
        residual=residual.astype(np.float32),
        marginal_residual=residual,
        used=used,
        nuisances=lamp.astype(np.float32),
        minutes=np.zeros(BANDS),
        cell=(2, 4),
        charge=charge,
    )


def best_of(family, change):
    """The form of a family with the largest evidence."""
    return max(families()[family].generate(FitInput.of(behind_mosaic(change))), key=lambda form: form.evidence)


@pytest.mark.parametrize(
    ("steps", "way"),
    [
        ([(0, 1), (0, -1)], "along the rows"),
        ([(1, 0), (-1, 0)], "along the columns"),
        ([(0, 1)], "to the right"),
        ([(0, -1)], "to the left"),
        ([(1, 0)], "down"),
        ([(-1, 0)], "up"),
    ],
)
def test_charge_that_leaks_one_way_says_the_way_and_its_part(steps, way):
    moved = np.mean([np.roll(RAW, step, (0, 1)) for step in steps], axis=0) - RAW
    data = behind_mosaic(np.broadcast_to(0.05 * moved, SIGNAL.shape))
    form = max(moved_charge(data, families()["blur"]), key=lambda form: form.evidence)
    assert form.form.startswith(f"charge that leaks {way}, ")
    assert float(form.form.split(", ")[1].rstrip("%")) == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize(("axis", "form"), [(ROWS, "every second row"), (COLUMNS, "every second column")])
def test_amplifiers_in_turn_are_a_gain_of_every_second_line(axis, form):
    change = 0.04 * SIGNAL * (axis % 2)
    gain, offset = (best_of(family, change) for family in ("sensor-gain", "sensor-offset"))
    assert gain.form.split(",")[0] == form
    assert float(gain.form.split(", ")[1].split("%")[0]) == pytest.approx(4.0, abs=0.4)
    assert gain.evidence > offset.evidence + 10


def test_two_places_of_one_channel_differ_in_that_channel():
    change = np.zeros_like(SIGNAL)
    change[1] = 0.06 * SIGNAL[1] * (ROWS % 2 - 0.5)
    form = best_of("sensor-gain", change)
    assert form.form.startswith("every second row in one band, ")
    assert np.flatnonzero(np.abs(form.fit.coefficients).sum(axis=1)).tolist() == [1]
    assert np.diff(form.fit.coefficients[1])[0] == pytest.approx(0.06, abs=0.006)
    assert form.fit.coefficients[1].sum() == pytest.approx(0, abs=1e-3)


def test_quarters_of_the_sensor_are_a_gain_with_straight_borders():
    change = 0.03 * SIGNAL * ((ROWS >= 24) & (COLUMNS < 24))
    assert best_of("sensor-gain", change).form.startswith("quarters of the sensor, 3.")


def test_a_black_level_of_one_channel_has_its_counts():
    change = np.zeros_like(SIGNAL)
    change[2] = -25.0
    form = best_of("sensor-offset", change)
    assert form.form.startswith("a black level in one band, -2")
    assert form.fit.coefficients[2, 0] == pytest.approx(-25, rel=0.2)


def test_a_channel_that_bends_has_its_part():
    change = np.zeros_like(SIGNAL)
    most = SIGNAL[USED].max()
    change[0] = -0.2 * SIGNAL[0] * SIGNAL[0] / most
    form = best_of("sensor-offset", change)
    assert form.form.startswith("a bend of the counts in one band, -")
    assert float(form.form.split(", ")[1].split("%")[0]) == pytest.approx(-20, abs=5)


def test_each_channel_has_pixels_in_and_out_of_trial_fits():
    data = behind_mosaic(np.zeros_like(SIGNAL))
    shares = [data.held_out[used].mean() for used in data.used]
    assert shares == pytest.approx([0.5] * BANDS)


def test_channels_of_one_frame_know_no_order_of_time():
    data = behind_mosaic(0.04 * SIGNAL * np.array([0, 1, 0, 0])[:, None, None])
    forms = [form.form for form in families()["time-order"].generate(FitInput.of(data))]
    assert not [form for form in forms if "lamp" in form or "stays" in form]


def test_another_dye_in_one_place_of_a_channel_is_a_filters():
    """The second place of a channel has a part of another channel's light."""
    change = np.zeros_like(SIGNAL)
    red = np.where(COLUMNS < 20, 0.6, 1.0) * SIGNAL[3]
    change[1] = 0.1 * (red - red.mean() / SIGNAL[1].mean() * SIGNAL[1]) * (ROWS % 2)
    data = behind_mosaic(change)
    signal = data.signal.copy()
    signal[3] = red
    forms = list(families()["filter-curve"].generate(FitInput.of(replace(data, signal=signal))))
    best = max(forms, key=lambda form: form.evidence)
    assert best.form == "other light in some pixels of b1, by their place in the mosaic"
    fitted = change_dn(data, best)
    assert np.allclose(fitted[1][USED[1]], change[1][USED[1]], atol=0.35 * np.abs(change).max())
    assert not fitted[[0, 2, 3]].any()
    effect = field_effect("dye", fitted_field(replace(data, signal=signal), best), "", "")
    assert effect.stage == "counts"


def test_a_spot_is_predicted_by_pixels_of_other_repeats():
    """No other band shows a pixel of a single frame, so bells are a repeat apart."""
    bell = np.exp(-((COLUMNS - 30) ** 2 + (ROWS - 20) ** 2) / (2 * 4.0**2))
    data = behind_mosaic(60.0 * bell * np.ones((BANDS, 1, 1)))
    fit_input = FitInput.of(data)
    assert fit_input.bells.pitch == 4
    spots = [form for form in families()["sensor-offset"].generate(fit_input) if form.form == "a spot"]
    assert spots[0].fit.heldout > 0.5
    assert spots[0].fit.evidence > 100
