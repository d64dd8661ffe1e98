"""Changes that single pictures without stated errors show: ripples, moved textures, functions of the light."""

import numpy as np
import OpenEXR
import pytest
from cboxlab.validation.compare_renders.regress import Side, regress_sides
from cboxlab.validation.compare_renders.regress.patterns import (
    Difference,
    cut_values,
    dark_pixels,
    filtered_noise,
    moved_part,
    moved_slightly,
    other_contrast,
    reused_numbers,
    shared_numbers,
    slow_change,
    small_part,
)
from cboxlab.validation.compare_renders.regress.patterns.difference import common_size, self_normalised
from helpers.programs.other_suite import run_suite
from scipy.ndimage import gaussian_filter, map_coordinates, median_filter, shift, uniform_filter

SIZE = 48
Y, X = (axis[..., None] for axis in np.meshgrid(*2 * [np.linspace(-1, 1, SIZE)], indexing="ij"))
#: A smooth light, and a floor whose paint is like noise.
LIGHT = (1 + 0.4 * X + 0.3 * Y**2) * [0.7, 0.6, 0.5]
TEXTURED = LIGHT * np.random.default_rng(3).uniform(0.2, 1.8, (SIZE, SIZE, 1))
NOISE = {
    "independent": lambda p, rng: p * (1 + 0.05 * rng.standard_normal((SIZE, SIZE, 1))),
    "filtered": lambda p, rng: gaussian_filter(p * (1 + 0.08 * rng.standard_normal((SIZE, SIZE, 1))), (0.5, 0.5, 0)),
    "counts": lambda p, rng: p * rng.poisson(400 * p.mean(axis=-1, keepdims=True)) / (400 * p.mean(axis=-1))[..., None],
    "median": lambda p, rng: median_filter(p * (1 + 0.1 * rng.standard_normal((SIZE, SIZE, 1))), (3, 3, 1)),
    "wide": lambda p, rng: uniform_filter(p * (1 + 0.15 * rng.standard_normal((SIZE, SIZE, 1))), (5, 5, 1)),
}


def outcome(picture, spoilt, noise, seed):
    """Outcome of two single pictures, the second spoilt."""
    rng = np.random.default_rng(seed)
    pictures = NOISE[noise](picture, rng), spoilt(NOISE[noise](picture, rng))
    unit = np.full(3, np.nan)
    sides = (Side("a", unit, p, None, 0.0, None, in_colour=True, colours=("R", "G", "B")) for p in pictures)
    return regress_sides(*sides)[0]


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("picture", [LIGHT, TEXTURED], ids=["smooth", "textured"])
def test_equal_single_pictures_are_the_same(picture, noise):
    for seed in range(4):
        result = outcome(picture, lambda p: p, noise, seed)
        assert result.same, result.deciding


@pytest.mark.parametrize("noise", ["independent", "filtered", "counts"])
def test_a_ripple_is_seen_and_its_period_is_stated(noise):
    cycles = np.hypot(7, 3) / np.pi
    result = outcome(LIGHT, lambda p: p * (1 + 0.1 * np.sin(7 * Y + 3 * X)), noise, 1)
    (wave,) = result.of_kind("wave")
    assert wave.different
    period = float(wave.name.removeprefix("ripple with a period of ").removesuffix(" px"))
    assert period == pytest.approx((SIZE - 1) / cycles, rel=0.08)
    assert wave.difference == pytest.approx(0.1 / np.sqrt(2), rel=0.35)


@pytest.mark.parametrize(
    ("move", "spoilt"),
    [
        ("moved by 20 px right, 0 px down", lambda p: np.roll(p, 20, axis=1)),
        ("moved by 0 px right, -3 px down", lambda p: np.roll(p, -3, axis=0)),
        ("upside down", lambda p: p[::-1]),
    ],
)
def test_a_texture_like_noise_is_found_where_it_moved(move, spoilt):
    result = outcome(TEXTURED, spoilt, "independent", 2)
    assert [row.name for row in result.of_kind("place") if row.different] == [f"fine structure {move}"]


@pytest.mark.parametrize("spoilt", [lambda p: 1.05 * p, lambda p: p + 0.05 * p.mean(), lambda p: p**1.1])
def test_a_function_of_the_light_is_no_correlated_noise(spoilt):
    assert not outcome(TEXTURED, spoilt, "filtered", 3).same


#: Objects with sharp edges on the smooth light.
SHARP = LIGHT * np.kron(np.random.default_rng(8).uniform(0.4, 1.6, (8, 8, 1)), np.ones((6, 6, 1)))


