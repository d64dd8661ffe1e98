"""Prediction of what was held out: a true cause has one amplitude everywhere, an effect that resembles it has not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.validation.diagnose.alternatives import (
    _heldout_bands,
    heldout_bands,
    heldout_pixels,
    is_edge_artefact,
)
from cboxlab.validation.diagnose.linear_model import LinearModel

SHAPE = (4, 64, 64)
COUNT = int(np.prod(SHAPE))


@pytest.fixture
def model():
    everywhere = np.ones(SHAPE, bool)
    return LinearModel(
        used=everywhere,
        interior=np.ones(COUNT, bool),
        patch=np.zeros(COUNT, int),
        sigma=np.ones(COUNT),
        priors=np.zeros((11, 11)),
        by_lamp=np.ones(COUNT),
        basis=np.zeros((COUNT + 11, 11)),
        shared_errors=np.zeros((COUNT + 11, 1)),
        residual=np.zeros(COUNT + 11),
    )


@pytest.fixture
def shape():
    """A smooth picture, stronger from band to band."""
    v, u = np.mgrid[0:64, 0:64] / 64
    return np.append(((1 + u * v) * np.array([0.5, 1, 1.5, 2])[:, None, None]).ravel(), np.zeros(11))


def test_a_true_cause_predicts_what_was_held_out(model, shape):
    """Noise of 1 per sample costs the held-out gain about 1 of 16384 s^2: both ratios are 1 within 5 per cent."""
    noise = np.random.default_rng(3).standard_normal(len(shape))
    residual = 0.3 * shape + noise
    assert heldout_pixels(model, residual, shape) == pytest.approx(1, abs=0.05)
    assert heldout_bands(model, residual, shape) == pytest.approx(1, abs=0.05)


def test_a_shape_that_only_fits_one_band_fails_in_the_others(model, shape):
    residual = shape.copy()
    residual[: COUNT // 2] *= -1  # the two weaker bands want the opposite sign
    residual[3 * COUNT // 4 : COUNT] *= 0
    assert heldout_bands(model, residual, shape) < 0.5


def test_a_shape_that_only_fits_every_other_block_fails_in_the_rest(model, shape):
    rows, columns = np.indices((64, 64)) // 16
    residual = shape.copy()
    residual[:COUNT] *= np.tile(np.where((rows + columns) % 2, 1.0, -0.6).ravel(), 4)
    assert heldout_pixels(model, residual, shape) < 0.5


def test_one_band_alone_cannot_be_predicted_from_the_others(model, shape):
    even = shape.copy()
    shape[: 3 * COUNT // 4] = 0
    assert np.isnan(heldout_bands(model, 0.3 * shape, shape))
    # what makes up for one band in the others is no test of it
    of_one, of_all = (AppliedEffect(catalogue()["band-gain"], values) for values in ({"band": "b", "scale": 1.01}, {}))
    assert np.isnan(_heldout_bands(SimpleNamespace(applied=of_one), model, 0.3 * even, even))
    assert _heldout_bands(SimpleNamespace(applied=of_all), model, 0.3 * even, even) == pytest.approx(1)


def test_the_ratios_of_a_cause_that_is_weaker_in_one_part(model):
    """Shape 1 everywhere, residual 1, but k in every other block, or in the last band: gains by hand.

    An amplitude a gains 2 a r - a^2 in a sample of residual r.
    """

    def gain(amplitude, residual):
        return 2 * amplitude * residual - amplitude**2

    k, even = 0.5, np.append(np.ones(COUNT), np.zeros(11))
    rows, columns = np.indices((64, 64)) // 16
    blocks = np.append(np.tile(np.where((rows + columns) % 2, 1.0, k).ravel(), 4), np.zeros(11))
    expected = (gain(1, k) + gain(k, 1)) / (gain(1, 1) + gain(k, k))
    assert heldout_pixels(model, blocks, even) == pytest.approx(expected, rel=1e-9)
    last = np.append(np.repeat([1.0, 1.0, 1.0, k], COUNT // 4), np.zeros(11))
    everywhere, without = (3 + k) / 4, (2 + k) / 3
    expected = (3 * gain(without, 1) + gain(1, k)) / (3 * gain(everywhere, 1) + gain(everywhere, k))
    assert heldout_bands(model, last, even) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("inside", "at_edges", "part", "expected"),
    [
        (1.0, 1.0, 0.5, False),
        (0.3, 1.3, 0.5, True),
        (0.9, 1.2, 0.5, False),  # an error of the shape
        (1.3, 0.3, 0.5, False),  # edges are less sure than faces
        (0.3, 1.3, 0.1, False),  # an effect that edges alone show
    ],
)
def test_steps_at_edges_alone_are_no_change_of_a_whole_face(model, inside, at_edges, part, expected):
    """part : of the square of the change that lies inside faces."""
    within = np.arange(COUNT) < part * COUNT
    noise = 0.01 * np.random.default_rng(4).standard_normal(COUNT)
    residual = np.append(np.where(within, inside, at_edges) + noise, np.zeros(11))
    even = np.append(np.ones(COUNT), np.zeros(11))
    assert is_edge_artefact(replace(model, interior=within), residual, even) == expected


def test_a_faint_change_that_noise_alone_makes_uneven_stays(model):
    """With amplitudes known to 0.35 and 0.35 a difference of 0.9 is 1.8 standard deviations."""
    within = np.arange(COUNT) < COUNT // 2
    even = np.append(np.full(COUNT, (8 / (COUNT / 2)) ** 0.5), np.zeros(11))
    residual = even * np.append(np.where(within, 0.3, 1.2), np.zeros(11))
    assert not is_edge_artefact(replace(model, interior=within), residual, even)
