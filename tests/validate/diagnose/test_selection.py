"""Choosing effects whose shapes are known exactly: patterns over noise of 1, on a picture without nuisances."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.effects import Effect, Parameter
from cboxlab.validation.diagnose import alternatives, selection, stepwise
from cboxlab.validation.diagnose.alternatives import (
    SelectedEffect,
    confirmed_where_held_out,
    groups,
    with_alternatives,
    with_better_alternatives,
)
from cboxlab.validation.diagnose.evidence import first_significant, limit_of
from cboxlab.validation.diagnose.fitting import fit
from cboxlab.validation.diagnose.hypotheses import Hypothesis
from cboxlab.validation.diagnose.linearised_fit import residual_with
from cboxlab.validation.diagnose.search import Candidate, signature
from cboxlab.validation.diagnose.selection import (
    backward_elimination,
    best_singles,
    pairs_replaced,
)
from cboxlab.validation.diagnose.stepwise import limits_of
from helpers.captures.patterns import AMOUNT, COUNT, SHAPE, Patterns, fitted_together, laboratory, names_of, waves


def test_two_effects_take_the_place_of_three_that_imitate_them():
    first, half, other = waves(1, 0), waves(0, 2), waves(3, 1)
    patterns = {"one": first, "both": half + other, "half": half, "other": other}
    linearised, by_name = laboratory(patterns, {"one": 0.8, "both": 0.5})
    selection = fitted_together(linearised, by_name, "one", "half", "other")
    replaced = pairs_replaced(linearised, selection, [*by_name.values()])
    assert names_of(replaced) == {"one", "both"}
    before, after = (float(np.sum(residual_with(linearised, c) ** 2)) for c in (selection, replaced))
    assert abs(after - before) < 25  # one number less


def test_three_effects_that_are_all_there_stay():
    patterns = {"one": waves(1, 0), "two": waves(0, 2), "three": waves(3, 1), "four": waves(2, 2)}
    linearised, by_name = laboratory(patterns, {"one": 0.8, "two": 0.5, "three": -0.6})
    selection = fitted_together(linearised, by_name, "one", "two", "three")
    assert names_of(pairs_replaced(linearised, selection, [*by_name.values()])) == {"one", "two", "three"}
    assert names_of(backward_elimination(linearised, selection)) == {"one", "two", "three"}
    amounts = {c.hypothesis.effect.id: c.numbers["amount"] for c in selection}
    assert amounts == pytest.approx({"one": 0.8, "two": 0.5, "three": -0.6}, abs=4 / np.sqrt(COUNT))


def test_progress_grows_to_the_whole_while_effects_are_tried():
    patterns = {"one": waves(1, 0), "two": waves(0, 2), "three": waves(3, 1)}
    linearised, by_name = laboratory(patterns, {"one": 0.8, "two": 0.7, "three": 0.6})
    messages = []
    progress = SimpleNamespace(part=messages.append)
    best_singles(linearised.problem(()), [*by_name.values()], linearised.model.residual, 3, progress=progress)
    assert messages == pytest.approx([1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6, 1])


@pytest.mark.parametrize(("of_least", "fitted"), [(0.0, 1), (0.5, 1), (0.3, 0)])
def test_what_promises_much_less_than_any_effect_must_gain_is_not_fitted_in_full(monkeypatch, of_least, fitted):
    linearised, by_name = laboratory({"one": waves(1, 0), "two": waves(0, 2)}, {"one": 0.3})
    problem, residual, done = linearised.problem(()), linearised.model.residual, []

    def spy(problem, candidate, *others):
        done.append(candidate)
        return fit(problem, candidate, *others)

    monkeypatch.setattr(selection, "fit", spy)
    gain = float(residual @ residual) - next(selection.screen(problem, [by_name["one"]], residual)).chi2
    least = gain / of_least if of_least else 0.0
    ranked = best_singles(problem, [*by_name.values()], residual, 1, least=least)
    assert len(done) == fitted
    assert ranked[0].hypothesis.effect.id == "one"
    assert ranked[0].numbers["amount"] == pytest.approx(0.3, abs=4 / np.sqrt(COUNT))


@pytest.mark.parametrize(
    ("tolerance", "known_chi2", "fitted"),
    [(0.05, np.inf, ["one", "two"]), (0.3, np.inf, ["two"]), (0.3, 1.0, ["one", "two"])],
)
def test_numbers_within_their_tolerance_are_fitted_as_rivals_of_a_fit_alone_and_do_not_count(
    monkeypatch, tolerance, known_chi2, fitted
):
    """The first number is at 0.6 of null: 2 or 12 tolerances. It stays first, and what comes second is significant."""
    linearised, by_name = laboratory({"one": waves(1, 0), "two": waves(0, 2)}, {"one": 0.6, "two": 0.4})
    hypothesis = by_name["one"].hypothesis
    free = tuple(replace(number, tolerance=tolerance) for number in hypothesis.free)
    uncertain = replace(by_name["one"], hypothesis=replace(hypothesis, free=free))
    problem, residual, done = linearised.problem(()), linearised.model.residual, []

    def spy(problem, candidate, *others):
        done.append(candidate.hypothesis.effect.id)
        return fit(problem, candidate, *others)

    monkeypatch.setattr(selection, "fit", spy)
    monkeypatch.setattr(selection, "_MIN_PROMISED_PART", 0.0)
    ranked = best_singles(problem, [uncertain, by_name["two"]], residual, 2, known_chi2)
    assert done == fitted
    assert [c.hypothesis.effect.id for c in ranked] == ["one", "two"]
    best = first_significant(ranked, residual, linearised.model, residual, residual)
    assert best.hypothesis.effect.id == ("one" if tolerance < 0.1 else "two")


def test_an_effect_that_a_later_one_made_superfluous_goes():
    patterns = {"mixture": waves(1, 0) + 0.7 * waves(0, 2), "one": waves(1, 0), "two": waves(0, 2)}
    linearised, by_name = laboratory(patterns, {"one": 0.8, "two": 0.5})
    selection = fitted_together(linearised, by_name, "mixture", "one", "two")
    assert names_of(backward_elimination(linearised, selection)) == {"one", "two"}


def test_a_mixture_that_came_first_gives_its_place_to_the_cause():
    patterns = {
        "mixture": waves(1, 0) + 0.7 * waves(0, 2) + 0.3 * waves(2, 1),
        "one": waves(1, 0),
        "two": waves(0, 2),
    }
    linearised, by_name = laboratory(patterns, {"one": 0.8, "two": 0.3})
    selection, where = with_better_alternatives(
        linearised, fitted_together(linearised, by_name, "mixture", "two"), [*by_name.values()]
    )
    assert names_of(selection) == {"one", "two"}
    assert groups(where) == ()


def test_effects_of_one_shape_are_a_group():
    """Shapes a hundredth apart: at an amount of 0.5 they differ by 4800 (0.005)^2 = 0.1 of chi2."""
    patterns = {"one": waves(1, 0), "twin": waves(1, 0) + 0.01 * waves(2, 1), "stranger": waves(0, 3)}
    linearised, by_name = laboratory(patterns, {"one": 0.5})
    effect_groups = groups(
        with_alternatives(linearised, fitted_together(linearised, by_name, "one"), [*by_name.values()])
    )
    assert effect_groups == (("one", "twin"),)


def test_what_holds_in_one_corner_only_is_no_cause():
    """A shape with the truth's sign in one block of 16 pixels and against it in the next is dropped."""
    rows, columns = np.indices(SHAPE[1:]) // 16
    board = np.where((rows + columns) % 2, 1.0, 0.1)
    patterns = {"even": np.ones(SHAPE), "cause": np.broadcast_to(board, SHAPE)}
    linearised, by_name = laboratory(patterns, {"cause": 0.6})
    for name, confirmed in (("even", set()), ("cause", {"cause"})):
        selection = fitted_together(linearised, by_name, name)
        alternatives = with_alternatives(linearised, selection, [by_name[name]])
        assert names_of(confirmed_where_held_out(linearised, selection, alternatives, [by_name[name]])[0]) == confirmed


