"""Fields next to others, against least squares with all columns written out."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.diagnose.field_fit import (
    NormalEquations,
    each_band,
    fixed_spectrum,
    free_spectrum,
    next_to_common_field,
    pixel_fit,
    solve_coefficients,
)
from cboxlab.validation.diagnose.field_fit.field import (
    _likeliest_prior,
    _neighbours_correlation,
    _PixelPrior,
    _pixels_under_prior,
    _single_pixels,
    cross_validate,
)
from cboxlab.validation.diagnose.field_fit.fitted_explanation import scaled
from numpy.testing import assert_allclose
from scipy.sparse import csr_matrix
from scipy.stats import multivariate_normal, norm

BANDS, PIXELS, NUMBERS, NUISANCES = 3, 60, 4, 2


def test_a_field_of_one_band_with_one_of_all_is_that_of_least_squares():
    """The gain of both fields together, less that of the one of all bands; priors too wide to matter."""
    draw = np.random.default_rng(8)
    columns = draw.normal(size=(BANDS, PIXELS, NUMBERS))
    known_changes = np.linalg.qr(draw.normal(size=(BANDS * PIXELS, NUISANCES)))[0]
    everywhere, alone = columns.reshape(-1, NUMBERS), np.zeros((BANDS, PIXELS, NUMBERS))
    alone[1] = columns[1]
    alone = alone.reshape(-1, NUMBERS)
    residual = 30 * (everywhere @ draw.normal(size=NUMBERS) + alone @ draw.normal(size=NUMBERS))
    residual += draw.normal(size=len(residual))
    residual -= known_changes @ (known_changes.T @ residual)
    per_band, nuisances = residual.reshape(BANDS, PIXELS), known_changes.reshape(BANDS, PIXELS, NUISANCES)

    a, b = columns.swapaxes(1, 2) @ columns, np.einsum("bpk,bp->bk", columns, per_band)
    n = NormalEquations(a, b, nuisances.swapaxes(1, 2) @ columns, a, b)
    spectrum_fit = fixed_spectrum(next_to_common_field(n), np.eye(BANDS)[1])

    common, both = (_fitted(residual, [known_changes, *parts]) for parts in ([everywhere], [everywhere, alone]))
    assert_allclose(spectrum_fit.coefficients[[0, 2]], 0)
    assert_allclose(spectrum_fit.coefficients[1], both[0][-NUMBERS:], rtol=1e-3)
    assert_allclose(spectrum_fit.gain, both[1] - common[1], rtol=1e-4)


def test_a_common_field_that_differs_between_parts_spoils_no_prediction():
    """Bands moved apart by 1, 0 and -1; all bands by 3 where they are fitted, by -3 in the part held out."""
    a = np.full((BANDS, 1, 1), 200.0)
    moved = np.array([1.0, 0.0, -1.0])[:, None]
    trial_b, held_out_b = 100 * (moved + 3), 100 * (moved - 3)
    n = NormalEquations(a, trial_b + held_out_b, np.zeros((BANDS, 0, 1)), a / 2, trial_b)
    fit = each_band(next_to_common_field(n))
    assert_allclose(fit.coefficients, moved, atol=0.02)
    assert fit.heldout == pytest.approx(1.0, abs=0.02)


def test_a_change_that_nuisances_imitate_may_round_to_less_than_nothing():
    """As a displacement that the camera makes: columns of single precision leave -4 of 2e6, more than the prior of the
    other number, 1.5 in both bands together, allows for. That number is 3 in the first band and 0 in the second."""
    a = np.broadcast_to(np.diag([1e6, 100.0]), (2, 2, 2))
    imitated = np.sqrt(2e6) * (1 + 1e-6) / 2
    n = NormalEquations(a, np.array([[0.0, 300.0], [0.0, 0.0]]), np.array([[[imitated, 0.0]]] * 2), a, np.zeros((2, 2)))
    spectrum_fit = fixed_spectrum(next_to_common_field(n), np.eye(2)[0])
    assert_allclose(spectrum_fit.coefficients, [[0, 3], [0, 0]], atol=0.1)


def _fitted(residual, columns):
    """Coefficients and the chi2 that they gain."""
    columns = np.hstack(columns)
    best = np.linalg.lstsq(columns, residual, rcond=None)[0]
    return best, residual @ residual - np.sum((residual - columns @ best) ** 2)


def test_a_field_that_nuisances_imitate_and_a_trial_sees_in_part_is_none():
    """Two numbers that do the same, as camera and lamp do."""
    a = np.ones((1, 2, 2))
    n = NormalEquations(a, np.zeros((1, 2)), np.array([[[1.0, 1.0]]]), a, np.array([[3.0, 3.0]]))
    spectrum_fit = fixed_spectrum(n, np.ones(1))
    assert spectrum_fit.gain == 0 and np.isfinite(spectrum_fit.heldout)


@pytest.mark.parametrize("kind", [np.array, csr_matrix])
def test_maps_are_multiplied_by_an_image(kind):
    rng = np.random.default_rng(1)
    maps, image = rng.random((4, 6)) * (rng.random((4, 6)) > 0.3), rng.uniform(2, 3, (2, 3))
    products = scaled(kind(maps.astype(np.float32)), image)
    assert products.dtype == np.float32
    assert_allclose(products @ np.eye(6), maps * image.ravel(), rtol=1e-6)


def test_equations_of_sums_of_images_are_those_of_their_columns():
    """Two sums of three images, against products of the summed columns themselves."""
    draw = np.random.default_rng(5)
    columns, residual = draw.normal(size=(BANDS, PIXELS, 3)), draw.normal(size=(BANDS, PIXELS))
    nuisances, parts = draw.normal(size=(BANDS, PIXELS, NUISANCES)), draw.normal(size=(2, 3))

    def products(x):
        y = x[:, ::2]
        tested = y.swapaxes(1, 2) @ y, np.einsum("bpk,bp->bk", y, residual[:, ::2])
        return NormalEquations(
            x.swapaxes(1, 2) @ x, np.einsum("bpk,bp->bk", x, residual), nuisances.swapaxes(1, 2) @ x, *tested
        )

    sums, expected = products(columns).of_sums(parts), products(columns @ parts.T)
    for name in ("a", "b", "c", "trial_a", "trial_b"):
        assert_allclose(getattr(sums, name), getattr(expected, name), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("part", [0.05, 0.6, 1.0])
def test_pixels_under_a_prior_are_by_bayes_theorem(part):
    """A number is 0, or normal with the prior's width; it is measured with variance 1 / h."""
    h, measured, width = np.array([0.5, 2.0, 8.0]), np.array([-3.0, 0.4, 1.5]), 1.7
    deviating, silent = (norm(0, np.sqrt(v)).pdf(measured) for v in (width + 1 / h, 1 / h))
    probability = part * deviating / (part * deviating + (1 - part) * silent)
    mean, probabilities = _pixels_under_prior(h, h * measured, _PixelPrior(width, part, 0.0))
    assert_allclose(probabilities, probability)
    assert_allclose(mean, probability * measured * width / (width + 1 / h))


