"""The stated errors of an effect's parameters, for residuals that are more than independent noise; what counts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.scenes import cornell_box
from cboxlab.validate.hypotheses import hypotheses
from cboxlab.validate.linear_model import LinearModel, smooth_part
from cboxlab.validate.search import (
    Candidate,
    Signature,
    _deviation,
    _from_coordinate,
    _to_coordinate,
    parameter_variance,
    screen,
)
from cboxlab.validate.selection import first_worthy

PATCHES, EACH, TRIALS = 64, 30, 600

#: A picture of 32 x 32 pixels without nuisances.
SQUARE = SimpleNamespace(
    count=1024, project=lambda vector: vector, image=lambda vector: vector[:1024].reshape(1, 32, 32)
)


def test_parameter_errors_hold_for_flaws_that_pixels_share():
    """Residuals with a common part in each patch, and one of known size in all: estimates over their stated error have
    unit variance.

    The variance of 600 standard normal numbers is 1 +- 0.058; a few per cent are lost to 64 patches. With
    independent noise assumed it would be several times too much, and 1.9 without the flaw that the estimate follows.
    """
    generator = np.random.default_rng(11)
    count = PATCHES * EACH
    patch = np.repeat(np.arange(PATCHES), EACH)
    everything = np.ones((1, PATCHES, EACH), bool)
    shared = np.append(np.where(patch < PATCHES // 2, 0.12, 0.0), np.zeros(11))
    model = LinearModel(
        everything,
        np.ones(count, bool),
        patch,
        np.ones(count),
        np.zeros((11, 11)),
        np.zeros((count + 11, 11)),
        shared[:, None],
        np.zeros(count + 11),
    )
    column = np.append(1 + 0.3 * generator.standard_normal(count), np.zeros(11))
    inverse = np.array([[1 / (column @ column)]])
    honest, unaware, naive = [], [], []
    for _ in range(TRIALS):
        flaw = 0.5 * generator.standard_normal(PATCHES)[patch]
        residual = np.append(flaw + generator.standard_normal(count), np.zeros(11))
        residual += shared * generator.standard_normal()
        estimate = float(column @ residual) * inverse[0, 0]
        left = residual - estimate * column
        for found, known in ((honest, model), (unaware, replace(model, flaws=0 * model.flaws))):
            found.append(estimate / np.sqrt(parameter_variance(known, column[:, None], inverse, left)[0]))
        naive.append(estimate / np.sqrt(inverse[0, 0]))
    assert 0.8 < np.var(honest) < 1.25  # 4 standard deviations, and the bias of 64 patches
    assert np.var(unaware) > 1.4
    assert np.var(naive) > 4


def test_what_relieves_a_prior_is_found_behind_what_gains_more_by_chance():
    """Strain of 10 standard deviations: relieved by the camera's motion, beside an offset that gains chi2 elsewhere."""
    known = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), False)}
    residual = np.zeros(1035)
    residual[:3], residual[-11] = 1.0, 10.0

    def candidate(name, predicted):
        left = residual - predicted
        return Candidate(known[name], {}, {}, float(left @ left), predicted)

    moved, offset = np.zeros(1035), np.zeros(1035)
    moved[-11], offset[:3] = 9.0, 1.0
    lucky, pose = candidate("dark-offset", offset), candidate("camera-pose", moved)
    assert first_worthy([lucky, pose], residual, SQUARE, residual) is pose
    assert first_worthy([lucky, candidate("camera-pose", offset)], residual, SQUARE, residual) is None


def test_a_gain_must_exceed_the_flaws_of_shapes_that_are_not_rendered_anew():
    """Of 10^5 explained a hundredth may be an effect's own error; nothing of it where the picture is new."""
    known = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), False)}
    residual, rendered = np.zeros(1035), np.zeros(1035)
    residual[0], rendered[1] = 10.0, np.sqrt(1e5 + 100)
    offset = Candidate(known["dark-offset"], {}, {}, 0.0, residual)
    assert first_worthy([offset], residual, SQUARE, rendered) is None
    assert first_worthy([offset], residual, SQUARE, residual) is offset


def test_what_changes_edges_alone_need_gain_less_than_what_changes_faces():
    """The base picture's flaws are smooth: 0.01 of chi2 per sample is theirs on faces, an effect's at edges."""
    known = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), False)}
    level = np.append(np.full(1024, 0.1), np.zeros(11))
    sides = np.append(np.tile([0.1, -0.1], 512), np.zeros(11))
    for change, smooth, gains in ((level, 1.0, False), (sides, 0.0, True)):
        assert smooth_part(SQUARE, change) == pytest.approx(smooth)
        found = first_worthy([Candidate(known["defocus"], {}, {}, 0.0, change)], change, SQUARE, change)
        assert (found is not None) is gains


def test_screening_leaves_out_what_averaging_noise_would_gain():
    """|r - a c|^2 + s a, s what a step of the effect smooths away, is least at (c r - s / 2) / c^2."""
    known = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), False)}
    generator = np.random.default_rng(1)
    column, residual = generator.standard_normal(1035), generator.standard_normal(1035)
    residual += 3 * column
    task = SimpleNamespace(
        model=SimpleNamespace(project=lambda vector: vector, whiten_used=lambda change: change),
        scale=1.0,
        smoothed_away=lambda effect: 100.0,
    )
    found = screen(task, Signature(known["defocus"], (0.15,), column[None]), residual)
    amplitude = (column @ residual - 50.0) / (column @ column)
    assert found.numbers["sigma_px"] == pytest.approx(0.15 * amplitude)
    left = residual - amplitude * column
    assert found.chi2 == pytest.approx(left @ left + 100.0 * amplitude)


def test_the_error_of_an_index_is_not_that_of_its_coordinate():
    """Filter shift is searched in 1 / n^2; a small error of that, as an index' own."""
    (p,) = next(h for h in hypotheses(("f400",), cornell_box(), False) if h.effect.id == "filter-shift").free
    coordinate, error = _to_coordinate(p, 2.0), 1e-6
    ends = [_from_coordinate(p, coordinate + sign * error) for sign in (-1, 1)]
    assert _deviation(p, 2.0, error) == pytest.approx((ends[0] - ends[1]) / 2, rel=1e-4)
