"""Choosing effects whose shapes are known exactly: patterns over noise of 1, on a picture without nuisances."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validate.diagnose.alternatives import (
    confirmed_where_held_out,
    groups,
    with_alternatives,
    with_better_alternatives,
)
from cboxlab.validate.diagnose.evidence import first_significant
from cboxlab.validate.diagnose.hypotheses import Hypothesis
from cboxlab.validate.diagnose.linearised_fit import refitted_together, residual_with
from cboxlab.validate.diagnose.search import Candidate, fit
from cboxlab.validate.diagnose.selection import backward_elimination, best_singles, pairs_replaced
from cboxlab.validate.effects import Effect, Parameter
from helpers.patterns import AMOUNT, COUNT, SHAPE, Patterns, laboratory, waves


def taken(linearised, known, *names):
    """Candidates of these names, fitted together."""
    start = [
        Candidate(known[name].hypothesis, {"amount": 0.1}, {}, 0.0, np.zeros(COUNT + 11)) for name in names
    ]
    return refitted_together(linearised, start, 4)


def names_of(chosen):
    return {c.hypothesis.effect.id for c in chosen}


def test_two_effects_take_the_place_of_three_that_imitate_them():
    one, half, other = waves(1, 0), waves(0, 2), waves(3, 1)
    patterns = {"one": one, "both": half + other, "half": half, "other": other}
    linearised, known = laboratory(patterns, {"one": 0.8, "both": 0.5})
    chosen = taken(linearised, known, "one", "half", "other")
    found = pairs_replaced(linearised, chosen, [*known.values()])
    assert names_of(found) == {"one", "both"}
    before, after = (float(np.sum(residual_with(linearised, c) ** 2)) for c in (chosen, found))
    assert abs(after - before) < 25  # one number less


def test_three_effects_that_are_all_there_stay():
    patterns = {"one": waves(1, 0), "two": waves(0, 2), "three": waves(3, 1), "four": waves(2, 2)}
    linearised, known = laboratory(patterns, {"one": 0.8, "two": 0.5, "three": -0.6})
    chosen = taken(linearised, known, "one", "two", "three")
    assert names_of(pairs_replaced(linearised, chosen, [*known.values()])) == {"one", "two", "three"}
    assert names_of(backward_elimination(linearised, chosen)) == {"one", "two", "three"}
    amounts = {c.hypothesis.effect.id: c.numbers["amount"] for c in chosen}
    assert amounts == pytest.approx({"one": 0.8, "two": 0.5, "three": -0.6}, abs=4 / np.sqrt(COUNT))


def test_an_effect_that_a_later_one_made_superfluous_goes():
    patterns = {"mixture": waves(1, 0) + 0.7 * waves(0, 2), "one": waves(1, 0), "two": waves(0, 2)}
    linearised, known = laboratory(patterns, {"one": 0.8, "two": 0.5})
    chosen = taken(linearised, known, "mixture", "one", "two")
    assert names_of(backward_elimination(linearised, chosen)) == {"one", "two"}


def test_a_mixture_that_came_first_gives_its_place_to_the_cause():
    patterns = {
        "mixture": waves(1, 0) + 0.7 * waves(0, 2) + 0.3 * waves(2, 1),
        "one": waves(1, 0),
        "two": waves(0, 2),
    }
    linearised, known = laboratory(patterns, {"one": 0.8, "two": 0.3})
    chosen, where = with_better_alternatives(
        linearised, taken(linearised, known, "mixture", "two"), [*known.values()]
    )
    assert names_of(chosen) == {"one", "two"}
    assert groups(where) == ()


def test_effects_of_one_shape_are_a_group():
    """Shapes a hundredth apart: at an amount of 0.5 they differ by 4800 (0.005)^2 = 0.1 of chi2."""
    patterns = {"one": waves(1, 0), "twin": waves(1, 0) + 0.01 * waves(2, 1), "stranger": waves(0, 3)}
    linearised, known = laboratory(patterns, {"one": 0.5})
    found = groups(with_alternatives(linearised, taken(linearised, known, "one"), [*known.values()]))
    assert found == (("one", "twin"),)


def test_what_holds_in_one_corner_only_is_no_cause():
    """A shape with the truth's sign in one block of 16 pixels and against it in the next is dropped."""
    rows, columns = np.indices(SHAPE[1:]) // 16
    board = np.where((rows + columns) % 2, 1.0, 0.1)
    patterns = {"even": np.ones(SHAPE), "cause": np.broadcast_to(board, SHAPE)}
    linearised, known = laboratory(patterns, {"cause": 0.6})
    for name, kept in (("even", set()), ("cause", {"cause"})):
        chosen = taken(linearised, known, name)
        alternatives = with_alternatives(linearised, chosen, [known[name]])
        assert names_of(confirmed_where_held_out(linearised, chosen, alternatives, [known[name]])[0]) == kept


