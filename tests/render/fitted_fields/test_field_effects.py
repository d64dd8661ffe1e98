"""A cause is explained, written as an effect file, read again, and changes the picture as the cause did."""

import json

import numpy as np
import pytest
from cboxlab.rendering.chain import Counts, Light
from cboxlab.rendering.effects import apply_checked, catalogue
from cboxlab.rendering.fitted_fields import (
    FittedField,
    ImageMaps,
    PointMap,
    WaveMap,
    effect_of_diagnosis,
    field_effect,
    field_record,
)
from cboxlab.rendering.fitted_fields.fitted_field import field_of_record
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose.explain import explain
from cboxlab.validation.diagnose.field_fit.surface_maps import smooth_surface_maps
from cboxlab.validation.report.explanation import explanation_record
from helpers.captures.small_excess import BANDS, COLUMNS, ROWS, SIGMA, SIGNAL, SIZE, small_excess
from scipy.ndimage import shift

NM = np.array([450.0, 520, 590, 660])
DARK = np.full(BANDS, 100.0)
DRAW = np.random.default_rng(7)


def _shifted(band, by):
    change = np.zeros(SIGNAL.shape)
    change[band] = shift(SIGNAL[band], (0, by), order=3, mode="nearest") - SIGNAL[band]
    return change


def _streaked():
    """Exponential tails along the rows."""
    steps = np.arange(-30, 31)
    parts = np.exp(-abs(steps) / 9.0)
    moved = [shift(SIGNAL, (0, 0, step), order=1, mode="nearest") for step in steps]
    return 0.06 * (np.tensordot(parts / parts.sum(), moved, 1) - SIGNAL)