@pytest.mark.parametrize("noise", ["independent", "filtered", "counts"])
@pytest.mark.parametrize(
    ("kind", "spoilt"),
    [
        ("slow", lambda p: p * (1 + 0.08 * X)),
        ("contrast", lambda p: gaussian_filter(p, (0.8, 0.8, 0))),
        ("contrast", lambda p: 2 * p - gaussian_filter(p, (0.8, 0.8, 0))),
        ("displacement", lambda p: shift(p, (0.0, 0.3, 0.0), order=1, mode="nearest")),
    ],
    ids=["gradient", "blurred", "sharpened", "moved"],
)
def test_slow_changes_blurs_and_parts_of_a_pixel_are_seen_without_known_noise(kind, spoilt, noise):
    result = outcome(SHARP, spoilt, noise, 4)
    assert [row.different for row in result.of_kind(kind)] == [True]


def test_the_displacement_is_stated_in_pixels():
    result = outcome(SHARP, lambda p: shift(p, (0.0, 0.3, 0.0), order=1, mode="nearest"), "independent", 5)
    (row,) = result.of_kind("displacement")
    assert (row.name, row.unit) == ("moved to the right", "px")
    assert row.difference == pytest.approx(0.3, rel=0.35)


@pytest.mark.parametrize(
    ("name", "size", "motion"),
    [
        ("turned clockwise", 0.4, lambda y, x: (y - 0.4 * x / 23.5, x + 0.4 * y / 23.5)),
        ("magnified", 0.4, lambda y, x: (y - 0.4 * y / 23.5, x - 0.4 * x / 23.5)),
    ],
    ids=["turned", "magnified"],
)
def test_a_turned_or_magnified_picture_is_seen_without_known_noise(name, size, motion):
    """By 0.4 px at the sides, in noise of 10 %; equal pictures of that noise are not moved."""
    y, x = np.indices((SIZE, SIZE)) - (SIZE - 1) / 2
    sharp = SHARP[..., 0]
    down, right = motion(y, x)
    moved = map_coordinates(sharp, [axis + (SIZE - 1) / 2 for axis in (down, right)], order=1, mode="nearest")
    rng = np.random.default_rng(0)
    inside = np.pad(np.ones((SIZE - 2, SIZE - 2), bool), 1)
    for picture, is_moved in ((moved, True), (sharp, False)):
        noisy = [p * (1 + 0.1 * rng.standard_normal(p.shape)) for p in (sharp, picture)]
        finding = moved_slightly(Difference(noisy[0], noisy[1] - noisy[0], None, inside, {}))
        assert (finding.probability < 1e-5) == is_moved
        if is_moved:
            assert finding.name == name
            assert finding.size == pytest.approx(size, rel=0.5)


