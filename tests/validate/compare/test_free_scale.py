"""Free factors and fall-off of a capture without absolute scale: exact fits, noise, and a whole validation."""

import tomllib
from dataclasses import dataclass, make_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import CorrectedBands, LensAxis, evaluate_variance, fall_off_terms
from cboxlab.calibration.correction.correction import FlatField
from cboxlab.calibration.instrument import band_images
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.compare.free_scale import FreeScale, free_columns, refined_scale, rescaled
from cboxlab.validation.compare.prepared import CalibratedCapture
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture

BANDS = ("a", "b", "c")
SHAPE = (40, 50)
AXIS = LensAxis(60.0, 24.0, 20.0)


def calibration(measured, axis=None, scale="free"):
    images = band_images(BANDS, measured, np.ones_like(measured))
    manifest = SimpleNamespace(is_absolute=False, is_free_by_band=scale == "free-by-band", scale=scale)
    response = 1 / (1 + 0.3 * fall_off_terms(AXIS, SHAPE)[0])
    flats = {"a": SimpleNamespace(response=response / response.mean())}
    bands = SimpleNamespace(nominal_axis=axis, images=images, flats=flats)
    return SimpleNamespace(images=images, bands=bands, capture=SimpleNamespace(manifest=manifest))


def start(by_band, nominal):
    terms = np.zeros(4 if nominal else 0)
    return FreeScale(by_band, np.ones(3), np.full(3, np.inf), nominal, terms, terms)


def rendering(seed=0):
    return 500 * (1 + np.random.default_rng(seed).random((3, *SHAPE)))


def test_a_further_fall_off_changes_signals_variances_and_flats_alike():
    """The variance of a divided signal is divided by the square; a flat keeps its own relative error."""
    rng = np.random.default_rng(4)
    signal, bent = rendering(), 1 - 0.3 * rng.random(SHAPE)
    coefficients = rng.uniform(0.5, 2, (3, 3, *SHAPE)) * np.array([1, 0.1, 1e-4])[:, None, None]
    images = band_images(BANDS, signal, evaluate_variance(coefficients, signal))
    response, error = rng.uniform(0.5, 1, SHAPE), rng.uniform(1e-4, 2e-4, SHAPE)
    flat = FlatField(response, error, 1000.0, np.ones(1), np.zeros(SHAPE, bool))
    before = CorrectedBands(images, coefficients, dict.fromkeys(BANDS, flat), ())
    radiometry = make_dataclass("R", ["constant", "band_factors"])(2.0, np.array([1.0, 3.0, 0.5]))
    names = ["bands", "radiometry", "responses"]
    factors = np.array([4.0, 2.0, 8.0])
    after = rescaled(make_dataclass("C", names)(before, radiometry, None), factors, bent)
    np.testing.assert_allclose(after.bands.images["signal"], signal / bent)
    expected = before.predicted_variance(signal) / bent**2
    np.testing.assert_allclose(after.bands.images["variance"], expected)
    np.testing.assert_allclose(after.bands.predicted_variance(signal / bent), expected)
    changed = after.bands.flats["b"]
    np.testing.assert_allclose(changed.response, flat.response * bent)
    relative = [each.relative_variance / each.response**2 for each in (changed, flat)]
    np.testing.assert_allclose(*relative)
    constants = after.radiometry.constant * after.radiometry.band_factors
    np.testing.assert_allclose(constants, 2.0 * np.array([1.0, 3.0, 0.5]) * factors)


@pytest.mark.parametrize("by_band", [False, True])
@pytest.mark.parametrize("nominal", [False, True])
def test_factors_and_fall_off_are_those_of_the_photograph(by_band, nominal):
    signal = rendering()
    factors = np.array([3.0, 5.0, 0.25]) if by_band else np.full(3, 3.0)
    square = AXIS.radius_px(SHAPE) ** 2 / (AXIS.radius_px(SHAPE) ** 2).max()
    tilt = (np.indices(SHAPE)[0] - 20.0) / AXIS.radius_px(SHAPE).max()
    bent = 1 - 0.08 * square - 0.03 * square**2 + 0.01 * tilt if nominal else np.ones(SHAPE)
    measured = factors[:, None, None] * signal * bent
    fitted, of_bands, further = refined_scale(
        start(by_band, nominal),
        calibration(measured, AXIS if nominal else None),
        signal=signal,
        variance=np.full(signal.shape, 1e-4),
        used=np.ones(signal.shape, bool),
    )
    np.testing.assert_allclose(of_bands, factors, rtol=1e-6)
    np.testing.assert_allclose(further, bent, rtol=1e-6)
    np.testing.assert_allclose(fitted.constant, factors, rtol=1e-6)
    np.testing.assert_allclose(fitted.fall_off, [-0.08, -0.03, 0.0, 0.01] if nominal else [], atol=1e-6)


