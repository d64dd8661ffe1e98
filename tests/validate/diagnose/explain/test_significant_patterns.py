"""Patterns that the picture's own errors do not make are seen below what smooth patterns must reach."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.fitted_fields import ImageMaps
from cboxlab.validation.diagnose.explain import NONE, explain, explain_masked_families, motions
from cboxlab.validation.diagnose.families.blur import blur_equations, uneven_blurs
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.unexplained import explanation_to_report, is_significant_pattern
from helpers.captures.small_excess import BANDS, COLUMNS, ROWS, SIGMA, SIGNAL, SIZE, small_excess
from scipy.ndimage import shift

DRAW = np.random.default_rng(5)


def _model(excess):
    """The linear model of a small excess: a lamp's scale alone is adjusted."""
    count = excess.used.sum()
    basis = np.append(excess.nuisances.reshape(count, 1), np.zeros((11, 1)), axis=0)
    return LinearModel(
        used=excess.used,
        interior=np.ones(count, bool),
        patch=np.zeros(count, int),
        sigma=SIGMA.ravel(),
        priors=np.zeros((11, 11)),
        by_lamp=np.ones(count),
        basis=basis,
        shared_errors=np.zeros((count + 11, 1), np.float32),
        residual=np.append(excess.residual.ravel().astype(float), np.zeros(11)),
    )


def _significant(change, seed=3):
    excess = small_excess(change, seed=seed)
    model = _model(excess)
    return is_significant_pattern(explain(excess), model, model.residual, 0.0)


@pytest.mark.parametrize(
    "pattern",
    [
        SIGMA * DRAW.normal(0, 0.25, (1, SIZE, 1)) * np.ones((BANDS, 1, 1)),
        SIGMA * DRAW.normal(0, 0.25, (1, 1, SIZE)) * np.ones((BANDS, 1, 1)),
        SIGMA * 0.4 * np.cos(0.7 * COLUMNS + 0.4 * ROWS) * np.eye(BANDS)[1][:, None, None],
    ],
    ids=["rows", "columns", "fringes in one band"],
)
def test_a_pattern_of_a_quarter_of_the_noise_is_seen(pattern):
    assert np.mean((pattern / SIGMA) ** 2) < 0.08
    assert _significant(pattern)


@pytest.mark.parametrize("seed", range(4))
def test_noise_has_no_pattern(seed):
    assert not _significant(np.zeros(SIGNAL.shape), seed)


def test_a_smooth_flaw_of_all_bands_is_left_to_the_other_test():
    assert not _significant(0.3 * SIGMA * np.cos(COLUMNS / 30))


@pytest.mark.parametrize(("where", "expected"), [(COLUMNS >= 0, True), (abs(COLUMNS - 20) < 12, False)])
def test_rows_stand_out_where_they_hold_between_edges(where, expected):
    """Half of the columns are near an edge along the rows: what is wrong there alone is no pattern of the sensor."""
    rows = 0.5 * SIGMA * DRAW.normal(0, 1, (1, SIZE, 1))
    excess = small_excess(np.where(where, rows, 0.0))
    inside = np.broadcast_to(abs(COLUMNS - 20) >= 12, SIGNAL.shape).ravel()
    model = replace(_model(excess), interior=inside)
    assert is_significant_pattern(explain(excess), model, model.residual, 0.0) == expected


def _spot(row, column):
    """A grain on the sensor: a seventh of the light of a disk of 16 pixels."""
    return -0.15 * SIGNAL * (np.hypot(ROWS - row, COLUMNS - column) < 2.3)


def test_a_grain_on_the_sensor_is_seen_and_spots_here_and_there_are_left_to_the_other_test():
    """One alone; and with three weaker ones, as the dark corners of a picture may be wrong together."""
    grain = _spot(12, 10)
    assert _significant(grain)
    others = 0.7 * sum(_spot(*position) for position in ((36, 38), (12, 38), (36, 10)))
    together = small_excess(grain + others)
    assert explain(together).form.startswith("a spot; then a spot")
    assert not _significant(grain + others)


@pytest.mark.parametrize("radius", [1.6, 2.3, 5.0])
def test_a_grain_holds_in_pixels_held_out(radius):
    assert _significant(-0.1 * SIGNAL * (np.hypot(ROWS - 12, COLUMNS - 10) < radius))


@pytest.mark.parametrize("seed", range(6))
def test_pixels_that_scatter_in_one_place_are_no_pattern(seed):
    """By a tenth, alike in all bands, as a render's own noise is in deep shadow: far above noise, and without shape."""
    corner = np.hypot(ROWS - 12, COLUMNS - 10) < 3
    scatter = np.where(corner, np.random.default_rng(seed).standard_normal(corner.shape), 0.0)
    change = 0.1 * SIGNAL * scatter
    assert not _significant(change)


def _exchanged(*steps):
    """A tenth of the light goes to pixels at these steps (down, right) and opposite to them."""
    ends = [shift(SIGNAL, (0, s * d, s * r), order=0, mode="nearest") for d, r in steps for s in (1, -1)]
    return 0.1 * (np.mean(ends, axis=0) - SIGNAL)


