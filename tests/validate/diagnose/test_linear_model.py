"""The linear model of a residual: what nuisances can imitate is gone, what they cannot stays, noise stays noise."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.scenes.camera import REFERENCE_ROTATION, Camera
from cboxlab.validation.compare.nuisances import NuisanceFit
from cboxlab.validation.diagnose.evidence import something_remains
from cboxlab.validation.diagnose.linear_model import BandErrors, build_linear_model, nuisance_columns, smooth_excess
from cboxlab.validation.diagnose.search import build_problem
from cboxlab.validation.predict import picture_errors

SHAPE = (3, 48, 48)


@pytest.fixture
def parts():
    """Base picture, ten smooth derivative pictures, a camera with a covariance."""
    generator = np.random.default_rng(5)
    v, u = np.mgrid[0 : SHAPE[1], 0 : SHAPE[2]] / SHAPE[1]
    base = 1000 * (1 + 0.3 * u)[None] * np.array([0.6, 1.0, 1.4])[:, None, None]
    derivative = np.array([np.sin((k + 1) * (u + 0.3 * k * v)) * base for k in range(10)])
    camera = Camera(48, 48, 60.0, np.array([23.5, 23.5]), 0.0, REFERENCE_ROTATION, np.zeros(3), 1e-4 * np.eye(10))
    return generator, base, derivative, camera


def model_of(
    measured,
    base,
    derivative,
    camera,
    scale=1.0,
    sigma=0.02,
    band_errors=(0, 0, 0),
    dark_error=0.0,
    lamp=None,
):
    fit = NuisanceFit(camera, scale, 0.001)
    return build_linear_model(
        measured=measured,
        base=base,
        variance=np.full(SHAPE, 25.0),
        used=np.ones(SHAPE, bool),
        coverage=np.ones((*SHAPE[1:], 1)),
        derivative=np.concatenate([scale * derivative, (base if lamp is None else lamp)[None]]),
        fit=fit,
        calibrated=camera,
        lamp_sigma=sigma,
        band_errors=BandErrors(np.array(band_errors), dark_error),
    )


def test_nuisances_within_their_priors_leave_nothing(parts):
    """A shift of one prior sigma in a camera parameter and of the lamp costs its prior, no more: chi2 of order 2."""
    _, base, derivative, camera = parts
    measured = base + 0.01 * derivative[3] + 0.02 * base
    model = model_of(measured, base, derivative, camera)
    raw = np.sum((measured - base) ** 2 / 25.0)
    assert raw > 1e4
    assert model.chi2 < 2.1  # the priors' own cost: (0.01 / 0.01)^2 + (0.02 / 0.02)^2 at most


def test_chi2_of_noise_is_the_count(parts):
    """Pure noise: chi2 of n + 11 rows less 11 directions is n on average, standard deviation sqrt(2 n)."""
    generator, base, derivative, camera = parts
    values = []
    for _ in range(40):
        model = model_of(base + 5 * generator.standard_normal(SHAPE), base, derivative, camera)
        values.append(model.chi2)
    count = np.prod(SHAPE)
    z = (np.mean(values) - count) / np.sqrt(2 * count / 40)
    assert abs(z) < 4  # false alarm 6e-5


def test_signature_keeps_only_what_nuisances_cannot_imitate(parts):
    _, base, derivative, camera = parts
    model = model_of(base, base, derivative, camera)
    noise = np.random.default_rng(1).standard_normal(SHAPE)
    assert np.linalg.norm(model.whiten(base)) < 1e-2 * np.linalg.norm(base / 5)  # the lamp's scale is a nuisance
    whitened = model.whiten(noise)
    assert np.allclose(model.project(whitened), whitened)
    assert np.allclose(model.basis.T @ whitened, 0, atol=1e-9)


def test_a_moved_camera_leaves_what_the_survey_says_of_it(parts):
    """Where the derivatives are exact, a motion's picture and its prior rows leave the same once projected."""
    _, base, derivative, camera = parts
    model = model_of(base, base, derivative, camera)
    change = 0.01 * np.random.default_rng(2).standard_normal(10)
    picture = model.whiten(np.tensordot(change, derivative, 1))
    np.testing.assert_allclose(model.camera_change(change), picture, atol=1e-9 * np.linalg.norm(change / 0.01))
    assert np.linalg.norm(picture) > 0.5 * np.linalg.norm(change / 0.01)