@pytest.mark.parametrize(("size", "confirmed"), [(0.1, set()), (0.3, {"one"})])
def test_what_errors_of_a_band_may_have_made_is_not_named(size, confirmed):
    """Levels known to 0.05; with noise alone, 0.1 would be 7 standard deviations."""
    pattern = np.ones(SHAPE)
    linearised, by_name = laboratory({"one": pattern}, {"one": size})
    model = linearised.model
    shared = np.append(0.05 * pattern.ravel(), np.zeros(11))[:, None]
    linearised = replace(linearised, model=replace(model, shared_errors=shared))
    selection = fitted_together(linearised, by_name, "one")
    alternatives = with_alternatives(linearised, selection, [*by_name.values()])
    assert names_of(confirmed_where_held_out(linearised, selection, alternatives, [*by_name.values()])[0]) == confirmed


def grey_and_coloured():
    """A picture of 1000 with errors of 0.15 %, alike in all bands over cells and regions, and noise of 1; a smooth
    pattern, alike in all bands or not. Returns signatures, and what draws fits with so much of the latter."""
    coloured = waves(1, 1) * np.sqrt(1.5) * np.array([1.0, -1.0, 0.0])[:, None, None]
    linearised, by_name = laboratory({"coloured": coloured, "grey": waves(1, 1)}, {})
    fitted = SimpleNamespace(
        fit=linearised.rendered.fit,
        signal=np.full(SHAPE, 1000.0),
        variance=np.zeros(SHAPE),
        image=SimpleNamespace(coverage=np.ones((*SHAPE[1:], 1))),
    )
    rows, columns = np.indices(SHAPE[1:])
    cells = {n: rows * n // 40 * n + columns * n // 40 for n in (16, 4)}
    generator = np.random.default_rng(12)

    def fit_with(amount):
        errors = sum(1.5 * generator.standard_normal(n * n)[cell] for n, cell in cells.items())
        residual = errors + amount * coloured + generator.standard_normal(SHAPE)
        model = replace(linearised.model, residual=np.append(residual.ravel(), np.zeros(11)))
        return replace(linearised, model=model, rendered=fitted)

    return by_name, fit_with


def candidate_of(judged, signature):
    """The significant candidate of one signature in a fit, or None."""
    problem, start = judged.problem(()), judged.model.residual
    return first_significant(best_singles(problem, [signature], start, 1), start, problem.model, start, start)


def test_with_errors_of_the_picture_coloured_residuals_count_and_grey_ones_do_not():
    """In 40 draws. By size alone the grey pattern counts in most; by the errors in none, since it must be 5.7 of
    its standard deviations. The coloured one, of 0.15, counts in all: 0.15 sqrt(4800) = 10."""
    by_name, draw = grey_and_coloured()
    by_size, by_errors, amounts = 0, 0, []
    for _ in range(40):
        plain = draw(0.15)
        counting = plain.counting_errors(())
        by_size += candidate_of(plain, by_name["grey"]) is not None
        by_errors += candidate_of(counting, by_name["grey"]) is not None
        coloured = candidate_of(counting, by_name["coloured"])
        amounts.append((coloured.numbers["amount"] - 0.15) / coloured.sigma["amount"])
    assert by_size > 20
    assert by_errors == 0
    assert 0.1 < np.var(amounts) < 1.9  # of 40: 1 +- 0.9 is four standard deviations


def test_an_effect_of_the_size_of_its_limit_is_found_nine_times_in_ten():
    """Of 200 draws 180 +- 4.2 expected. The grey pattern has its limit by size."""
    by_name, draw = grey_and_coloured()
    plain = draw(0.0)
    counting = plain.counting_errors(())
    coloured, grey = (limit_of(by_name[name], plain.model, counting.model, 1.0) for name in ("coloured", "grey"))
    assert coloured.beside_errors and not grey.beside_errors
    assert coloured.visible == pytest.approx(1.0, abs=0.02)
    # what its size must be, and what errors of the picture that look like it take off in one capture of ten
    assert grey.distance == pytest.approx(0.015**0.5 + 1.2816 * 0.15, rel=0.05)
    fits = (draw(coloured.distance).counting_errors(()) for _ in range(200))
    times = sum(candidate_of(fit, by_name["coloured"]) is not None for fit in fits)
    assert abs(times - 180) <= 17  # four standard deviations


class Squares(Patterns):
    """Patterns that grow with the square of the effects' amounts, as an edge's blur does with its width."""

    def signal(self, effects):
        return 1000.0 + sum((e.values["amount"] ** 2 * self.patterns[e.id] for e in effects), np.zeros(SHAPE))

    def screening(self):
        return self

    def resampled(self):
        return self


class Traced(Patterns):
    """Patterns with a noise that is as large as they are, by the seed."""

    def __init__(self, patterns, seed=1):
        super().__init__(patterns)
        self.seed = seed

    def signal(self, effects):
        noise = np.random.default_rng(self.seed).standard_normal(SHAPE)
        return 1000.0 + sum((e.values["amount"] * (self.patterns[e.id] + noise) for e in effects), np.zeros(SHAPE))

    def screening(self):
        return self

    def resampled(self):
        return Traced(self.patterns, self.seed + 1)


def test_residuals_that_go_together_raise_a_limit_as_they_raise_what_is_asked_for():
    """Noise three times as large as stated: nine times the variance, known from 64 patches to a factor of 1 +- 0.18."""
    by_name, draw = grey_and_coloured()
    plain = draw(0.0)
    counting = plain.counting_errors(()).model
    noise = counting.project(3 * np.random.default_rng(6).standard_normal(COUNT + 11))
    alone, noisy = (
        limit_of(by_name["coloured"], plain.model, counting, 1.0, None, residual) for residual in (None, noise)
    )
    assert (noisy.distance / alone.distance) ** 2 == pytest.approx(9, rel=0.7)
    assert noisy.beside_errors  # what is tried in the search does not hang on what is left in the capture


def limits_alone(plain, predictor, stage, parameter=AMOUNT, remainder=0.0):
    """The first-order limit of a "grey" pattern by this predictor, and what is stated of it. left : residual."""
    stand_in = SimpleNamespace(**vars(plain.rendered), used=np.ones(SHAPE, bool))
    first = replace(plain, predictor=predictor, rendered=stand_in)
    effect = Effect("grey", stage, "grey", (parameter,), lambda value, amount: value, "")
    signature_of_effect = signature(predictor, (), stand_in.used, Hypothesis(effect, (parameter,), {}))
    counting = plain.counting_errors(()).model
    counting = replace(counting, residual=remainder * counting.residual)
    limit = limit_of(signature_of_effect, plain.model, counting, 1.0)
    return limit, limits_of(first, counting, [(signature_of_effect, limit)])


def test_what_is_left_in_a_capture_raises_what_is_stated():
    """What goes together raises a limit: a residual of ten times its size, for errors that are not counted."""
    _, draw = grey_and_coloured()
    pattern = Squares({"grey": waves(1, 1)})
    (quiet,), (noisy,) = (
        limits_alone(draw(0.0), pattern, "filter", remainder=remainder)[1] for remainder in (0.0, 10.0)
    )
    assert noisy.distance > 1.5 * quiet.distance


@pytest.mark.parametrize("size", [1.0, 0.0])
def test_noise_of_rays_is_no_change_that_is_seen(size):
    """A grey wave under noise of the same size: noise would stand out from errors of the picture, the wave does not."""
    _, draw = grey_and_coloured()
    limit, limited = limits_alone(draw(0.0), Traced({"grey": size * waves(1, 1)}), "transport")
    assert limit.visible > 0.4 and limit.distance < 0.1
    assert len(limited) == 1 or not size
    assert all(each.distance > 2.5 * limit.distance for each in limited)
    assert not size or limited[0].visible < 0.1


@pytest.mark.parametrize(
    ("low", "high", "is_stated"),
    [(-0.05, 0.05, False), (-10.0, 10.0, True), (0.0, 10.0, True), (-10.0, 0.0, True)],
)
def test_a_size_beyond_an_effects_bounds_is_not_stated(low, high, is_stated):
    _, draw = grey_and_coloured()
    parameter = replace(AMOUNT, low=low, high=high)
    _, limited = limits_alone(draw(0.0), Squares({"grey": waves(1, 1)}), "filter", parameter)
    assert bool(limited) is is_stated


def test_an_effect_that_changes_rounding_only_has_no_signature():
    effect = Effect("flat", "filter", "flat", (AMOUNT,), lambda value, amount: value, "")
    for size, is_seen in ((1e-13, False), (1e-3, True)):
        predictor = Patterns({"flat": size * waves(1, 0)})
        signature_of_effect = signature(predictor, (), np.ones(SHAPE, bool), Hypothesis(effect, (AMOUNT,), {}))
        assert (signature_of_effect is not None) is is_seen


def test_limits_of_what_grows_with_a_square():
    """A chi2 per sample is the square of an amplitude of the grey pattern, which is the square of an amount."""
    _, draw = grey_and_coloured()
    limit, (limit_record,) = limits_alone(draw(0.0), Squares({"grey": waves(1, 1)}), "filter")
    assert limit_record.distance == pytest.approx(limit_record.chi2_per_sample**0.25, rel=1e-3)
    assert limit.distance > 3 * limit_record.distance


def test_stated_sizes_are_one_and_a_half_times_those_to_first_order(monkeypatch):
    arguments = grey_and_coloured()[1](0.0), Squares({"grey": waves(1, 1)}), "filter"
    (said,) = limits_alone(*arguments)[1]
    monkeypatch.setattr(stepwise, "_SIZE_OVER_FIRST_ORDER", 1.0)
    assert said.distance == pytest.approx(1.5 * limits_alone(*arguments)[1][0].distance)


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
    hypothesis = Hypothesis(effect, (AMOUNT,), {"across": 1.0})
    truth = Ripples({}).signal([hypothesis.at({"amount": 0.5, "across": 1.3})]) - 1000.0
    linearised, _ = laboratory({}, {})
    noise = linearised.model.residual
    residual = noise + np.append(truth.ravel(), np.zeros(11))
    linearised = replace(linearised, predictor=Ripples({}))
    problem = linearised.problem(())
    start = Candidate(hypothesis, {"amount": 0.3}, {}, 0.0, np.zeros(COUNT + 11))
    free = fit(problem, start, residual)
    fitted = fit(problem, replace(start, hypothesis=replace(hypothesis, unfitted=("across",))), residual)
    for name, expected in (("amount", 0.5), ("across", 1.3)):
        assert abs(free.numbers[name] - expected) < 4 * free.sigma[name]
    assert fitted.applied.values["across"] == 1.0
    data = np.append(Ripples({}).signal([hypothesis.at({"amount": 1.0})]).ravel() - 1000.0, np.zeros(11))
    assert fitted.numbers["amount"] == pytest.approx(float(data @ residual) / float(data @ data), rel=1e-6)
    assert fitted.chi2 > free.chi2 + 50


def test_an_effects_certainty_is_its_amount_over_its_error():
    """In noise of 1 the fit's own standard deviation, 1 over the norm of the pattern; less where chi2 scatters more."""
    linearised, by_name = laboratory({"one": waves(1, 0)}, {"one": 0.3})
    (candidate,) = with_alternatives(linearised, fitted_together(linearised, by_name, "one"), [])
    sigma = 1 / np.sqrt(np.sum(waves(1, 0) ** 2))
    amount = candidate.candidate.numbers["amount"]
    assert replace(candidate, dispersion=1.0).certainty == pytest.approx(amount / sigma, rel=1e-6)
    assert replace(candidate, dispersion=4.0).certainty == pytest.approx(amount / sigma / 2, rel=1e-6)
    assert replace(candidate, chi2_without=0.0, dispersion=1.0).certainty == 0.0


def with_numbers(name, chi2, count):
    """A candidate of some numbers, as far as it is compared with others."""
    effect = SimpleNamespace(id=name)
    return SimpleNamespace(chi2=chi2, hypothesis=SimpleNamespace(effect=effect, free=(None,) * count), name=name)


@pytest.mark.parametrize(("behind", "replaced"), [(9.7, True), (22.0, True), (24.0, False)])
def test_six_numbers_must_gain_more_than_one(monkeypatch, behind, replaced):
    """4.6 of chi2 each: five further numbers must gain 23. The two are a group in every case, for by chi2 alone, or
    with the price, they fit alike; the likelier one is selected."""
    many, few = with_numbers("many", 1000.0, 6), with_numbers("few", 1000.0 + behind, 1)

    def judged(linearised, selection, signatures):
        (candidate,) = selection
        other = few if candidate is many else many
        return [SelectedEffect(candidate, (other,), 2000.0, 1.0, 1.0, 0.1, 100000, 1.0)]

    monkeypatch.setattr(alternatives, "with_alternatives", judged)
    monkeypatch.setattr(alternatives, "refitted_together", lambda linearised, selection: list(selection))
    selection, alternatives_found = with_better_alternatives(None, [many], [])
    assert selection == [few if replaced else many]
    assert [c.name for c in alternatives_found[0].indistinguishable] == ["many" if replaced else "few"]
