"""Effects' numbers fitted in full, and their stated errors for residuals that are more than independent noise."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.effects import Effect, Parameter
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose import fitting
from cboxlab.validation.diagnose.fitting import Fitted, fit, gauss_newton, parameter_variance
from cboxlab.validation.diagnose.hypotheses import Hypothesis
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.search import Candidate
from scipy.optimize import minimize, minimize_scalar

PATCHES, EACH, TRIALS = 64, 30, 600
COUNT = PATCHES * EACH

WIDTH = Parameter("width", null=0.0, low=0.0, high=20.0, step=0.1)
SIZE, CENTRE = (
    Parameter("size", null=0.0, low=-5.0, high=5.0, step=0.1),
    Parameter("centre", low=0.0, high=4.0, step=0.05),
)
LINE = np.linspace(0.0, 4.0, COUNT)


def model_of(shared_errors=None):
    """Noise of 1 in patches, no nuisances."""
    return LinearModel(
        used=np.ones((1, PATCHES, EACH), bool),
        interior=np.ones(COUNT, bool),
        patch=np.repeat(np.arange(PATCHES), EACH),
        sigma=np.ones(COUNT),
        priors=np.zeros((11, 11)),
        by_lamp=np.ones(COUNT),
        basis=np.zeros((COUNT + 11, 11)),
        shared_errors=np.zeros((COUNT + 11, 1)) if shared_errors is None else shared_errors,
        residual=np.zeros(COUNT + 11),
    )


class Bell:
    """A problem whose effect is ``shape`` of its numbers; tried : the numbers it was computed at, in order."""

    scale = 1.0

    def __init__(self, shape, averaged=lambda values: 0.0):
        self.model, self.shape, self.averaged, self.tried = model_of(), shape, averaged, []

    def change(self, applied):
        self.tried.append(dict(applied.values))
        return np.append(self.shape(**applied.values), np.zeros(11))

    def noise_averaging_gain(self, applied):
        return self.averaged(applied.values)


def start_of(numbers, *parameters):
    effect = Effect("bell", "filter", "a bell", parameters, lambda value, **numbers: value, "")
    free = tuple(p for p in parameters if p.null is not None)
    fixed = {p.name: numbers[p.name] for p in parameters if p.null is None}
    values = {p.name: numbers[p.name] for p in free}
    return Candidate(Hypothesis(effect, free, fixed), values, {}, np.inf, np.zeros(COUNT + 11))


def bell(size, centre):
    return size * np.exp(-0.5 * ((LINE - centre) / 0.3) ** 2)


def test_numbers_end_at_the_least_squares_those_without_null_included():
    """Against SciPy's simplex on the same sum of squares; it starts a third of the bell's width next to its place."""
    residual = bell(2.0, 1.6) + np.random.default_rng(1).standard_normal(COUNT)
    fitted = fit(Bell(bell), start_of({"size": 1.0, "centre": 1.5}, SIZE, CENTRE), np.append(residual, np.zeros(11)))
    best = minimize(lambda n: np.sum((residual - bell(*n)) ** 2), [2.0, 1.6], method="Nelder-Mead")
    assert fitted.chi2 == pytest.approx(best.fun, abs=0.05)
    assert [fitted.numbers["size"], fitted.numbers["centre"]] == pytest.approx(list(best.x), abs=0.01)
    assert fitted.predicted[:COUNT] == pytest.approx(bell(*best.x), abs=0.02)
    slopes = np.array([bell(1.0, best.x[1]), bell(*best.x) * (LINE - best.x[1]) / 0.09])
    cramer_rao = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    assert [fitted.sigma["size"], fitted.sigma["centre"]] == pytest.approx(list(cramer_rao), rel=0.35)  # 64 clusters


def test_what_a_blur_gains_by_averaging_noise_is_no_gain():
    """The sum of squares and of what is averaged is lowest, not the first alone."""
    pattern = np.cos(3 * LINE)
    residual = 0.5 * pattern + np.random.default_rng(2).standard_normal(COUNT)
    problem = Bell(lambda size: size * pattern, lambda values: 400.0 * values["size"])
    fitted = fit(problem, start_of({"size": 0.1}, SIZE), np.append(residual, np.zeros(11)))
    best = minimize_scalar(lambda a: np.sum((residual - a * pattern) ** 2) + 400.0 * a)
    assert fitted.numbers["size"] == pytest.approx(best.x, abs=1e-3)
    assert fitted.chi2 == pytest.approx(best.fun, abs=0.01)


def test_an_effect_that_grows_with_the_square_starts_at_the_root(monkeypatch):
    """A width of 1.2 seen as 0.1 x 144 by a step of 0.1: the second start is 1.2 itself, and it is the better one."""
    monkeypatch.setattr(fitting, "_ROUNDS", 1)
    problem = Bell(lambda width: width**2 * np.cos(3 * LINE))
    residual = np.append(1.44 * np.cos(3 * LINE), np.zeros(11))
    fitted = fit(problem, start_of({"width": 0.1 * 1.44 / 0.01}, WIDTH), residual)
    assert [each["width"] for each in problem.tried[:2]] == pytest.approx([14.4, 1.2])
    assert fitted.numbers["width"] == pytest.approx(1.2, abs=0.01)


def test_a_fit_that_cannot_come_near_another_ends_early():
    """A quartic from 3 towards 2: of the pattern's square rounds leave 476, 40, 2 and 0.1, and gain 3749, 436, 38, 2.

    A rival at -1e5 is out of reach after the first, for no more than twice the last gain is to be had; one at -2000
    after the second, one at -200 after the third. A rival that can be reached stops nothing.
    """
    pattern = np.append(np.cos(3 * LINE), np.zeros(11))
    counts = []

    def evaluate(candidates):
        counts[-1] += 1
        (candidate,) = candidates
        return Fitted((candidate,), (16.0 - candidate.numbers["width"] ** 4) * pattern, 0.0)

    for gain in (-1e5, -2000.0, -200.0, 10.0, np.inf):
        counts.append(-1)
        start = evaluate([start_of({"width": 3.0}, WIDTH)])
        gauss_newton(evaluate, model_of(), start, gain * float(np.sum(pattern**2)))
    assert counts == [2, 4, 6, 8, 8]


def test_a_fit_ends_where_a_round_gains_next_to_nothing():
    """The bell's second round gains 0.3 of chi2, of a few thousand that noise leaves: there is no third."""
    residual = bell(2.0, 1.6) + np.random.default_rng(1).standard_normal(COUNT)
    problem = Bell(bell)
    fit(problem, start_of({"size": 2.0, "centre": 1.58}, SIZE, CENTRE), np.append(residual, np.zeros(11)))
    assert len(problem.tried) == 2 + 2 * 3