def test_a_lamps_power_leaves_what_its_stated_power_says_of_it(parts):
    """So it does where the derivative is of a picture with a further effect: 3 % more light in the left half. A lamp of
    a tenth would else take nine tenths of that effect off the residual."""
    _, base, derivative, camera = parts
    further = 0.03 * base * (np.indices(SHAPE)[2] < SHAPE[2] // 2)
    plain = model_of(base + further, base, derivative, camera)
    np.testing.assert_allclose(plain.lamp_change(0.3 * base), plain.whiten(0.3 * base), atol=1e-3)
    brighter, row = plain.lamp_change(0.3 * base), plain.count + 10
    np.testing.assert_allclose(brighter[row], plain.whiten(0.3 * base)[row], rtol=1e-3)
    assert np.linalg.norm(plain.lamp_change(0.3 * base)) == pytest.approx(0.3 / 0.02, rel=0.01)
    model = model_of(base + further, base, derivative, camera, lamp=base + further)
    predictor = SimpleNamespace(
        camera=camera,
        settings=SimpleNamespace(seed=1),
        signal=lambda effects: base * np.prod([effect.values["scale"] for effect in effects]),
    )
    dimmer = AppliedEffect(catalogue()["lamp-power"], {"scale": 0.1})
    change = build_problem(predictor, model, (), 1.0, np.zeros(SHAPE)).change(dimmer)
    remainder, cheated = (model.residual - change_of for change_of in (change, model.whiten(-0.9 * base)))
    assert np.sum(remainder[: model.count] ** 2) == pytest.approx(np.sum(model.residual[: model.count] ** 2), rel=0.01)
    assert np.sum(cheated[: model.count] ** 2) < 0.1 * np.sum(model.residual[: model.count] ** 2)


def test_smooth_excess_sees_what_chi2_does_not(parts):
    """A tenth of a sigma everywhere adds 0.01 to chi2 per sample, less than its scatter here; block means show it."""
    generator, base, derivative, camera = parts
    noise = 5 * generator.standard_normal(SHAPE)
    pattern = np.where((np.indices(SHAPE[1:])[0] // 16) % 2, 1.0, -1.0)
    quiet = model_of(base + noise, base, derivative, camera)
    flawed = model_of(base + noise + 0.5 * pattern, base, derivative, camera)
    blocks = np.prod(SHAPE) / 64
    scatter = np.sqrt(2 * blocks) / np.prod(SHAPE)
    assert abs(smooth_excess(quiet, quiet.residual)) < 5 * scatter
    assert smooth_excess(flawed, flawed.residual) > smooth_excess(quiet, quiet.residual) + 0.005


def test_a_line_is_left_though_noise_is_smaller_than_stated(parts):
    """Noise of 0.9 sigma and one row of 48 off by 3.8 sigma, up and down by turns: 1.11 of chi-square per sample."""
    generator, base, derivative, camera = parts
    noise = 4.5 * generator.standard_normal(SHAPE)
    line = np.zeros(SHAPE)
    line[:, 20] = 19.0 * (-1) ** (np.arange(SHAPE[2]) // 4)
    quiet, flawed = (model_of(base + change, base, derivative, camera) for change in (noise, noise + line))
    assert flawed.chi2 / flawed.count < 1.15
    assert not something_remains(quiet, quiet.residual, quiet.residual)
    assert something_remains(flawed, flawed.residual, flawed.residual)


def test_shared_errors_have_their_stated_size(parts):
    """One standard deviation: 0.07 % of each band by itself, 0.1 % of all bands on the one face, over noise of 5."""
    _, base, derivative, camera = parts
    scale = 0.9
    model = model_of(base, base, derivative, camera, scale)
    shared_errors = model.shared_errors[: np.prod(SHAPE)].T.reshape(-1, *SHAPE)
    assert len(shared_errors) == SHAPE[0] + 1
    for band, error in enumerate(shared_errors[:-1]):
        assert error[band] == pytest.approx(0.0007 * scale * base[band] / 5, rel=1e-5)
        assert not np.delete(error, band, axis=0).any()
    assert shared_errors[-1] == pytest.approx(0.001 * scale * base / 5, rel=1e-5)


def test_the_error_of_a_dark_level_is_each_bands_own(parts):
    """Where noise hardly exceeds a count's step; with more noise it is left out."""
    _, base, derivative, camera = parts
    model = model_of(base, base, derivative, camera, dark_error=0.2)
    offsets = model.shared_errors[: np.prod(SHAPE)].T.reshape(-1, *SHAPE)[: SHAPE[0]]
    assert model.dark_errors == SHAPE[0] and model.shared_errors.shape[1] == 2 * SHAPE[0] + 1
    for band, error in enumerate(offsets):
        assert error[band] == pytest.approx(0.2 / 5) and not np.delete(error, band, axis=0).any()
    fine = model_of(base, base, derivative, camera, dark_error=5e-4)
    assert fine.shared_errors.shape[1] == SHAPE[0] + 1


def test_levels_with_priors_are_errors_that_samples_share(parts):
    """An amplitude next to them is that of generalised least squares with their covariance, which has no rows."""
    generator, base, derivative, camera = parts
    model = model_of(base + 5 * generator.standard_normal(SHAPE), base, derivative, camera)
    change = np.linspace(1, 2, SHAPE[2]) ** 2 * np.ones(SHAPE)
    columns = 0.3 * np.eye(SHAPE[0])[:, :, None, None] * np.linspace(1, 2, SHAPE[2]) * np.ones(SHAPE)
    missed = np.array([1.5, -0.5, 0.0])
    with_levels = model.with_priors_of([column.ravel() for column in columns], missed)
    shape, levels = model.whiten(change), np.array([model.whiten(5 * column) for column in columns]).T
    residual = model.residual - levels @ missed
    weighted = shape - levels @ np.linalg.solve(np.eye(3) + levels.T @ levels, levels.T @ shape)
    narrowed = with_levels.whiten(change)
    assert narrowed @ narrowed == pytest.approx(weighted @ shape, rel=1e-9)
    assert narrowed @ narrowed < 0.9 * shape @ shape
    assert narrowed @ with_levels.residual == pytest.approx(weighted @ residual, rel=1e-9)
    assert with_levels.camera_change(np.ones(10)).size == with_levels.count + 3 + 11


def test_errors_of_dark_levels_gain_what_is_said(parts):
    """The mean over 400 draws of the chi2 that a change fitted to such errors gains; four of its standard errors."""
    generator, base, derivative, camera = parts
    model = model_of(base, base, derivative, camera, dark_error=2.0)
    change = model.whiten(np.ones(SHAPE) + 0.001 * base)
    errors = 2.0 * generator.standard_normal((400, SHAPE[0], 1, 1)) * np.ones(SHAPE)
    gains = [float(change @ model.whiten(error)) ** 2 / float(change @ change) for error in errors]
    assert model.gain_of_dark_errors(change) == pytest.approx(np.mean(gains), rel=4 * np.sqrt(2 / 400))
    assert model_of(base, base, derivative, camera).gain_of_dark_errors(change) == 0.0


def test_a_band_off_by_the_error_of_its_table_is_no_sign_of_an_effect(parts):
    """Of 1 % that one band is brighter, an error of 1 % takes all, one of 0.07 % twice itself."""
    generator, base, derivative, camera = parts
    brighter = base * np.array([1.01, 1.0, 1.0])[:, None, None]
    noise = 5 * generator.standard_normal(SHAPE)
    remainders = []
    for error in (0.0, 0.01):
        model = model_of(brighter + noise, base, derivative, camera, band_errors=(error, 0, 0))
        remainders.append(smooth_excess(model, model.without_shared_errors(model.residual)))
    quiet = model_of(base + noise, base, derivative, camera)
    noise_only = smooth_excess(quiet, quiet.residual)
    assert abs(remainders[1] - noise_only) < 0.1 * (remainders[0] - noise_only)
    assert remainders[0] > noise_only + 0.05


def test_columns_of_nuisances_do_what_their_covariance_does(parts, monkeypatch):
    """Information on 5 patterns and their products with the residual, by the inverse of a covariance with free
    nuisances and shared errors; some samples are not used, and they come in several blocks."""
    monkeypatch.setattr(sys.modules[picture_errors.__module__], "_SAMPLES_PER_BLOCK", 31)
    generator, base, derivative, camera = parts
    square = model_of(base + 5 * generator.standard_normal(SHAPE), base, derivative, camera)
    used = np.zeros(SHAPE, bool)
    used[:, 5:9, 3:20:2] = True
    count = int(used.sum())
    basis = np.linalg.qr(generator.standard_normal((count + 11, 12)))[0]
    shared = generator.standard_normal((count + 11, 7)).astype(np.float32)
    model = replace(square, used=used, sigma=np.full(count, 5.0), basis=basis, shared_errors=shared)
    residual = model.project(generator.standard_normal(count + 11))
    patterns = np.vstack([generator.standard_normal((count, 5)), np.zeros((11, 5))])
    weighted = np.linalg.solve(np.eye(count + 11) + 1e8 * basis @ basis.T + shared @ shared.T, patterns)
    nuisances = nuisance_columns(model)
    assert nuisances.num_free == 12 and not nuisances.picture[~used].any()
    along = nuisances.picture[used].T @ patterns[:count]
    assert np.allclose(patterns.T @ patterns - along.T @ along, weighted.T @ patterns, atol=1e-4)
    marginalised = nuisances.marginalised(model, residual)
    assert np.allclose(patterns[:count].T @ marginalised, weighted.T @ residual, atol=1e-4)


def test_several_changes_are_whitened_as_each_alone(parts):
    _, base, derivative, camera = parts
    model = model_of(base, base, derivative, camera)
    changes = np.random.default_rng(3).standard_normal((4, base.size))
    for counted in (model, model.counting(picture_errors(base, np.ones((*SHAPE[1:], 1)), model.used, model.sigma, []))):
        each = [counted.whiten_used(change) for change in changes]
        assert np.allclose(counted.whiten_used(changes), each, atol=1e-6)


def test_the_patches_of_residuals_are_eighths_of_the_picture(parts):
    """Numbered by rows, alike in all bands: 48 pixels make eight patches of six."""
    _, base, derivative, camera = parts
    patch = model_of(base, base, derivative, camera).patch.reshape(SHAPE)
    rows, columns = np.indices(SHAPE[1:])
    np.testing.assert_array_equal(patch, np.broadcast_to(8 * (rows // 6) + columns // 6, SHAPE))