def test_beside_the_pictures_errors_what_is_sharp_counts_and_what_is_smooth_does_not():
    """Errors of 0.15 % of 1000, alike in all bands over cells and regions, noise of 1, 40 draws. By size alone a smooth
    pattern counts in most; beside the errors in none, since it must be 5.7 standard deviations. A pattern that changes
    from pixel to pixel, of 0.15, counts in all: 0.15 sqrt(4800) = 10 standard deviations."""
    checks = np.broadcast_to((-1.0) ** np.indices(SHAPE[1:]).sum(axis=0), SHAPE)
    linearised, known = laboratory({"sharp": checks, "smooth": waves(1, 1)}, {})
    coverage = np.ones((*SHAPE[1:], 1))
    fitted = SimpleNamespace(
        fit=linearised.rendered.fit, signal=np.full(SHAPE, 1000.0), variance=np.zeros(SHAPE),
        image=SimpleNamespace(coverage=coverage),
    )  # fmt: skip
    rows, columns = np.indices(SHAPE[1:])
    place = [rows * n // 40 * n + columns * n // 40 for n in (16, 4)]
    generator = np.random.default_rng(12)
    by_size, beside, amounts = [], [], []
    for _ in range(40):
        errors = sum(1.5 * generator.standard_normal(n * n)[p] for n, p in zip((16, 4), place, strict=True))
        residual = errors + 0.15 * checks + generator.standard_normal(SHAPE)
        model = replace(linearised.model, residual=np.append(residual.ravel(), np.zeros(11)))
        plain = replace(linearised, model=model, rendered=fitted)
        for judged, found in ((plain, by_size), (plain.counting_errors(()), beside)):
            problem, start = judged.problem(()), judged.model.residual
            tried = best_singles(problem, [known["smooth"]], start, 1)
            found.append(first_significant(tried, start, problem.model, start) is not None)
        sharp = best_singles(problem, [known["sharp"]], start, 1)
        assert first_significant(sharp, start, problem.model, start) is not None
        amounts.append((sharp[0].numbers["amount"] - 0.15) / sharp[0].sigma["amount"])
    assert np.mean(by_size) > 0.5
    assert not any(beside)
    assert 0.5 < np.var(amounts) < 1.7  # of 40: four standard deviations are 0.9; few clusters


class Ripples(Patterns):
    """Waves whose number across the picture is the effect's too."""

    def signal(self, effects):
        u = np.mgrid[0:40, 0:40][1] / 40
        ripples = (e.values["amount"] * np.cos(np.pi * e.values["across"] * u) for e in effects)
        return 1000.0 + sum(ripples, np.zeros(SHAPE))


def test_a_number_without_null_is_fitted_unless_it_is_held():
    """A wave of 1.3: found from 1.0 within its error; held at 1.0 it stays, and the amount is the best one for 1.0."""
    across = Parameter("across", low=0.5, high=3.0, step=0.05)
    effect = Effect("ripple", "filter", "ripple", (AMOUNT, across), lambda value, **numbers: value, "")
    known = Hypothesis(effect, (AMOUNT,), {"across": 1.0})
    truth = Ripples({}).signal([known.at({"amount": 0.5, "across": 1.3})]) - 1000.0
    linearised, _ = laboratory({}, {})
    noise = linearised.model.residual
    residual = noise + np.append(truth.ravel(), np.zeros(11))
    linearised = replace(linearised, predictor=Ripples({}))
    problem = linearised.problem(())
    start = Candidate(known, {"amount": 0.3}, {}, 0.0, np.zeros(COUNT + 11))
    free = fit(problem, start, residual)
    held = fit(problem, replace(start, hypothesis=replace(known, held=("across",))), residual)
    for name, wanted in (("amount", 0.5), ("across", 1.3)):
        assert abs(free.numbers[name] - wanted) < 4 * free.sigma[name]
    assert held.applied.values["across"] == 1.0
    one = np.append(Ripples({}).signal([known.at({"amount": 1.0})]).ravel() - 1000.0, np.zeros(11))
    assert held.numbers["amount"] == pytest.approx(float(one @ residual) / float(one @ one), rel=1e-6)
    assert held.chi2 > free.chi2 + 50
