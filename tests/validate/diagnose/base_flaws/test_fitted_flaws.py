"""Flaws of a base: their evidence and an effect's amplitude next to them are those of the whole covariance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.base_flaws import FlawColumns, build_flaw_model
from cboxlab.validation.diagnose.base_flaws.fitted_flaws import FlawModel
from cboxlab.validation.predict import PictureErrors, sparse_columns

BANDS, SIDE = 5, 16
SIGNAL = np.full((BANDS, SIDE, SIDE), 100.0)

#: The picture's left half is one part, its right half another.
HALVES = np.broadcast_to(np.arange(SIDE) // (SIDE // 2), SIGNAL.shape).ravel()

#: One free nuisance that resembles the columns: a step across the picture's rows.
STEP = np.sign(np.arange(SIDE) - 5.5).repeat(SIDE) * np.ones((BANDS, 1)) / SIGNAL.size**0.5


@dataclass(frozen=True)
class Plain:
    """A linear model; noise of 1 % of the signal."""

    errors: PictureErrors | None = None
    count: int = SIGNAL.size
    basis: np.ndarray = field(default_factory=lambda: np.zeros((SIGNAL.size, 0)))

    @property
    def used(self):
        return np.ones(SIGNAL.shape, bool)

    @property
    def patch(self):
        return np.broadcast_to(np.arange(SIDE), SIGNAL.shape).ravel()

    @property
    def sigma(self):
        return np.ones(SIGNAL.size)

    @property
    def shared_errors(self):
        return np.zeros((SIGNAL.size, 0), np.float32)

    def project(self, vector):
        return vector - (vector @ self.basis) @ self.basis.T

    def counting(self, errors):
        return replace(self, errors=errors)


def columns(draw, number=6):
    """Two kinds of smooth columns of about the size of the noise."""
    rows = np.arange(SIDE) / SIDE
    waves = [np.cos(np.pi * (k + 1) * rows + draw.uniform(0, 6)) for k in range(number)]
    change = [np.broadcast_to(wave[:, None], SIGNAL.shape).ravel().astype(np.float32) for wave in waves]
    return FlawColumns(np.array(["shading:0", "field"] * (number // 2)), sparse_columns(change, SIGNAL.size), HALVES)


def covariance(model: FlawModel, width):
    prior = np.array([width[str(kind)] for kind in model.kind])
    dense = model.model.project(model.columns.toarray().T).T
    return np.eye(SIGNAL.size) + (dense * prior**2) @ dense.T


def test_scores_are_those_of_the_whole_covariance():
    draw = np.random.default_rng(5)
    column_values = columns(draw)
    free = Plain(basis=STEP.reshape(-1, 1))
    residual = free.project(draw.standard_normal(SIGNAL.size) + column_values.change @ [0.5, 0.3, 0, 0, 0, 0])
    model = build_flaw_model(free, column_values, SIGNAL, residual)
    whitened = model.whitened(residual)
    fitted = model.fit(whitened)
    joint = covariance(model, fitted.width)
    expected = whitened @ np.linalg.solve(joint, whitened) + np.linalg.slogdet(joint)[1]
    assert fitted.score == pytest.approx(expected, rel=1e-5)
    for factor in (0.7, 1.4):
        moved = replace(fitted, width={kind: factor * width for kind, width in fitted.width.items()})
        assert model.score(moved, whitened) > fitted.score


def test_an_amplitude_with_flaws_is_that_of_generalised_least_squares():
    draw = np.random.default_rng(6)
    column_values = columns(draw)
    shape = draw.standard_normal((SIGNAL.size, 1)) * 0.05 + column_values.change.toarray()[:, 2:3]
    residual = draw.standard_normal(SIGNAL.size) + 2 * shape[:, 0]
    free = Plain(basis=STEP.reshape(-1, 1))
    model = build_flaw_model(free, column_values, SIGNAL, draw.standard_normal(SIGNAL.size))
    fitted = model.fit(model.whitened(residual - 2 * shape[:, 0]))
    expected = np.linalg.solve(covariance(model, fitted.width), shape)
    assert model.weighted(fitted, shape) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("error", [0.0, 0.004])
def test_deviations_of_single_pixels_are_those_that_bands_have_in_common(error):
    """Four standard errors over 256 pixels: of 1.3 from five bands of noise 1, over an expected square of 0.4^2."""
    draw = np.random.default_rng(7)
    alike = np.broadcast_to(error * 100 * draw.standard_normal((SIDE, SIDE)), SIGNAL.shape).ravel()
    residual = draw.standard_normal(SIGNAL.size) + alike
    model = build_flaw_model(Plain(), columns(draw), SIGNAL, residual)
    scatter = np.sqrt(2 / SIDE**2) * (100 * error) ** 2 + np.sqrt(2 / (BANDS * (BANDS - 1))) / SIDE
    assert abs((100 * model.pixel_error) ** 2 - (100 * error) ** 2) < 4 * scatter


def test_a_flaw_that_is_everywhere_is_seen_where_it_was_not_fitted():
    """Most of its column is a free nuisance, which the residual lacks."""
    draw, free = np.random.default_rng(8), Plain(basis=STEP.reshape(-1, 1))
    values = columns(draw)
    with_step = values.change.toarray().T
    with_step[0] += 5 * STEP.ravel() * SIGNAL.size**0.5
    kinds = np.array(["shading:0", *["field"] * 5])
    values = replace(values, kind=kinds, change=sparse_columns(with_step, SIGNAL.size))
    shading = free.project(values.change @ [1, 0, 0, 0, 0, 0])
    residual = free.project(draw.standard_normal(SIGNAL.size) + shading)
    model = build_flaw_model(free, values, SIGNAL, residual)
    whitened = model.whitened(residual)
    first, *_ = (flaw for flaw in model.flaws(model.fit(whitened), whitened) if flaw.kind != "pixels")
    assert first.kind == "shading" and first.heldout > 0.7
    assert first.chi2_per_dof == pytest.approx(np.mean(shading**2), rel=0.2)


def test_single_pixels_count_as_evidence_and_are_taken_off_as_likely_as_they_are():
    """Against the covariance by noise, columns and pixels, written out."""
    draw = np.random.default_rng(9)
    column_values = columns(draw)
    alike = np.broadcast_to(0.4 * draw.standard_normal((SIDE, SIDE)), SIGNAL.shape).ravel()
    residual = draw.standard_normal(SIGNAL.size) + alike + column_values.change @ [0, 1, 0, 0, 0, 0]
    model = build_flaw_model(Plain(), column_values, SIGNAL, residual)
    fitted = model.fit(model.whitened(residual))
    prior, change = np.array([fitted.width[str(kind)] for kind in model.kind]), column_values.change.toarray().T
    smallest, flaws = ((change.T * width**2) @ change for width in (np.full(6, 0.01), prior))
    pixel = np.tile(np.arange(SIDE**2), BANDS)
    flaws += (100 * model.pixel_error) ** 2 * (pixel[:, None] == pixel)
    none, flawed = np.eye(SIGNAL.size) + smallest, np.eye(SIGNAL.size) + flaws
    first, last = (residual @ np.linalg.solve(each, residual) + np.linalg.slogdet(each)[1] for each in (none, flawed))
    assert model.nothing - fitted.score == pytest.approx(first - last, abs=0.1)
    assert first - last > 50 and not model.beyond_flaws
    taken_off = model.change_dn(fitted, residual)
    np.testing.assert_allclose(taken_off, flaws @ np.linalg.solve(flawed, residual), atol=2e-3)
    of_field = np.where(np.arange(6) % 2, prior**2, 0.0)
    expected = (change.T * of_field) @ change @ np.linalg.solve(flawed, residual)
    np.testing.assert_allclose(model.kind_dn(fitted, "field"), expected, atol=2e-3)


def test_pixels_that_deviate_by_a_percent_are_no_flaw():
    draw = np.random.default_rng(10)
    alike = np.broadcast_to(draw.standard_normal((SIDE, SIDE)), SIGNAL.shape).ravel()
    model = build_flaw_model(Plain(), columns(draw), SIGNAL, draw.standard_normal(SIGNAL.size) + alike)
    assert model.beyond_flaws and model.pixel_error == pytest.approx(0.01, rel=0.2)