def _equations(seed=3, scatter=2.0, coupled=0.6):
    """A field of each band, the nuisances, all columns written out, the residual, and their normal equations.

    coupled : part of the nuisances that the field makes.
    """
    draw = np.random.default_rng(seed)
    columns = draw.normal(size=(BANDS, PIXELS, NUMBERS)) * np.array([3.0, 1.0, 0.3, 0.1])
    every = np.zeros((BANDS, PIXELS, BANDS, NUMBERS))
    every[range(BANDS), :, range(BANDS)] = columns
    every = every.reshape(BANDS * PIXELS, BANDS * NUMBERS)
    by_field = every @ draw.normal(size=(BANDS * NUMBERS, NUISANCES))
    other = draw.normal(size=by_field.shape)
    parts = ((coupled, by_field), (1 - coupled, other))
    nuisances = np.linalg.qr(sum(part * changes / np.linalg.norm(changes, axis=0) for part, changes in parts))[0]
    residual = every @ draw.normal(size=BANDS * NUMBERS) * scatter + draw.normal(size=len(every))
    residual -= nuisances @ (nuisances.T @ residual)
    a, b = columns.swapaxes(1, 2) @ columns, np.einsum("bpk,bp->bk", columns, residual.reshape(BANDS, PIXELS))
    half = columns[:, ::2]
    trial = half.swapaxes(1, 2) @ half, np.einsum("bpk,bp->bk", half, residual.reshape(BANDS, PIXELS)[:, ::2])
    c = nuisances.reshape(BANDS, PIXELS, NUISANCES).swapaxes(1, 2) @ columns
    return every - nuisances @ (nuisances.T @ every), residual, NormalEquations(a, b, c, *trial)