def test_where_an_effect_cannot_be_it_explains_nothing():
    def impossible(size):
        raise InputError("size", "too much", "less")

    fitted = fit(Bell(impossible), start_of({"size": 1.0}, SIZE), np.ones(COUNT + 11))
    assert fitted.chi2 == np.inf and not fitted.predicted.any()


def test_errors_that_all_pixels_share_add_their_squares():
    """Two errors of known size, which the number follows by projection, next to noise: by hand, of dense matrices."""
    generator = np.random.default_rng(3)
    shared = np.vstack([generator.standard_normal((COUNT, 2)) * [0.3, 0.05], np.zeros((11, 2))])
    design = np.vstack([generator.standard_normal((COUNT, 2)), np.zeros((11, 2))])
    design[:COUNT] += shared[:COUNT] * [4.0, 1.0]
    inverse = np.linalg.inv(design.T @ design)
    variance = parameter_variance(model_of(shared), design, inverse, np.zeros(COUNT + 11))
    pseudo = np.linalg.pinv(design)
    expected = np.diag(pseudo @ pseudo.T) + np.diag(pseudo @ shared @ shared.T @ pseudo.T)
    assert variance == pytest.approx(expected, rel=1e-9)
    assert (np.diag(pseudo @ shared @ shared.T @ pseudo.T) > 0.5 * np.diag(inverse)).any()


def test_parameter_errors_hold_for_errors_that_pixels_share():
    """Residuals with an error common to each patch, and one of known size in all: estimates over their stated errors
    have unit variance.

    The variance of 600 standard normal numbers is 1 +- 0.058; a few per cent are lost to 64 patches. With
    independent noise assumed it would be several times too much, and 1.9 without the shared error, which the
    estimate follows.
    """
    generator = np.random.default_rng(11)
    count, patch = COUNT, np.repeat(np.arange(PATCHES), EACH)
    shared = np.append(np.where(patch < PATCHES // 2, 0.12, 0.0), np.zeros(11))
    model = model_of(shared[:, None])
    column = np.append(1 + 0.3 * generator.standard_normal(count), np.zeros(11))
    inverse = np.array([[1 / (column @ column)]])
    honest, unaware, naive = [], [], []
    for _ in range(TRIALS):
        error = 0.5 * generator.standard_normal(PATCHES)[patch]
        residual = np.append(error + generator.standard_normal(count), np.zeros(11))
        residual += shared * generator.standard_normal()
        estimate = float(column @ residual) * inverse[0, 0]
        remainder = residual - estimate * column
        for estimated, expected in (
            (honest, model),
            (unaware, replace(model, shared_errors=0 * model.shared_errors)),
        ):
            estimated.append(estimate / np.sqrt(parameter_variance(expected, column[:, None], inverse, remainder)[0]))
        naive.append(estimate / np.sqrt(inverse[0, 0]))
    assert 0.8 < np.var(honest) < 1.25  # 4 standard deviations, and the bias of 64 patches
    assert np.var(unaware) > 1.4
    assert np.var(naive) > 4


@pytest.mark.parametrize(("null", "width", "other"), [(0.0, 0.9, 0.3), (1.0, 1.9, 1.3), (1.0, 0.9, None)])
def test_a_second_start_is_at_the_root_of_the_steps_from_the_null(null, width, other):
    """Nine steps of 0.1 become three; an amplitude of the other sign has no root."""
    start = start_of({"width": width}, replace(WIDTH, null=null))
    expected = [] if other is None else [{"width": pytest.approx(other)}]
    assert fitting._other_starts(start.hypothesis, start) == expected
