"""Random numbers that repeat at a distance, or that blocks share: by products of a side with itself, moved."""

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.patterns import Difference, reused_numbers, shared_numbers
from cboxlab.validation.compare_renders.regress.patterns.noise_of_sides import _of_tiles, _overlapping, _products

SHAPE = (72, 96)
INSIDE = np.pad(np.ones((70, 94), bool), 1)
LIGHT = np.broadcast_to(np.linspace(0.5, 1.5, 96), SHAPE)


def with_copies(rng, *distances):
    """(y, x) white noise of variance 1, added to itself at distances (down, right, part of its standard deviation)."""
    noise = rng.standard_normal((3 * SHAPE[0], 3 * SHAPE[1]))
    copies = [part * np.roll(noise, (down, right), (0, 1)) for down, right, part in ((0, 0, 1.0), *distances)]
    return np.sum(copies, axis=0)[SHAPE[0] : 2 * SHAPE[0], SHAPE[1] : 2 * SHAPE[1]]


def single(rng):
    return rng.standard_normal(SHAPE)


def finding(test, first, second, unit=1.0):
    first, second = (unit * LIGHT * (1 + 0.1 * n) for n in (first, second))
    return test(Difference(first, second - first, None, INSIDE, {}))


@pytest.mark.parametrize("by", [(0, 0), (3, 0), (0, 2), (2, 3), (-2, 1), (-1, 4)])
def test_products_are_those_of_all_pixels_with_a_partner(by):
    picture = np.random.default_rng(2).standard_normal((5, 7))
    expected = np.zeros(picture.shape)
    for (row, column), value in np.ndenumerate(picture):
        partner = row + by[0], column + by[1]
        if 0 <= partner[0] < 5 and 0 <= partner[1] < 7:
            expected[row, column] = value * picture[partner]
    np.testing.assert_allclose(_overlapping(picture, picture, by), expected, atol=1e-12)
    assert _products(picture, picture)[by] == pytest.approx(expected.sum())


@pytest.mark.parametrize(("down", "right"), [(5, 9), (-7, 11), (20, 0), (0, 40)])
@pytest.mark.parametrize("side", ["candidate", "baseline"])
def test_the_distance_of_repeated_noise_is_stated_and_its_part(side, down, right):
    """Half of the variance repeats, where the moved picture overlaps with itself; in any unit of the light."""
    rng = np.random.default_rng(3)
    noise = single(rng), with_copies(rng, (down, right, 1.0)) / np.sqrt(2)
    sides = noise if side == "candidate" else noise[::-1]
    repeats = finding(reused_numbers, *sides)
    assert repeats.name == f"reused random numbers: noise of the {side} repeats {right} px right, {down} px down"
    assert repeats.probability < 1e-6 and repeats.degrees == 18 * 24 - 1
    overlap = (1 - abs(down) / SHAPE[0]) * (1 - right / SHAPE[1])
    assert repeats.size == pytest.approx(0.5 * overlap, rel=0.2)
    in_other_units = finding(reused_numbers, *sides, unit=1e3)
    assert in_other_units.size == pytest.approx(repeats.size, rel=1e-6)


@pytest.mark.parametrize(("down", "right"), [(0, 5), (4, 4), (40, 53)])
def test_nearer_noise_may_be_a_filters_and_far_noise_overlaps_too_little(down, right):
    rng = np.random.default_rng(4)
    assert finding(reused_numbers, single(rng), with_copies(rng, (down, right, 1.0))).probability > 1e-3


def test_a_texture_of_both_sides_hides_no_repeated_noise():
    rng = np.random.default_rng(5)
    texture = with_copies(rng, (0, 14, 1.0), (12, 0, 1.0), (20, 30, 1.0)) / 2
    sides = single(rng) + texture, with_copies(rng, (5, 9, 0.3)) + texture
    repeats = finding(reused_numbers, *sides)
    assert repeats.name.endswith("candidate repeats 9 px right, 5 px down") and repeats.probability < 1e-3


@pytest.mark.parametrize(
    ("others", "clearest"),
    [
        ([(down, right, 0.075) for down, right in ((0, 8), (9, 3), (4, 10), (-8, 6), (9, 7))], (0, 62, 0.22)),
        ([(down, right, 0.14) for down, right in ((0, 60), (2, 58), (-3, 59), (4, 56), (1, 55))], (9, 5, 0.16)),
    ],
    ids=["far", "near"],
)
def test_the_clearest_of_many_distances_is_stated(others, clearest):
    """In its own noise, which is that of the overlap: far copies repeat less of the picture."""
    rng = np.random.default_rng(7)
    repeats = finding(reused_numbers, single(rng), with_copies(rng, clearest, *others))
    assert repeats.name.endswith(f"repeats {clearest[1]} px right, {clearest[0]} px down")


@pytest.mark.parametrize(("axis", "lines"), [(0, "rows"), (1, "columns")])
@pytest.mark.parametrize("block_px", [2, 4])
def test_blocks_of_one_side_are_stated_with_their_contrast(axis, lines, block_px):
    """Squared steps of single pixels are 2, those of blocks 0 inside and 2 across a border; 1 of n lies across.

    The contrast is 2 / n, and squared steps of the difference are 2 + 2 / n. Large steps of the sum count less: 0.65 to
    0.85 of the quotient remain. Exchanged sides show the same.
    """
    rng = np.random.default_rng(6)
    shape = (SHAPE[0] // block_px, SHAPE[1]) if axis == 0 else (SHAPE[0], SHAPE[1] // block_px)
    alone, shared = single(rng), np.repeat(rng.standard_normal(shape), block_px, axis=axis)
    blocks = finding(shared_numbers, alone, shared)
    assert blocks.name == (f"shared random numbers: noise of the candidate is alike in groups of {block_px} {lines}")
    assert blocks.probability < 1e-6 and blocks.degrees == 18 * 24 - 1
    assert 0.65 < blocks.size * (1 + block_px) < 0.85
    exchanged = finding(shared_numbers, shared, alone)
    assert "of the baseline is" in exchanged.name and exchanged.size == pytest.approx(blocks.size)


def test_products_over_all_pairs_of_tiles_and_their_variance_are_those_of_every_pair():
    """Six tiles of 3 x 3 px: the sum over ordered pairs by hand, and its variance over random signs of all pixels."""
    draw = np.random.default_rng(8)
    apart, both = draw.standard_normal((2, 7, 9))  # a row is left over
    blocks = [[p[y : y + 3, x : x + 3] for y in (0, 3) for x in (0, 3, 6)] for p in (apart, both)]
    expected = sum(a * b for i, a in enumerate(blocks[0]) for j, b in enumerate(blocks[1]) if i != j)
    terms, variance = _of_tiles(apart, both, 3)
    np.testing.assert_allclose(terms.reshape(3, 3), expected)
    signs = draw.choice([-1.0, 1.0], (4000, 7, 9))
    sums = np.array([_of_tiles(sign * apart, sign * both, 3)[0].sum() for sign in signs])
    # the variance of a variance by random signs: sqrt(2 / 4000) is 2 %, four of these and heavy tails
    assert np.mean(sums**2) == pytest.approx(variance, rel=0.12)
