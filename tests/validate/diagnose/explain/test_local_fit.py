"""What an effect leaves in the very places where it acts."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.explain.local_fit import misfit
from helpers.captures.small_excess import SIGNAL, small_excess
from scipy.ndimage import correlate

#: Exchange with all four neighbours, and with those along the rows.
ROUND = np.array([[[0, 1, 0], [1, -4, 1], [0, 1, 0]]]) / 4
LINE = np.array([[[0, 0, 0], [1, -2, 1], [0, 0, 0]]]) / 2


def _misfit(data, shape):
    """Misfit of an effect of one number with this shape (band, y, x), DN, at its best amplitude."""
    change = data.whitened(shape)
    amplitude = np.sum(change * data.residual) / np.sum(change**2)
    change = amplitude * change
    gain = float(np.sum(change**2))
    return misfit(data, change[data.used], (data.residual - change)[data.used], gain)


@pytest.mark.parametrize("true", [True, False])
def test_a_round_blur_does_not_fit_what_a_line_left_at_each_edge(true):
    """Along a line edges across are blurred twice as much as a round blur of the same size says, others not at all."""
    data = small_excess(0.4 * correlate(SIGNAL, ROUND if true else LINE, mode="nearest"))
    unfitted = _misfit(data, correlate(SIGNAL, ROUND, mode="nearest"))
    assert unfitted < 2 if true else unfitted > 5


@pytest.mark.parametrize("true", [True, False])
def test_a_glare_of_all_bands_does_not_fit_one_band(true):
    glare = np.broadcast_to(SIGNAL.mean(axis=(1, 2), keepdims=True), SIGNAL.shape)
    of_bands = np.ones(len(SIGNAL)) if true else np.eye(len(SIGNAL))[0]
    unfitted = _misfit(small_excess(0.02 * glare * of_bands[:, None, None]), glare)
    assert unfitted < 2 if true else unfitted > 5


def test_errors_that_many_samples_share_are_no_misfit():
    """A flaw of the base that is counted as an error may have any size where an effect acts."""
    effect = 0.02 * np.broadcast_to(SIGNAL.mean(axis=(1, 2), keepdims=True), SIGNAL.shape)
    flaw = 0.01 * SIGNAL * np.linspace(-1, 1, SIGNAL.shape[2])
    data = small_excess(effect + flaw)
    column = 1e4 * (flaw * data.weight) / np.linalg.norm(flaw * data.weight)
    scaled = column / np.sqrt(1 + 1e8)
    counted = replace(data, nuisances=np.concatenate([data.nuisances, scaled[..., None]], axis=-1).astype(np.float32))
    assert _misfit(data, effect) > 3 * _misfit(counted, effect) + 3


def test_noise_alone_leaves_about_nothing():
    draw, shape = np.random.default_rng(5), 0.02 * SIGNAL.mean(axis=(1, 2), keepdims=True) * np.ones_like(SIGNAL)
    data = small_excess(np.zeros_like(SIGNAL))
    several = []
    for _ in range(20):
        noise = draw.standard_normal(data.used.shape) * data.used
        several.append(misfit(data, (shape * data.weight)[data.used], noise[data.used], 1e4))
    assert np.mean(several) < 0.7