def test_the_width_of_the_prior_is_that_of_the_largest_evidence():
    """Twice its logarithm over that of noise alone, by the densities of the residual; no other width has more."""
    every, residual, _ = _equations()
    h, b = every.T @ every, every.T @ residual
    x, evidence, freedom, width = solve_coefficients(h, b)

    def twice_the_log(variance):
        covariance = np.eye(len(residual)) + variance * every @ every.T
        none = multivariate_normal(cov=np.eye(len(residual))).logpdf(residual)
        return 2 * (multivariate_normal(cov=covariance).logpdf(residual) - none)

    assert evidence == pytest.approx(twice_the_log(width), rel=1e-6)
    assert evidence > max(twice_the_log(width / 2), twice_the_log(width * 2))
    ridge = h + np.eye(len(h)) / width
    assert_allclose(x, np.linalg.solve(ridge, b), rtol=1e-6)
    assert freedom == pytest.approx(np.trace(np.linalg.solve(ridge, h)))
    assert_allclose(cross_validate(h, b, width), x, rtol=1e-6)


def test_separate_maps_of_bands_that_nuisances_couple_are_those_of_all_columns_together():
    """Each band's prior has the width of that band alone; the evidence is that of one prior with these widths."""
    every, residual, n = _equations()
    fit = each_band(n)
    widths = [solve_coefficients(a - c.T @ c, b)[3] for a, b, c in zip(n.a, n.b, n.c, strict=True)]
    prior, h, b = np.diag(1 / np.repeat(widths, NUMBERS)), every.T @ every, every.T @ residual
    x = np.linalg.solve(h + prior, b)
    assert_allclose(fit.coefficients.ravel(), x, rtol=1e-6)
    assert fit.gain == pytest.approx(residual @ residual - np.sum((residual - every @ x) ** 2))
    volume = np.linalg.slogdet(np.eye(len(h)) + np.linalg.solve(prior, h))[1]
    assert fit.evidence == pytest.approx(b @ x - volume)
    free = [np.trace(np.linalg.solve(a + np.eye(NUMBERS) / t, a)) for a, t in zip(n.a, widths, strict=True)]
    assert fit.freedom == pytest.approx(sum(free))


def test_a_free_spectrum_is_the_best_for_its_map_and_pays_for_each_band_but_one():
    """By least squares over all columns; twice the logarithm of the evidence falls by that of the gain."""
    every, residual, n = _equations(coupled=0.9)
    fit = free_spectrum(n)
    column = np.argmax(np.abs(fit.coefficients).max(axis=0))
    spectrum = fit.coefficients[:, column] / fit.coefficients[np.argmax(np.abs(fit.coefficients[:, column])), column]
    image = fit.coefficients[np.argmax(np.abs(spectrum))]
    by_band = np.einsum("nbk,k->nb", every.reshape(-1, BANDS, NUMBERS), image)
    assert_allclose(np.linalg.lstsq(by_band, residual, rcond=None)[0], spectrum, atol=2e-3)
    fixed = fixed_spectrum(n, spectrum)
    assert fit.gain == pytest.approx(fixed.gain, rel=1e-6)
    assert fit.freedom == pytest.approx(fixed.freedom + BANDS - 1)
    assert fit.evidence == pytest.approx(fixed.evidence - (BANDS - 1) * np.log(fit.gain), rel=1e-6)


def test_what_is_held_out_and_opposite_is_not_predicted():
    """A number of 1 where it is fitted: -1/3 in the pixels held out, a quarter of all, and -1 in every other band."""
    a, trial_a = np.full((4, 1, 1), 4e4), np.full((4, 1, 1), 3e4)
    n = NormalEquations(a, np.full((4, 1), 2.67e4), np.zeros((4, 0, 1)), trial_a, np.full((4, 1), 3e4))
    assert fixed_spectrum(n, np.eye(4)[0]).heldout == pytest.approx(-(2 / 3 + 1) / 3, abs=0.02)
    opposite = np.array([1.0, -0.2, 1.0, -0.2])[:, None]
    n = NormalEquations(a, 4e4 * opposite, np.zeros((4, 0, 1)), trial_a, 3e4 * opposite)
    # trials: 1, which gains 1 and loses 1.4 in the others; -0.2, which gains 0.04 and loses 0.44
    assert fixed_spectrum(n, np.ones(4)).heldout_bands == pytest.approx(-(1.4 + 0.44) / 1.04, abs=0.01)