def _weighed_wrong():
    """A bit that adds 12 DN, less what the lamp's scale takes up."""
    added = 12.0 * (SIGNAL // 256 % 2)
    return added - SIGNAL * np.sum(added * SIGNAL) / np.sum(SIGNAL**2)


def _rings():
    """Interference in one gap: by the wavelength."""
    phase = 0.01 * ((COLUMNS - 30.0) ** 2 + (ROWS - 25.0) ** 2) * (NM.min() / NM)[:, None, None]
    return 0.02 * SIGNAL * np.cos(phase)


#: By their family, and what of it.
CAUSES = {
    "sensor-offset": SIGMA * DRAW.normal(0, 1.5, (BANDS, SIZE, 1)),
    "sensor-gain": SIGNAL * DRAW.normal(0, 0.02, (1, 1, SIZE)),
    "displacement": _shifted(2, 0.2),
    "blur": (_shifted(1, 1) + _shifted(1, -1)) / 5,
    "blur, streaks": _streaked(),
    "sensor-offset, a bit of wrong weight": _weighed_wrong(),
    "sensor-gain, rings": _rings(),
    "time-order": SIGNAL * np.array([0.02, 0, 0, 0.02])[:, None, None],
}


def _written(folder, cause):
    """The explanation of a cause, and the effect read back from the file written of it."""
    explanation = explain(small_excess(cause))
    diagnosis = folder / "diagnosis.json"
    diagnosis.write_text(json.dumps({"selected": ["unknown"], "explanation": explanation_record(explanation)}))
    return explanation, effect_of_diagnosis(folder / "found.toml", diagnosis)[0]


def _counts(bands=("b0", "b1", "b2", "b3")):
    frames, seconds = SIGNAL + DARK[:, None, None], np.ones(BANDS)
    return Counts(bands, frames, frames, frames, DARK, DARK, DARK, seconds, seconds, seconds, seconds, 65535.0)


def _changed(effect, amplitude):
    """What an effect of the sensor or the optics changes, DN."""
    applied = apply_checked(effect, {"amplitude": amplitude}, "test")
    if effect.stage == "counts":
        return applied.apply(_counts()).scene - DARK[:, None, None] - SIGNAL
    return applied.apply(Light(SIGNAL, NM, cornell_camera(SIZE))).signal - SIGNAL


@pytest.mark.parametrize("cause", CAUSES)
def test_the_effect_written_of_a_cause_does_what_the_cause_did(tmp_path, cause):
    written, effect = _written(tmp_path, CAUSES[cause])
    assert written.family == cause.split(",")[0]
    once = _changed(effect, 1.0)
    assert np.abs(once - written.change).max() < 1e-3 * np.abs(written.change).max()
    assert np.sum((once - CAUSES[cause]) ** 2) < 0.25 * np.sum(CAUSES[cause] ** 2)
    assert np.allclose(_changed(effect, -0.5), -0.5 * once)
    assert np.abs(_changed(effect, 0.0)).max() < 1e-9


def test_a_line_of_the_lamp_stands_about_its_band(tmp_path):
    written, effect = _written(tmp_path, SIGNAL * np.array([0.0, 0.03, 0.02, 0])[:, None, None])
    assert (written.family, effect.stage) == ("lamp-spectrum", "scene")
    scene = cornell_box()
    radiance = apply_checked(effect, {}, "test").apply(scene).lamp.radiance
    ratio = radiance.at(NM) / scene.lamp.radiance.at(NM)
    assert ratio[1] - ratio[0] == pytest.approx(0.03, abs=0.004)
    assert ratio[2] - ratio[0] == pytest.approx(0.02, abs=0.004)


def test_a_stain_becomes_values_at_points_of_its_surface():
    depth = np.array([0.12, 0.08, 0.03, 0.0])[:, None, None]
    bell = np.exp(-((COLUMNS - 33) ** 2 + (ROWS - 38) ** 2) / 32) * (ROWS >= 30)
    excess = small_excess(-SIGNAL * depth * bell)
    field = explain(excess).field
    (stain,) = field.surfaces
    assert (field.acts, stain.surface) == ("reflectance", "floor")
    centre = excess.transport.position.reshape(SIZE, SIZE, 3)[38, 33]
    assert stain.at(centre[None])[0] * field.spectrum == pytest.approx(-depth[:, 0, 0], abs=0.012)
    assert stain.at(np.array([[0.0, 0, 0]]))[0] == 0


def test_interference_goes_by_the_wavelength():
    """A gap of some um between a curved and a tilted face: cos(4 pi gap / wavelength), in two bands by one map."""
    gap_um = 0.2 + 0.01 * COLUMNS + 0.0008 * ((COLUMNS - 30) ** 2 + (ROWS - 25) ** 2)
    # 2 gap / 0.45 um in waves: what goes with rows, with columns, and with squares
    per_px = np.array([-50 * 0.0008, 0.01 - 60 * 0.0008]) * 2 / 0.45
    maps = ImageMaps("wave", per_px=tuple(per_px), curvature=0.0008 * 2 / 0.45, nm=450.0)
    for nm in (450.0, 600.0):
        waves = np.cos(4 * np.pi * gap_um / (nm / 1000)).ravel()
        residual_squares = np.linalg.lstsq(maps.at(nm).matrix((SIZE, SIZE)).T, waves, rcond=None)[1]
        assert residual_squares.item() < 1e-18 * len(waves)


def test_paints_that_each_changed_otherwise_are_one_cause(tmp_path):
    """A spectrophotometer whose wavelengths are off. A factor on both, as the lamp's scale is, is not asked for."""
    floor, wall = np.array([[0.02, -0.01, 0.015, -0.02], [-0.015, 0.02, 0.01, 0.0]])
    excess = small_excess(SIGNAL * np.where(ROWS >= 30, floor[:, None, None], wall[:, None, None]))
    explanation = explain(excess)
    assert (explanation.family, explanation.surface) == ("paint-spectrum", None) and explanation.form.startswith(
        "all paints"
    )
    relative = explanation.change / SIGNAL
    mean_change = relative[:, ROWS >= 30].mean(axis=1) - relative[:, ROWS < 30].mean(axis=1)
    assert mean_change == pytest.approx(floor - wall, abs=0.003)
    field, maps = (
        field_of_record(json.loads(json.dumps(field_record(explanation.field))), tmp_path),
        smooth_surface_maps(excess),
    )
    first = [int(np.argmax(maps.surface == excess.names.index(surface.surface))) for surface in field.surfaces]
    values = np.array([surface.spectrum * field.spectrum for surface in field.surfaces])
    again = [values[:, band] @ maps.reflectance(band, first) for band in range(BANDS)]
    assert np.reshape(again, SIGNAL.shape) == pytest.approx(explanation.change, rel=1e-3, abs=0.01)


@pytest.mark.parametrize("spectrum", [[0.1], [0.1] * 5])
def test_a_surfaces_spectrum_has_a_number_for_each_band(spectrum, tmp_path):
    wave_map = WaveMap("floor", np.zeros(3), np.ones(3), np.zeros((1, 3)), np.ones(1), np.ones(4))
    field = FittedField("reflectance", ("a", "b", "c", "d"), NM, (4, 4), surfaces=(wave_map,), spectrum=np.ones(4))
    record = field_record(field)
    record["surfaces"][0]["spectrum"] = spectrum
    with pytest.raises(InputError, match=r"surfaces\[0\]\.spectrum: found \d numbers; expected 4 numbers"):
        field_of_record(record, tmp_path / "mine.toml")


def test_values_at_points_are_linear_in_between_and_nothing_beyond():
    points = np.array([[0.0, 5, 0], [10, 5, 0], [0, 5, 10], [10, 5, 10]])
    plane = PointMap("floor", points, np.array([1.0, 2.0, 3.0, 4.0]))
    values = np.array([[5.0, 5, 5], [2.5, 5, 0], [11, 5, 5]])
    assert plane.at(values) == pytest.approx([2.5, 1.25, 0.0])
    assert plane.over_patches(np.array([[2.0, 5, 2], [90, 5, 90]]), points) == pytest.approx([2.5, 0.0])
    alone = PointMap("floor", points[:1], np.array([1.0]))
    assert alone.at(points[:2]) == pytest.approx([1.0, 0.0])


def test_a_field_of_the_sensor_is_for_its_own_bands_and_size(tmp_path):
    _, effect = _written(tmp_path, CAUSES["sensor-offset"])
    with pytest.raises(InputError, match="effect found: found band 'green'; expected one of b0, b1, b2, b3"):
        effect.apply(_counts(("b0", "b1", "b2", "green")), amplitude=1.0)
    _, blur = _written(tmp_path / "..", CAUSES["blur"])
    with pytest.raises(InputError, match="a picture of 48 x 47 px; expected 48 x 48 px"):
        blur.apply(Light(SIGNAL[:, 1:], NM, cornell_camera(SIZE)), amplitude=1.0)


def test_a_part_of_the_frames_before_is_added_above_dark():
    parts = 0.1 * np.eye(BANDS, k=-1)
    names = tuple(_counts().bands)
    field = FittedField("previous", names, NM, (SIZE, SIZE), ImageMaps("cosines"), coefficients=parts)
    changed = _changed(field_effect("persistence", field, "", ""), 2.0)
    assert np.allclose(changed[0], 0, atol=1e-9)
    assert np.allclose(changed[1:], 0.2 * SIGNAL[:-1])


def _field_on_counts(acts, image, coefficients, **more):
    """The effect of a field read back from its record."""
    bands = ("b0", "b1", "b2", "b3")
    field = FittedField(acts, bands, NM, (SIZE, SIZE), image=image, coefficients=coefficients, **more)
    return field_effect("field", field_of_record(json.loads(json.dumps(field_record(field))), "field.toml"), "", "")


def test_equal_leaks_to_all_neighbours_are_crosstalk():
    effect = _field_on_counts("leak", ImageMaps("cosines"), np.full((BANDS, 4), 0.03 / 4))
    leaked = apply_checked(effect, {"amplitude": 1.0}, "test").apply(_counts())
    shared = apply_checked(catalogue()["crosstalk"], {"fraction": 0.03}, "test").apply(_counts())
    for frames in ("scene", "flat", "reference"):
        np.testing.assert_allclose(getattr(leaked, frames), getattr(shared, frames), rtol=1e-12)


def test_charge_that_stays_behind_in_the_register_is_in_all_frames():
    effect = _field_on_counts("register", ImageMaps("cosines"), np.full((BANDS, 3), 0.01), angle_deg=90)
    before, after = _counts(), apply_checked(effect, {"amplitude": 1.0}, "test").apply(_counts())
    for frames in ("scene", "flat", "reference"):
        change = getattr(after, frames) - getattr(before, frames)
        # the first rows of the darker floor get charge of the wall above, the wall gets none of the floor
        assert change[:, 30].mean() > 5
        assert np.abs(change[:, 28, :6]).max() < 1


def test_places_of_a_repeat_and_quarters_are_where_they_say():
    numbers = np.tile(np.arange(6.0), (BANDS, 1))
    effect = _field_on_counts("offset", ImageMaps("repeat", repeat=(2, 3)), numbers)
    assert np.allclose(_changed(effect, 1.0), 3 * (ROWS % 2) + COLUMNS % 3)
    effect = _field_on_counts("offset", ImageMaps("quarters"), numbers[:, :4])
    assert np.allclose(_changed(effect, 1.0), 2 * (ROWS >= SIZE / 2) + (COLUMNS >= SIZE / 2))
