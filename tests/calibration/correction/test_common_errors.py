"""Errors that many pixels or bands have in common: those of the noise that was measured, and of a sensitivity."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from cboxlab.calibration.correction.corrected_bands import CorrectedBands
from cboxlab.calibration.correction.noise import NoiseModel, _samples_of_picture

#: Variance of a count without charge and per charge, with their standard deviations, DN^2 and DN.
LINE, SIGMAS = np.array([4.0, 0.25]), np.array([0.2, 0.02])


def line_and_draws(correlation):
    """The noise model of the line, and 200,000 lines drawn with its covariance: a sigma has an error of 0.2 %."""
    covariance = np.outer(SIGMAS, SIGMAS) * np.array([[1, correlation], [correlation, 1]])
    read_e = np.sqrt(LINE[0]) / LINE[1]
    noise = NoiseModel(1 / LINE[1], 0.1, read_e, 0.1, (), "flats", 0.0, (*np.diag(covariance), covariance[0, 1]))
    return noise, np.random.default_rng(9).multivariate_normal(LINE, covariance, 200_000)


def bands_of(coefficients, mask, scatter=0.0):
    images = xr.Dataset({"mask": (("band", "y", "x"), np.asarray(mask, np.uint8))})
    return CorrectedBands(images, coefficients, {}, (), pixel_scatter=scatter)


@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.9])
def test_the_common_error_is_that_of_lines_drawn_with_their_covariance(correlation):
    noise, lines = line_and_draws(correlation)
    sums = lines / LINE @ [0.3, 0.6]
    assert noise.relative_sigma(0.3, 0.6) == pytest.approx(np.std(sums), rel=0.02)


@pytest.mark.parametrize("correlation", [-0.9, 0.9])
def test_the_common_error_of_bands_counts_what_is_proportional_to_either(correlation):
    """Variances c0 + c1 S + c2 S^2 of pixels of unequal signals, where c2 holds the scatter of sensitivities, too."""
    noise, lines = line_and_draws(correlation)
    rng, scatter = np.random.default_rng(3), 0.01
    of_floor, of_shot, of_flat = rng.uniform(0.5, 2, (3, 2, 4, 5)) * np.array([1, 1, 3e-3])[:, None, None, None]
    signal = rng.uniform(-5, 300, (2, 4, 5))
    light = np.maximum(signal, 0)
    coefficients = np.stack([of_floor * LINE[0], of_shot * LINE[1], of_flat * LINE[1] + scatter**2], axis=1)
    bands = bands_of(coefficients, np.zeros(signal.shape), scatter)
    variance, used = bands.predicted_variance(signal) + 2.0, np.ones(signal.shape, bool)
    used[0, 1] = False
    factors = of_floor, of_shot * light + of_flat * light**2
    sums = lines @ [float(np.mean(factor[used] / variance[used])) for factor in factors]
    assert bands.variance_sigma(signal, variance, used, noise) == pytest.approx(np.std(sums), rel=0.02)


def test_a_pixels_sensitivity_makes_the_mean_of_its_bands_as_uncertain_as_one():
    """Errors that count as independent: the mean over the bands that see a pixel has the scatter of one sensitivity."""
    scatter, mask = 0.02, np.zeros((3, 1, 3))
    mask[0, 0, 1] = mask[0, 0, 2] = mask[2, 0, 2] = 1
    signal = np.array([100.0, 400.0, 900.0])[:, None, None] * np.ones(mask.shape)
    bands = bands_of(np.zeros((3, 3, 1, 3)), mask, scatter)
    relative = (bands.shared_variance(signal) + (scatter * signal) ** 2) / signal**2
    for x, count in enumerate((3, 2, 1)):
        used = mask[:, 0, x] == 0
        assert used.sum() == count
        assert relative[used, 0, x].sum() / count**2 == pytest.approx(scatter**2)


@pytest.mark.parametrize("cell", [None, (2, 2)])
def test_variances_of_neighbouring_pixels_scatter_as_their_degrees_of_freedom_state(cell):
    """Sixty pictures of twelve levels: a pooled standard deviation has an error of 3 %, the degrees are rounded."""
    rng, light = np.random.default_rng(1), np.linspace(200, 1000, 40) * np.ones((40, 1))
    deviations = []
    for _ in range(60):
        frame = np.rint(light + np.sqrt(4 + 0.1 * light) * rng.standard_normal(light.shape))[None]
        capture = SimpleNamespace(frames=lambda _, frame=frame: frame, saturation_dn=4000, cell=cell)
        samples = _samples_of_picture(capture, None, np.zeros(light.shape))
        relative = [s.variance[0] / (4 + 1 / 12 + 0.1 * s.charge[0]) - 1 for s in samples]
        deviations += [r / np.sqrt(2 / s.degrees) for r, s in zip(relative, samples, strict=True)]
    assert len(deviations) == 720
    assert np.std(deviations) == pytest.approx(1.0, abs=0.15) and abs(np.mean(deviations)) < 4 / np.sqrt(720)
