"""The set of effects that explains most to first order, on shapes that are known exactly (``helpers.patterns``)."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validate.diagnose import stepwise
from cboxlab.validate.diagnose.selection import best_set
from helpers.patterns import AMOUNT, COUNT, laboratory, names_of, taken, waves


def resembling():
    """Three effects, a mixture that resembles their sum more than any of them does, and others."""
    patterns = {"one": waves(1, 0), "two": waves(0, 2), "three": waves(3, 1)}
    mixture = sum(patterns.values()) / np.sqrt(3) + 0.2 * waves(1, 3)
    others = {f"wave {n}": waves(n, n) + 0.3 * waves(n, 0) for n in (2, 3)}
    return {"mixture": mixture, **others, **patterns}


def test_the_best_set_is_that_of_all_sets():
    """Against least squares of every pair and triple by numpy, chi2 and 4.6 for each number."""
    patterns = resembling()
    linearised, known = laboratory(patterns, {"one": 0.5, "two": 0.4, "three": -0.3})
    residual = linearised.model.residual

    def chi2(names):
        design = np.array([patterns[name].ravel() for name in names]).T
        left = residual[:COUNT] - design @ np.linalg.lstsq(design, residual[:COUNT])[0]
        return float(left @ left) + 4.6 * len(names)

    sets = [names for size in (2, 3) for names in combinations(patterns, size)]
    found = best_set(linearised.problem(()), [*known.values()], residual, 3)
    assert names_of(found) == set(min(sets, key=chi2)) == {"one", "two", "three"}
    design = np.array([patterns[c.hypothesis.effect.id].ravel() for c in found]).T
    amounts = np.linalg.lstsq(design, residual[:COUNT])[0]
    assert [c.numbers["amount"] for c in found] == pytest.approx(list(amounts), rel=1e-4)
    assert [c.chi2 for c in found] == pytest.approx([chi2(names_of(found)) - 3 * 4.6] * 3, rel=1e-5)


def test_two_effects_are_no_three():
    """A third one would gain some of the noise: less than the price of its number in this draw."""
    linearised, known = laboratory(resembling(), {"one": 0.5, "three": 0.4})
    found = best_set(linearised.problem(()), [*known.values()], linearised.model.residual, 3)
    assert names_of(found) == {"one", "three"}


def test_a_set_keeps_its_numbers_within_their_bounds():
    """An effect that only adds light takes no part where light is missing."""
    linearised, known = laboratory(resembling(), {"one": 0.5, "two": -0.4})
    hypothesis = known["two"].hypothesis
    known["two"] = replace(
        known["two"], hypothesis=replace(hypothesis, free=(replace(AMOUNT, low=0.0, high=10.0),))
    )
    found = best_set(linearised.problem(()), [*known.values()], linearised.model.residual, 2)
    assert "one" in names_of(found) and "two" not in names_of(found)
    assert best_set(linearised.problem(()), [known["two"]], linearised.model.residual, 3) == []


@pytest.mark.parametrize(
    ("start", "settings", "taken_over"),
    [(("mixture",), False, True), (("one", "two", "three"), False, False), (("mixture",), True, False)],
)
def test_the_best_set_takes_the_place_of_what_explains_less(monkeypatch, start, settings, taken_over):
    """Effects that are all there stay as they are; where a depth of paths was added, signatures no longer hold."""
    linearised, known = laboratory(resembling(), {"one": 0.8, "two": 0.7, "three": 0.6})
    chosen = taken(linearised, known, *start)
    if settings:
        effect = replace(chosen[0].hypothesis.effect, stage="settings")
        chosen = [replace(chosen[0], hypothesis=replace(chosen[0].hypothesis, effect=effect))]
    again = replace(linearised)
    monkeypatch.setattr(stepwise, "refitted", lambda validation, first, chosen: again)
    picture, found = stepwise._with_best_set(None, linearised, [*known.values()], linearised, chosen)
    assert picture is (again if taken_over else linearised)
    assert names_of(found) == ({"one", "two", "three"} if taken_over else set(start))


def test_a_set_leaves_out_what_averaging_noise_would_gain():
    """|r - C a|^2 + s a, s what steps of the effects smooth away, is least at (C^T C)^-1 (C^T r - s / 2)."""
    patterns = {"one": waves(1, 0), "two": 0.7 * waves(1, 0) + waves(0, 2)}
    linearised, known = laboratory(patterns, {"one": 0.5, "two": 0.4})
    slopes = {"one": 300.0, "two": 0.0}
    problem, residual = linearised.problem(()), linearised.model.residual
    blurring = SimpleNamespace(
        model=problem.model, scale=1.0, camera_change=lambda effect: 0.0,
        noise_averaging_gain=lambda effect: slopes[effect.id] * effect.values["amount"],
    )  # fmt: skip
    design = np.array([pattern.ravel() for pattern in patterns.values()]).T
    aim = design.T @ residual[:COUNT] - np.array([150.0, 0.0])
    found = best_set(blurring, [*known.values()], residual, 2)
    amounts = {c.hypothesis.effect.id: c.numbers["amount"] for c in found}
    assert [amounts["one"], amounts["two"]] == pytest.approx(
        np.linalg.solve(design.T @ design, aim), rel=1e-4
    )