@pytest.mark.parametrize("pair", [("independent", "wide"), ("counts", "filtered"), ("median", "independent")])
def test_other_noise_on_each_side_is_no_slow_change_and_no_displacement(pair):
    """Noise that one side alone went through a filter with is a change of contrast at most."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        totals = [NOISE[kind](LIGHT, rng).sum(axis=-1) for kind in pair]
        inside = np.pad(np.ones((SIZE - 2, SIZE - 2), bool), 1)
        difference = Difference(totals[0], totals[1] - totals[0], None, inside, {})
        assert min(slow_change(difference).probability, moved_slightly(difference).probability) > 1e-4
        assert other_contrast(difference).probability > 1e-4


def log_denoised(picture):
    """Means of logarithms, as denoisers take them."""
    return np.exp(gaussian_filter(np.log(np.maximum(picture, 1e-4)), (1.2, 1.2, 0)))


@pytest.mark.parametrize("filtered", [log_denoised, lambda p: median_filter(p, (3, 3, 1))], ids=["denoiser", "median"])
def test_a_denoiser_of_one_side_is_seen_by_the_structure_it_takes(filtered):
    result = outcome(SHARP, filtered, "counts", 7)
    (row,) = result.of_kind("contrast")
    assert row.different
    assert row.name == "fine structure of the candidate weaker"
    equal = outcome(filtered(SHARP), lambda p: p, "counts", 7)
    assert not equal.of_kind("contrast")[0].different


@pytest.mark.parametrize(
    ("noise", "height", "blur", "paint"),
    [("independent", 4, 0.0, 0.5), ("independent", 6, 0.0, 0.8), ("filtered", 8, 0.5, 0.5)],
    ids=["24 px, half", "36 px, 20 %", "48 px, behind a filter"],
)
def test_a_missing_object_of_few_pixels_is_seen_in_its_place(noise, height, blur, paint):
    dark_part = np.ones((SIZE, SIZE, 1))
    dark_part[20 : 20 + height, 30:36] = paint
    blurred = gaussian_filter(dark_part, (blur, blur, 0)) if blur else dark_part
    result = outcome(LIGHT * dark_part, lambda p: p / blurred, noise, 8)
    (row,) = result.of_kind("part")
    assert row.different
    x, y = (int(word) for word in row.name.split()[-3::2])
    assert max(abs(x - 32.5), abs(y - 19.5 - height / 2)) <= 4
    assert row.difference > 0
    assert outcome(LIGHT * dark_part, lambda p: p, noise, 8).same


def test_the_same_light_states_what_could_not_be_seen():
    result = outcome(LIGHT, lambda p: p, "independent", 9)
    assert result.same
    size = float(result.unseen.split("below ")[1].split(" %")[0]) / 100
    assert size == pytest.approx(result.would_have_seen_in_parts, rel=0.06)
    assert "other seeds" in result.unseen
    # a block of 36 pixels with 7 % of noise, at the threshold of 64 tests of Student's t
    assert 4 * 0.07 / 6 < size < 16 * 0.07 / 6
    block = np.ones((SIZE, SIZE, 1))
    block[12:18, 24:30] = 1 + 1.2 * size
    assert not outcome(LIGHT, lambda p: p * block, "independent", 9).same


def repeated_noise(rng, size=96, tile=16):
    """(y, x) noise that a renderer repeats in each tile."""
    return np.tile(rng.standard_normal((tile, tile)), (size // tile,) * 2)


def test_random_numbers_reused_in_tiles_are_seen_where_one_side_alone_does_so():
    rng = np.random.default_rng(6)
    light = np.kron(LIGHT[..., 0] * np.kron(rng.uniform(0.4, 1.6, (4, 4)), np.ones((12, 12))), np.ones((2, 2)))
    inside = np.pad(np.ones((94, 94), bool), 1)

    def finding(*noise):
        first, second = (light * (1 + 0.05 * n) for n in noise)
        return reused_numbers(Difference(first, second - first, None, inside, {}))

    repeats = finding(rng.standard_normal(light.shape), repeated_noise(rng))
    assert repeats.probability < 1e-6
    assert repeats.name.startswith("reused random numbers: noise of the candidate repeats")
    assert finding(rng.standard_normal(light.shape), rng.standard_normal(light.shape)).probability > 1e-3
    assert finding(repeated_noise(rng), repeated_noise(rng)) is None
    # a twelfth of the variance repeats: all pairs of tiles show it, neighbouring tiles alone do not
    faint = np.sqrt(0.92) * rng.standard_normal(light.shape) + np.sqrt(0.08) * repeated_noise(rng)
    assert finding(rng.standard_normal(light.shape), faint).probability < 1e-6
    assert finding(faint, rng.standard_normal(light.shape)).name.endswith("of the baseline repeats in tiles of 16 px")


def test_random_numbers_shared_by_blocks_are_seen_where_one_side_alone_does_so():
    """Blocks of 2 x 2 px; neighbours that a filter makes alike have no borders."""
    rng, size = np.random.default_rng(7), 72
    light = np.kron(rng.uniform(0.4, 1.6, (9, 9)), np.ones((8, 8)))
    inside = np.pad(np.ones((size - 2, size - 2), bool), 1)

    def single():
        return rng.standard_normal((size, size))

    def shared():
        return np.kron(rng.standard_normal((size // 2, size // 2)), np.ones((2, 2)))

    def finding(*noise):
        first, second = (light * (1 + 0.3 * n) for n in noise)
        return shared_numbers(Difference(first, second - first, None, inside, {}))

    blocks = finding(single(), shared())
    assert blocks.probability < 1e-6
    assert blocks.name == "shared random numbers: noise of the candidate is alike in groups of 2 x 2 pixels"
    assert "of the baseline" in finding(shared(), single()).name
    filtered = single(), 2 * gaussian_filter(single(), 0.7)
    assert all(finding(*noise).probability > 1e-3 for noise in ((single(), single()), (shared(), shared()), filtered))


def test_a_filter_of_one_side_is_seen_in_its_noise_whatever_the_samples():
    """Little structure shows a blur; twice the samples, both filtered or not, are none."""
    rng, size = np.random.default_rng(8), 64
    light = np.kron(rng.uniform(0.9, 1.1, (8, 8)), np.ones((8, 8)))
    inside = np.pad(np.ones((size - 2, size - 2), bool), 1)

    def picture(noise, blur=0.0):
        values = light * (1 + noise * rng.standard_normal((size, size)))
        return gaussian_filter(values, blur) if blur else values

    def finding(first, second):
        return filtered_noise(Difference(first, second - first, None, inside, {}, clustering=1.5))

    assert finding(picture(0.2), picture(0.2, 0.6)).probability < 1e-6
    assert "of the candidate is filtered" in finding(picture(0.2), picture(0.2, 0.6)).name
    assert "of the baseline is filtered" in finding(picture(0.2, 0.6), picture(0.2)).name
    for blur in (0.0, 0.5):
        assert finding(picture(0.2, blur), picture(0.1, blur)).probability > 1e-3


@pytest.mark.parametrize("by", [0.0, 0.7])
def test_a_small_object_that_moved_is_seen_in_its_place(by):
    rng, (y, x) = np.random.default_rng(9), np.indices((SIZE, SIZE))
    light = LIGHT[..., 0] * np.kron(rng.uniform(0.7, 1.3, (3, 3)), np.ones((16, 16)))
    inside = np.pad(np.ones((SIZE - 2, SIZE - 2), bool), 1)
    pictures = []
    for middle in (30.0, 30.0 + by):
        covered = gaussian_filter(np.clip(4.5 - np.hypot(y - 14, x - middle), 0, 1), 0.5)
        pictures.append(light * (1 - 0.4 * covered) * (1 + 0.04 * rng.standard_normal((SIZE, SIZE))))
    result = moved_part(Difference(pictures[0], pictures[1] - pictures[0], None, inside, {}), *pictures)
    assert (result.probability < 1e-5) == (by > 0)
    if by:
        left, top, right, bottom = result.parameters["bounds_px"]
        assert left <= 30 < right
        assert top <= 14 < bottom
        assert result.size == pytest.approx(by, rel=0.4)


def test_negative_lobes_cut_off_on_one_side_alone_are_seen():
    rng = np.random.default_rng(10)
    lobes = np.where(rng.random((SIZE, SIZE)) < 0.2, -0.05, 1.0)
    pictures = [lobes * (1 + 0.1 * rng.standard_normal((SIZE, SIZE))) for _ in range(2)]
    result = cut_values(pictures[0][None], np.maximum(pictures[1], 0)[None])
    assert result.probability < 1e-6
    assert result.name == "values of the candidate cut off below 0"
    empty = [p * (rng.random((SIZE, SIZE)) < 0.7) for p in pictures]
    for equal in (pictures, empty, [np.maximum(p, 0) for p in pictures]):
        finding = cut_values(*np.array(equal)[:, None])
        assert finding is None or finding.probability > 1e-3


@pytest.mark.parametrize("bright", [0.0, 1e4], ids=["none", "fireflies"])
def test_a_firefly_behind_a_pixel_filter_is_no_object(bright):
    """A splat of some pixels on one side, far brighter than its surroundings."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        sides = [gaussian_filter(LIGHT[..., 0] * (1 + 0.08 * rng.standard_normal((SIZE, SIZE))), 0.5) for _ in range(2)]
        splat = np.zeros((SIZE, SIZE))
        splat[tuple(rng.integers(8, 40, 2))] = bright
        sides[1] += gaussian_filter(splat, 0.5)
        inside = np.pad(np.ones((SIZE - 2, SIZE - 2), bool), 1)
        difference = Difference(sides[0], sides[1] - sides[0], None, inside, {}, clustering=np.pi)
        assert small_part(difference, *sides).probability > 1e-3