@pytest.mark.parametrize(
    ("step", "line"),
    [
        ((0, 1), "the rows"),
        ((1, 0), "the columns"),
        ((1, 1), "the falling"),
        ((1, -1), "the rising"),
        ((1, 2), "the f"),
    ],
    ids=str,
)
def test_a_smear_with_large_effects_stands_out_and_a_round_blur_does_not(step, line):
    smear, blur = _exchanged(step), _exchanged((0, 1), (1, 0))
    gain = np.sum((smear / SIGMA) ** 2)
    for change, by_effects, is_seen in (
        (smear, gain, True),
        (smear, 200 * gain, False),
        (blur, 0.0, False),
    ):
        excess = small_excess(change)
        model = _model(excess)
        explanation, *_ = explain_masked_families(excess)
        assert is_significant_pattern(explanation, model, model.residual, by_effects) == is_seen
        assert change is blur or explanation.form.startswith(f"along {line}")


def _blurred_by(share):
    """The picture with a share (y, x) or a number of each pixel's light spread over its four neighbours."""
    around = sum(shift(SIGNAL, (0, *step), order=0, mode="nearest") for step in ((0, 1), (0, -1), (1, 0), (-1, 0)))
    return share * (around / 4 - SIGNAL)


def test_a_blur_that_grows_across_the_picture_stands_out_and_an_even_one_does_not():
    for share, is_seen in ((0.3 * (COLUMNS / SIZE) ** 2, True), (0.2, False)):
        excess = small_excess(_blurred_by(share))
        model = _model(excess)
        (form,), (_, uneven, _) = uneven_blurs(excess), explain_masked_families(excess)
        assert (form.evidence > 0) == is_seen
        assert is_significant_pattern(uneven, model, model.residual, 0.0) == is_seen
        # what an even blur gains does not count: the least gain is 0.004 of each of these samples
        assert not is_significant_pattern(replace(uneven, gain=0.003 * excess.count), model, model.residual, 0.0)


def test_the_noise_of_a_picture_without_edges_neither_asks_for_a_blur_nor_informs_of_one():
    noise_map, draw = (SIGMA * np.random.default_rng(seed).normal(0, 1, SIGNAL.shape) for seed in (1, 2))
    excess = replace(small_excess(-noise_map), signal=np.mean(SIGNAL, axis=(1, 2), keepdims=True) + noise_map)
    plain, informed = (
        blur_equations(replace(excess, noise=noise), ImageMaps("cosines"), 1)[0] for noise in (0 * draw, draw)
    )
    for with_noise, without in ((plain.a, informed.a), (plain.b, informed.b), (plain.trial_b, informed.trial_b)):
        assert np.all(np.abs(without.sum(axis=0)) < 0.1 * np.abs(with_noise.sum(axis=0)).max())


def test_what_a_blur_gains_by_averaging_the_noise_of_the_picture_is_no_blur():
    """Half of the picture is as noisy as the photograph; the size of its noise is known, its values are not."""
    half = (COLUMNS < SIZE / 2) * SIGMA
    noise_map, draw = (half * np.random.default_rng(seed).normal(0, 1, SIGNAL.shape) for seed in (1, 2))
    for noise, is_seen in ((draw, False), (0 * draw, True)):
        excess = replace(small_excess(-noise_map), signal=SIGNAL + noise_map, noise=noise)
        model = _model(excess)
        _, uneven, _ = explain_masked_families(excess)
        assert is_significant_pattern(uneven, model, model.residual, 0.0) == is_seen


def _turned(size):
    """The picture turned about its centre by small angles, (band,) rad."""
    down, right = np.gradient(SIGNAL, axis=(1, 2))
    middle = (SIZE - 1) / 2
    return np.reshape(size, (BANDS, 1, 1)) * (right * (ROWS - middle) - down * (COLUMNS - middle))


@pytest.mark.parametrize(
    ("bands", "phrase"),
    [([0, 0, 1, 0], "in one band"), ([2, 0, -1, -1], "in each band otherwise")],
)
def test_a_displacement_of_some_bands_stands_out_with_one_of_all(bands, phrase):
    """Errors of the rendered picture's edges are in all bands alike. Where something is left anyway, what explains most
    of it is reported."""
    alike, partial = _turned([0.02] * BANDS), _turned(0.01 * np.array(bands))
    trial_bands = tuple(f"b{index}" for index, part in enumerate(bands) if part)
    for change, left, expected in (
        (alike, False, None),
        (alike + partial, False, trial_bands),
        (alike + partial, True, ("b0", "b1", "b2", "b3")),
        (partial, True, trial_bands),
    ):
        excess = small_excess(change)
        model = _model(excess)
        best, *others = explain(excess), *explain_masked_families(excess)
        report = explanation_to_report((best, *others), model, model.residual, 0.0, left)
        assert (report and report.bands) == expected
    assert report.form.endswith(phrase)
    assert (report.family, report.runner_up) == ("displacement", best.runner_up)
    doubted = {"displacement": 0.5, NONE: 0.5}
    answers = [replace(each, odds=doubted).named_if_likely().family for each in (best, report)]
    assert answers == [NONE, "displacement"]  # the odds judge the competition, and significance the separate fit
    turned = np.degrees(0.01 * (bands[0] or 1))
    assert 0.5 < motions(report)[trial_bands[0]].turned_deg / turned < 1.1  # a smooth field falls short by its prior