def test_with_an_absolute_scale_the_fall_off_alone_is_free():
    """A lamp 20 % too strong stays so, in a picture whose flat, nominal times further fall-off, keeps the mean 1."""
    signal, square = rendering(), (AXIS.radius_px(SHAPE) / AXIS.radius_px(SHAPE).max()) ** 2
    measured = 1.2 * signal * (1 - 0.1 * square)
    noise = {"variance": np.full(signal.shape, 1e-4), "used": np.ones(signal.shape, bool)}
    first = replace(start(False, True), absolute=True)
    capture = calibration(measured, AXIS)
    fitted, of_bands, bent = refined_scale(first, capture, signal=signal, **noise)
    assert (of_bands == 1).all() and (fitted.constant == first.constant).all()
    np.testing.assert_allclose(bent / bent[20, 24], 1 - 0.1 * square, rtol=1e-6)
    assert np.mean(capture.bands.flats["a"].response * bent) == pytest.approx(1.0)
    assert fitted.not_known == ("the lens's fall-off beyond cos^4",) and not fitted.record(BANDS)["factors"]


def test_the_stated_uncertainty_is_the_scatter():
    signal, pulls = rendering(), []
    for seed in range(60):
        noise = 20 * np.random.default_rng(seed).standard_normal(signal.shape)
        measured = 2 * signal + noise
        arguments = {"signal": signal, "variance": np.full(signal.shape, 400.0), "used": np.ones(signal.shape, bool)}
        fitted, factors, _ = refined_scale(start(True, False), calibration(measured), **arguments)
        pulls.append((factors / 2 - 1) / fitted.relative_sigma)
    spread = np.std(pulls)
    assert abs(spread - 1) < 4 / np.sqrt(2 * 180) and abs(np.mean(pulls)) < 4 / np.sqrt(180)


def test_a_flaw_of_the_model_hardly_moves_the_factor():
    signal = rendering()
    measured = 2 * signal
    measured[:, :6, :6] *= 3  # a lamp that the model lacks, in 2 % of the pixels
    arguments = {"signal": signal, "variance": np.full(signal.shape, 400.0), "used": np.ones(signal.shape, bool)}
    _, factors, _ = refined_scale(start(False, False), calibration(measured), **arguments)
    assert abs(factors[0] / 2 - 1) < 0.003


def test_the_columns_of_the_diagnosis_span_the_free_factors():
    signal = rendering()
    by_band = start(True, True)
    columns = free_columns(calibration(signal, AXIS, "free-by-band"), by_band, signal)
    assert len(columns) == 2 + 4
    assert np.array_equal(columns[0][1], signal[1]) and not columns[0][[0, 2]].any()
    assert len(free_columns(calibration(signal, None, "free"), start(False, False), signal)) == 0
    assert free_columns(calibration(signal), None, signal) == []
    brighter = free_columns(calibration(signal, AXIS, "free-by-band"), by_band, 2 * signal)
    np.testing.assert_allclose(brighter, 2 * np.array(columns))


def test_a_second_fit_corrects_the_first_one_exactly():
    """The first one took a dark wall on the left for a tilt of 6 %; products of both would leave 0.4 %."""
    signal, terms = rendering(), fall_off_terms(AXIS, SHAPE)
    truth, first = np.array([-0.1, 0.02, 0.0, 0.01]), np.array([-0.06, 0.0, 0.06, 0.02])
    bent = [1 + np.tensordot(each, terms, 1) for each in (truth, first)]
    begun = replace(start(False, True), fall_off=first)
    fitted, _, further = refined_scale(
        begun,
        calibration(2 * signal * bent[0] / bent[1], AXIS),
        signal=signal,
        variance=np.full(signal.shape, 1e-4),
        used=np.ones(signal.shape, bool),
    )
    np.testing.assert_allclose(further * bent[1], bent[0], rtol=1e-6)
    np.testing.assert_allclose(fitted.fall_off, truth, atol=1e-6)
    columns = free_columns(calibration(signal, AXIS), begun, signal)
    change = np.tensordot(truth - first, np.array(columns), 1)
    np.testing.assert_allclose(signal + change, signal * bent[0] / bent[1])


@dataclass(frozen=True, eq=False)
class Uncalibrated:
    bands: CorrectedBands
    radiometry: object
    capture: object
    responses: object = None
    images = property(lambda self: self.bands.images)
    predicted_variance = property(lambda self: self.bands.predicted_variance)