#: Spoilt pictures by the name of a test of an imaginary renderer; equal ones first.
SPOILT = {
    "equal": lambda p: p,
    "mirrored": lambda p: p[:, ::-1],
    "checkered": lambda p: p * (1 + 0.2 * (2 * (np.indices((SIZE, SIZE)).sum(axis=0) % 2) - 1)[..., None]),
    "moved_lamp": lambda p: p / LIGHT * (1 + 0.2 * X + 0.3 * Y**2) * [0.7, 0.6, 0.5],
}


def test_the_fixture_compares_single_pictures_with_copies_of_earlier_ones(tmp_path):
    """Pictures of a textured floor without stated errors."""

    def written(name, picture):
        planes = {channel: np.ascontiguousarray(picture[..., i], np.float32) for i, channel in enumerate("RGB")}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(tmp_path / f"{name}.exr"))

    def test_of(name):
        call = f"same_light('{name}', Path(__file__).parent / '{name}.exr', seed=1, samples=64)"
        return f"def test_{name}(same_light):\n    {call}"

    (tmp_path / "test_light.py").write_text("\n\n\n".join(["from pathlib import Path", *map(test_of, SPOILT)]))
    for number, name in enumerate(SPOILT):
        written(name, NOISE["filtered"](TEXTURED, np.random.default_rng(number)))
    assert run_suite(tmp_path, "--update-light-references")[0] == 0
    for number, (name, spoilt) in enumerate(SPOILT.items()):
        written(name, spoilt(NOISE["filtered"](TEXTURED, np.random.default_rng(50 + number))))
    code, printed = run_suite(tmp_path)
    assert code == 1
    assert "3 failed, 1 passed" in printed, printed


