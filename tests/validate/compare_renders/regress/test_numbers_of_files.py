"""Numbers of files: facts next to the verdict, which the light alone decides."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress import Side, regress_sides
from cboxlab.validation.compare_renders.regress.outcome import github_lines
from cboxlab.validation.compare_renders.scene_pictures import steps_of

SAMPLES = 200
SHAPE = (40, 48, 3)


def of_samples(seed, kind):
    """(y, x, 3) means of skewed samples, summed in ``kind``, over a light that grows to the right."""
    rng, total = np.random.default_rng(seed), np.zeros(SHAPE, kind)
    light = np.linspace(0.4, 0.8, SHAPE[1])[None, :, None]
    for _ in range(SAMPLES):
        total = total + (light * rng.gamma(4, 0.25, SHAPE)).astype(kind)
    return (total.astype(np.float32) / np.float32(SAMPLES)).astype(float)


def half(picture):
    return picture.astype(np.float16).astype(float)


def shared_exponents(picture):
    step = 2.0 ** (np.floor(np.log2(picture.max(axis=-1, keepdims=True))) - 7)
    return (np.floor(picture / step) + 0.5) * step


def levels(picture):
    return (np.round(255 * np.clip(picture, 0, 1) ** (1 / 2.2)) / 255) ** 2.2


def side(picture):
    return Side("picture", np.full(3, np.nan), picture, None, 0.0, None, in_colour=True, colours=("R", "G", "B"))


def outcome(first, second):
    return regress_sides(side(first), side(second))[0]


FINE, OTHER, SUMMED = of_samples(1, np.float32), of_samples(2, np.float32), of_samples(3, np.float16)


@pytest.mark.parametrize(
    ("stored", "text"),
    [(half, "half floats"), (shared_exponents, "shared exponents (RGBE)"), (levels, "at most 256 levels")],
)
def test_a_format_is_stated_and_does_not_decide(stored, text):
    verdict = outcome(FINE, stored(OTHER))
    assert verdict.same and verdict.numbers == ("32-bit floats", text)
    light = "Numbers are stored differently, the light is the same"
    assert f"{light}: the candidate holds {text}, the baseline 32-bit floats." in verdict.lines()
    assert [line.split(" ")[0] for line in github_lines(verdict)] == ["::notice", "::warning"]
    assert verdict.to_dict()["stored"] == {"baseline": "32-bit floats", "candidate": text}
    both = outcome(stored(FINE), stored(OTHER))
    assert both.same and both.of_numbers == "" and both.to_dict()["stored"] is None


def test_sums_in_half_floats_are_stated_on_either_side_but_not_on_both():
    """A step of half floats is 2^-11 of the sum, and stays so when the sum is divided by the number of samples."""
    sums = "numbers of 11 significant bits times a factor, as sums in few digits are"
    for pair, numbers in (((FINE, SUMMED), ("32-bit floats", sums)), ((half(FINE), SUMMED), ("half floats", sums))):
        verdict = outcome(*pair)
        assert verdict.same and verdict.numbers == numbers and sums in verdict.of_numbers
    assert outcome(SUMMED, of_samples(4, np.float16)).of_numbers == ""


def test_fine_numbers_have_no_steps():
    """Neither single floats, nor their multiples, nor integers of 16 bits, whose steps do not grow with the light."""
    for picture in (FINE, 1.1 * FINE, np.round(65535 * np.clip(FINE, 0, 1)) / 65535):
        assert not steps_of(picture).coarse


def test_steps_of_sums_are_seen_over_octaves_and_in_any_unit():
    """Eleven bits of values over six octaves, times a factor; random numbers with gaps as large lie on no steps."""
    rng = np.random.default_rng(7)
    values = 2.0 ** rng.uniform(-6, 0, (100, 100, 3))
    step = 2.0 ** (np.floor(np.log2(values)) - 10)
    for factor in (1 / 3, 1e3 / 3):
        steps = steps_of((np.round(values / step) * step * np.float32(factor)).astype(np.float32).astype(float))
        assert steps.coarse and steps.text.startswith("numbers of 11 significant bits")
    few = rng.uniform(0.5, 1, (10, 20, 1)).astype(np.float32).astype(float)
    assert steps_of(few).text == "32-bit floats"  # 200 values are no levels where no two are equal