def without_flats(photograph, by_band, **of_bands):
    flat = FlatField(np.ones(SHAPE), np.zeros(SHAPE), np.inf, np.zeros(0), np.zeros(SHAPE, bool))
    images = band_images(BANDS, photograph, np.ones(photograph.shape))
    coefficients = np.ones((3, 3, *SHAPE)) * np.array([1.0, 0.0, 0.0])[:, None, None]
    bands = CorrectedBands(images, coefficients, dict.fromkeys(BANDS, flat), (), AXIS, **of_bands)
    manifest = SimpleNamespace(is_free_by_band=by_band, is_absolute=False)
    radiometry = make_dataclass("R", ["constant", "band_factors"])(1.0, None)
    stand = Uncalibrated(bands, radiometry, SimpleNamespace(manifest=manifest, cell=None))
    return CalibratedCapture(stand, None, None, None, None, None, None, free_scale=start(by_band, True))


def test_dark_levels_settle_next_to_a_fall_off_that_was_fitted_without_the_effect():
    """A photograph without darks and flats, whose first fit took a dark wall for a tilt."""
    plain, terms, levels = rendering() * np.array([[[0.1]], [[0.2]], [[1]]]), fall_off_terms(AXIS, SHAPE), [1, -1, 0]
    dark = np.where(np.arange(SHAPE[1]) < 15, 0.9, 1.0) * plain
    photograph = dark * (1 + np.tensordot([-0.1, 0.02, 0.0, 0.01], terms, 1)) + np.array(levels)[:, None, None]
    first = without_flats(photograph, False, dark_sigma_dn=np.full(3, 2.0))
    every, none = plain > 0, np.zeros(plain.shape)
    first = first.with_scale_of(plain, np.ones(plain.shape), every)
    fitted = first.fitted_about(first.free_scale.constant[0] * dark, none, every)
    np.testing.assert_allclose(fitted.calibration.bands.further_dark_dn, levels, atol=0.15)
    assert fitted.free_scale.fall_off == pytest.approx([-0.1, 0.02, 0.0, 0.01], abs=2e-3)


@pytest.mark.parametrize("by_band", [False, True])
def test_with_an_effect_in_place_fall_off_and_factors_are_fitted_again(by_band):
    """A first fit took a dark wall for a tilt. In the prediction's units the photograph is that prediction then."""
    plain, terms = rendering(), fall_off_terms(AXIS, SHAPE)
    dark = np.where(np.arange(SHAPE[1]) < 15, 0.9, 1.0) * plain
    bent = 1 + np.tensordot([-0.1, 0.02, 0.0, 0.01], terms, 1)
    factors = np.array([2.0, 3.0, 0.5] if by_band else [2.0, 2.0, 2.0])[:, None, None]
    first = without_flats(factors * dark * bent, by_band)
    every = plain > 0
    fitted = first.fitted_about(1.9 * dark, np.zeros(plain.shape), every)
    np.testing.assert_allclose(fitted.calibration.bands.images["signal"], 1.9 * dark, rtol=2e-3)
    assert fitted.free_scale.fall_off == pytest.approx([-0.1, 0.02, 0.0, 0.01], abs=5e-3)
    assert replace(first, free_scale=None).fitted_about(dark, dark, every).calibration is first.calibration


@pytest.fixture(scope="module")
def absolute(large_patches, tmp_path_factory):
    folder = tmp_path_factory.mktemp("free") / "absolute"
    write_model_capture(folder, Model(), perturbed_camera(32, 2), CaptureSettings(), 2, relative_error=2e-3)
    return folder


def freed(folder, claim):
    """The same capture without reference, gain, lens data and optics, its lamp stated three times too bright."""
    path = folder / "capture.toml"
    manifest = tomllib.loads(path.read_text())
    manifest["scale"] = claim
    del manifest["reference"], manifest["camera"]["gain_e_per_dn"], manifest["lens"]["transmittance"]
    for band in manifest["band"]:
        del band["f_number"], band["image_distance_mm"]
    path.write_text(tomli_w.dumps(manifest))
    lamp = folder / manifest["lamp"]["radiance"].split(":")[0]
    header, *rows = lamp.read_text().splitlines()
    tripled = [",".join([row.split(",")[0], *(repr(3 * float(v)) for v in row.split(",")[1:])]) for row in rows]
    lamp.write_text("\n".join([header, *tripled, ""]))


def test_a_capture_without_any_scale_is_validated(absolute, tmp_path):
    import shutil

    folder = shutil.copytree(absolute, tmp_path / "free")
    freed(folder, "free-by-band")
    result = validate_capture(load_capture(folder), Model())
    assert 0.9 < result.comparison.chi2.per_dof < 1.1 and not result.prepared.calibration.suspicions
    assert abs(result.fit.lamp_scale - 1) < 0.01
    scale = result.prepared.free_scale
    assert scale.by_band and (scale.relative_sigma < 0.01).all() and "lamp's power" in scale.sentence
    assert scale.record(BANDS + tuple("defg"))["claim"] == "free-by-band"
    assert replace(scale, by_band=False).not_known == ("the lamp's power",)