def test_gross_noise_that_reaches_far_changes_no_mean():
    """Denoised pictures of one sample: logarithms scatter by 1.1 over some pixels."""

    def kinds(factor, seed):
        rng = np.random.default_rng(seed)
        logs = [6 * gaussian_filter(rng.standard_normal((SIZE, SIZE, 1)), (1.5, 1.5, 0)) for _ in range(2)]
        pictures = LIGHT * np.exp(logs[0]), factor * LIGHT * np.exp(logs[1])
        unit = np.full(3, np.nan)
        sides = (Side("a", unit, p, None, 0.0, None, in_colour=True, colours=("R", "G", "B")) for p in pictures)
        return {row.kind for row in regress_sides(*sides)[0].deciding}

    for seed in range(2, 5):
        assert not kinds(1.0, seed)
    assert {"whole", "band", "even"} <= kinds(6.0, 2)


@pytest.mark.parametrize("lamp", [1.0, 30.0], ids=["no lamp", "lamp"])
def test_a_bright_lamp_hides_no_gradient(lamp):
    """A lamp whose edges are brighter than all else would rule sums over the picture by a few pixels."""
    rng = np.random.default_rng(3)
    light = 1 + 0.3 * Y[..., 0]
    light[4:8, 20:30] *= lamp
    scatter = np.where(light > 5, 0.02, 0.1)
    noisy = [light * (1 + scatter * (rng.standard_gamma(1.0, light.shape) - 1)) for _ in range(2)]
    inside = np.pad(np.ones((SIZE - 2, SIZE - 2), bool), 1)
    smooth = inside & (light < 5)
    for slope, is_clear in ((0.05, True), (0.0, False)):
        total = noisy[1] * (1 + slope * X[..., 0]) - noisy[0]
        finding = slow_change(Difference(noisy[0], total, None, smooth, {"edges": inside & ~smooth}))
        assert (finding.probability < 5e-5) == is_clear


def test_few_blocks_that_agree_are_clear_and_their_false_alarms_are_as_stated():
    rng = np.random.default_rng(1)
    norms = np.r_[np.ones(8), np.full(136, 1e-3)]
    terms = norms * (0.5 + 0.03 * rng.standard_normal(norms.size))
    size, sigma, degrees, probability = common_size(terms, norms)
    assert size == pytest.approx(0.5, abs=4 * sigma)
    assert 6 < degrees < 8
    assert probability < 1e-8 < self_normalised(terms)[1]
    # blocks of heavy tails and unequal weights: 1 % of 4,000
    draws = [common_size(w * rng.standard_t(4, 12), w)[3] for w in rng.uniform(0.5, 1.5, (4000, 12))]
    assert 0.004 < np.mean(np.array(draws) < 0.01) < 0.016


@pytest.mark.parametrize(
    ("quiet", "edges", "other_side", "count"),
    [(12, 8, 0, 12), (12, 8, 8, 0), (3, 12, 0, 0)],
    ids=["all over the picture", "on both sides", "at edges"],
)
def test_black_pixels_of_one_side_are_seen_also_at_edges(quiet, edges, other_side, count):
    """Noise makes them on both sides, and at edges rather than in quiet parts."""
    rng = np.random.default_rng(2)
    sides = [LIGHT[..., 0] * (1 + 0.05 * rng.standard_normal((SIZE, SIZE))) for _ in range(2)]
    sides[1][4 : 4 + 3 * quiet : 3, 10] = 0
    sides[1][4 : 4 + 3 * edges : 3, 38] = 0
    sides[0][5 : 5 + 3 * other_side : 3, 34] = 0
    smooth = np.zeros((SIZE, SIZE), bool)
    smooth[2:-2, 2 : SIZE // 2] = True
    assert dark_pixels(*sides, smooth, 1e-6, with_errors=False).pixels == count