def test_a_common_field_is_fitted_again_to_what_is_held_out():
    """Of parts with other weights in each band: deviations are from the mean with these weights."""
    share, moved = np.array([0.3, 0.5, 0.7])[:, None], np.array([1.0, 0.0, -1.0])[:, None]
    a = np.full((BANDS, 1, 1), 2e6)
    trial_a, trial_b, held_out_b = share[..., None] * a, 2e6 * share * (moved + 3), 2e6 * (1 - share) * (moved - 3)
    n = next_to_common_field(NormalEquations(a, trial_b + held_out_b, np.zeros((BANDS, 0, 1)), trial_a, trial_b))
    off = 0.4 / 1.5
    assert_allclose(n.trial_b, 2e6 * share * (moved + off), atol=20)
    assert_allclose(n.held_out_b, 2e6 * (1 - share) * (moved - off), atol=20)


def test_the_prior_of_pixels_has_the_largest_evidence_of_a_mixture():
    """Three of a hundred pixels deviate; the evidence is that of the densities, and no other prior has more."""
    draw = np.random.default_rng(6)
    h = draw.uniform(0.5, 2.0, 400)
    numbers = np.where(draw.random(400) < 0.03, 15 * draw.normal(size=400), 0.0)
    measured = numbers + draw.normal(size=400) / np.sqrt(h)
    prior = _likeliest_prior(h, h * measured)

    def twice_the_log(width, part):
        silent, deviating = (norm(0, np.sqrt(v)).pdf(measured) for v in (1 / h, width + 1 / h))
        return 2 * float(np.log(part * deviating / silent + (1 - part)).sum())

    assert prior.part == 0.03 and 100 < prior.width < 1000
    assert prior.evidence == pytest.approx(twice_the_log(prior.width, prior.part))
    others = [(prior.width * f, part) for f in (1 / 3, 1, 3) for part in (1.0, 0.3, 0.1, 0.03, 0.01)]
    assert prior.evidence >= max(twice_the_log(*other) for other in others) - 1e-9


def test_a_single_pixel_is_less_the_mean_of_its_used_neighbours():
    draw = np.random.default_rng(7)
    size = draw.uniform(1, 2, (2, 5, 6)) * (draw.random((5, 6)) > 0.3)
    product = size * draw.normal(size=(2, 5, 6))
    total = size.sum(axis=0)
    numbers = product.sum(axis=0) / np.where(total > 0, total, 1)
    for (row, column), value in np.ndenumerate(_single_pixels(product, size)):
        near = [
            (y, x)
            for y in range(max(row - 1, 0), min(row + 2, 5))
            for x in range(max(column - 1, 0), min(column + 2, 6))
            if (y, x) != (row, column) and total[y, x] > 0
        ]
        mean = np.mean([numbers[neighbour] for neighbour in near]) if near else None
        expected = numbers[row, column] - mean if total[row, column] > 0 and near else 0.0
        assert value == pytest.approx(expected)


def test_neighbours_are_alike_in_pairs_and_not_by_a_common_level():
    """Pairs of columns share their number: half of all neighbours in a row, less what the local mean takes."""
    draw, size = np.random.default_rng(8), np.ones((2, 40, 40))
    single = draw.normal(size=(40, 40))
    assert _neighbours_correlation(np.stack([single + 100] * 2), size) < 0.05
    pairs = np.repeat(draw.normal(size=(40, 20)), 2, axis=1)
    assert _neighbours_correlation(np.stack([pairs + 100] * 2), size) == pytest.approx(0.47, abs=0.06)


def test_numbers_of_single_pixels_gain_their_squares_and_are_tested_in_other_bands():
    """Pixels far apart, by ten standard deviations in each band; in the last band the other way round."""
    draw, shape = np.random.default_rng(9), (4, 24, 24)
    odd = np.zeros(shape[1:])
    odd[2::4, 2::4] = draw.choice([-1.0, 1.0], (6, 6))
    signs = np.array([1.0, 1.0, 1.0, -1.0])[:, None, None]
    operator, weight = np.full(shape, 5.0), np.full(shape, 2.0)
    for last, heldout in ((1.0, 1.0), (-1.0, -1.0)):
        excess = odd * np.where(signs < 0, last, 1.0)
        data = SimpleNamespace(weight=weight, marginal_residual=10 * excess + 0.3 * draw.normal(size=shape))
        fit, _ = pixel_fit(data, operator)
        mean = excess.mean(axis=0)
        assert fit.gain == pytest.approx(400 * np.sum(mean**2), rel=0.15)
        assert fit.heldout == pytest.approx(heldout, abs=0.25)
        assert_allclose(fit.coefficients[0].reshape(shape[1:])[odd != 0], mean[odd != 0], atol=0.1)
