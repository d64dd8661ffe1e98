"""Fields next to others, against least squares with all columns written out."""

import numpy as np
import pytest
from cboxlab.validation.diagnose.field_fit import NormalEquations, each_band, fixed_spectrum, next_to_common_field
from cboxlab.validation.diagnose.field_fit.field import _PixelPrior, _pixels_under_prior
from cboxlab.validation.diagnose.field_fit.fitted_explanation import scaled
from numpy.testing import assert_allclose
from scipy.sparse import csr_matrix
from scipy.stats import norm

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
