"""What counts as an effect: significant, beyond the errors of the picture and of other effects' shapes."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.scenes import cornell_box
from cboxlab.validation.diagnose.evidence import (
    dispersion,
    first_significant,
    least_gain_of_any,
    penalised,
    tolerance_notes,
)
from cboxlab.validation.diagnose.hypotheses import hypotheses
from cboxlab.validation.diagnose.linear_model import smooth_part
from cboxlab.validation.diagnose.search import (
    Candidate,
    Signature,
    build_problem,
    screen,
)

PATCHES, EACH = 64, 30

#: A picture of 32 x 32 pixels without nuisances.
SQUARE = SimpleNamespace(
    count=1024,
    project=lambda vector: vector,
    image=lambda vector: vector[:1024].reshape(1, 32, 32),
    errors=None,
    gain_of_dark_errors=lambda change: 0.0,
)


def test_what_relieves_a_prior_is_found_behind_what_gains_more_by_chance():
    """A pull of 10 standard deviations on the priors, relieved by the camera's motion; chi2 is gained by an offset."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    residual = np.zeros(1035)
    residual[:3], residual[-11] = 1.0, 10.0

    def candidate(name, predicted):
        remainder = residual - predicted
        by_priors = name == "camera-pose"
        return Candidate(by_id[name], {}, {}, float(remainder @ remainder), predicted, by_priors)

    moved, offset = np.zeros(1035), np.zeros(1035)
    moved[-11], offset[:3] = 9.0, 1.0
    lucky, pose = candidate("dark-offset", offset), candidate("camera-pose", moved)
    assert first_significant([lucky, pose], residual, SQUARE, residual, residual) is pose
    assert first_significant([lucky, candidate("camera-pose", offset)], residual, SQUARE, residual, residual) is None
    # from 10 to 9.5 is no more than chance does: 9.75 of chi2 for six numbers
    moved[-11] = 0.5
    assert first_significant([candidate("camera-pose", moved)], residual, SQUARE, residual, residual) is None


def test_a_gain_must_exceed_the_errors_of_shapes_that_are_not_rendered_again():
    """Of 10^5 explained a hundredth may be an effect's own error; none of it where the picture is rendered again."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    residual, rendered = np.zeros(1035), np.zeros(1035)
    residual[0], rendered[1] = 10.0, np.sqrt(1e5 + 100)
    offset = Candidate(by_id["dark-offset"], {}, {}, 0.0, residual)
    assert first_significant([offset], residual, SQUARE, rendered, rendered) is None
    assert first_significant([offset], residual, SQUARE, residual, residual) is offset


def test_what_is_computed_exactly_hides_a_tenth_of_what_approximate_effects_hide():
    """Of 5 10^4 explained exactly a thousandth may be the warp's error, 50 of chi2; a hundredth would hide the gain."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    residual, start = np.zeros(1035), np.zeros(1035)
    residual[0], start[1] = 10.0, np.sqrt(5e4 + 100)
    offset = Candidate(by_id["dark-offset"], {}, {}, 0.0, residual)
    assert first_significant([offset], residual, SQUARE, residual, start) is offset
    assert first_significant([offset], residual, SQUARE, start, start) is None
    start[1] = np.sqrt(2e5 + 100)
    assert first_significant([offset], residual, SQUARE, residual, start) is None


def test_a_gain_must_exceed_what_errors_of_dark_levels_make():
    """Three of their standard deviations: 9 times the chi2 that they gain on average."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    residual = np.zeros(1035)
    residual[0] = 10.0
    offset = Candidate(by_id["dark-offset"], {}, {}, 0.0, residual)
    for average, expected in ((12.0, None), (10.0, offset)):
        model = SimpleNamespace(**{**vars(SQUARE), "gain_of_dark_errors": lambda _, size=average: size})
        assert first_significant([offset], residual, model, residual, residual) is expected


def test_what_changes_edges_alone_need_gain_less_than_what_changes_faces():
    """The base picture's errors are smooth: 0.01 of chi2 per sample may be theirs on faces, not at edges."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    level = np.append(np.full(1024, 0.1), np.zeros(11))
    sides = np.append(np.tile([0.1, -0.1], 512), np.zeros(11))
    for change, smooth, gains in ((level, 1.0, False), (sides, 0.0, True)):
        assert smooth_part(SQUARE, change) == pytest.approx(smooth)
        significant = first_significant(
            [Candidate(by_id["defocus"], {}, {}, 0.0, change)], change, SQUARE, change, change
        )
        assert (significant is not None) is gains


@pytest.mark.parametrize("errors", [None, "counted"])
@pytest.mark.parametrize("explained", [0.0, 1e5])
def test_no_effect_is_significant_that_gains_less_than_any_must(errors, explained):
    """Of changes at edges alone, which need the least: 0.004 a sample by size, a hundredth of what is explained."""
    effect = next(h for h in hypotheses(("f400",), cornell_box(), RenderSettings()) if h.effect.id == "defocus")
    model = SimpleNamespace(**{**vars(SQUARE), "errors": errors, "patch": np.arange(1024) % 64})
    ends, rendered = np.zeros(11), np.append(np.zeros(1034), explained**0.5)
    sides = np.append(np.tile([1.0, -1.0], 512), ends) / 32
    least = least_gain_of_any(model, np.zeros(1035), rendered, rendered)
    assert least == pytest.approx(max(1024 * (0.004 if errors is None else 0.0005), 0.01 * explained))
    for part, significant in ((0.99, False), (1.02, errors is None or explained > 0)):
        change = (part * least) ** 0.5 * sides
        significant_effect = first_significant(
            [Candidate(effect, {}, {}, 0.0, change)], change, model, rendered, rendered
        )
        assert (significant_effect is not None) is significant


def test_dispersion_is_by_how_much_neighbours_that_go_together_widen_an_amplitude():
    """Errors of 0.5 common to the 30 samples of a patch with noise of 1: a patch's sum has 1 + 30 (0.5)^2 = 8.5 times
    its variance, by 64 patches in place of the 63 that one fitted number leaves. The mean of 60 draws has a standard
    error of 2.4 %."""
    generator = np.random.default_rng(5)
    patch = np.repeat(np.arange(PATCHES), EACH)
    model = SimpleNamespace(count=PATCHES * EACH, patch=patch, errors="counted")
    shape = np.append(np.tile([1.0, -1.0], PATCHES // 2)[patch], np.zeros(11))
    results = []
    for _ in range(60):
        together = 0.5 * generator.standard_normal(PATCHES)[patch]
        residual = np.append(together + generator.standard_normal(PATCHES * EACH), np.zeros(11))
        predicted = shape * (shape @ residual) / (shape @ shape)
        results.append(dispersion(model, predicted, residual))
    assert np.mean(results) == pytest.approx(8.5 * 64 / 63, rel=0.1)  # four standard errors
    assert dispersion(SimpleNamespace(errors=None), shape, residual) == 1.0


def test_dispersion_leaves_out_one_neighbourhood_after_the_other():
    """By new fits without each patch. Three quarters of the change lie in one patch, which has a flaw: next to noise
    alone it is nine standard deviations from 0, less than two where the patches must agree."""
    generator = np.random.default_rng(3)
    patch = np.repeat(np.arange(PATCHES), EACH)
    pixels = np.where(patch == 7, np.sqrt(3.0), 1 / np.sqrt(PATCHES - 1))
    noise = generator.standard_normal(PATCHES * EACH)
    residual = noise + np.where(patch == 7, 2.0, 0.0)
    model = SimpleNamespace(count=PATCHES * EACH, patch=patch, errors="counted")

    def fitted(some):
        return (pixels[some] @ residual[some]) / (pixels[some] @ pixels[some])

    complete = fitted(patch >= 0)
    total = pixels @ pixels
    moves = np.array([complete - fitted(patch != neighbourhood) for neighbourhood in range(PATCHES)])
    ends = np.zeros(11)
    scatter = dispersion(model, np.append(complete * pixels, ends), np.append(residual, ends))
    assert scatter == pytest.approx(total * np.sum(moves**2), rel=1e-9)
    assert complete * np.sqrt(total) > 8.0
    assert complete * np.sqrt(total / scatter) < 2.0


@pytest.mark.parametrize(
    ("effect", "away", "counts"),
    [
        ("block-pose", 0.26, False),
        ("block-pose", 0.34, True),
        ("lamp-offset", 0.40, False),
        ("lamp-offset", 0.45, True),
    ],
)
def test_a_pose_within_the_tolerance_of_its_survey_is_no_finding(effect, away, counts):
    """A block of 0.1 mm and 0.05 degrees: 0.34 mm in both directions are 23 of chi-square, 18.8 come by chance in 3 of
    10,000. A lamp of 0.15 mm: 0.45 mm are 18, and 16.2 come by chance."""
    match = next(h for h in hypotheses(("f400",), cornell_box(), RenderSettings()) if h.effect.id == effect)
    change = np.append(np.tile([0.3, -0.3], 512), np.zeros(11))
    numbers = dict.fromkeys((p.name for p in match.free), 0.0) | {"dx_mm": away, "dz_mm": -away}
    moved = Candidate(match, numbers, {}, 0.0, change)
    assert (first_significant([moved], change, SQUARE, change, change) is moved) is counts
    notes = tolerance_notes([moved], change, SQUARE)
    assert notes == () if counts else effect in notes[0] and f"dx_mm {away}" in notes[0]


def test_each_free_number_costs_half_of_what_separates_two_effects():
    """Odds of 100 to 1 are 9.2 of chi2; an effect without numbers pays nothing."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings(max_bounces=2))}
    for name, numbers in (("camera-pose", 6), ("defocus", 1), ("interreflection", 0)):
        assert len(by_id[name].free) == numbers
        assert penalised(Candidate(by_id[name], {}, {}, 100.0, np.zeros(1))) == pytest.approx(100 + 4.6 * numbers)


def test_screening_leaves_out_what_averaging_noise_would_gain():
    """|r - a c|^2 + s a, s what a step of the effect smooths away, is least at (c r - s / 2) / c^2."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    generator = np.random.default_rng(1)
    column, residual = generator.standard_normal(1035), generator.standard_normal(1035)
    residual += 3 * column
    problem = SimpleNamespace(
        model=SimpleNamespace(project=lambda vector: vector, whiten_used=lambda change: change),
        scale=1.0,
        noise_averaging_gain=lambda effect: 100.0,
        camera_change=lambda effect: 0.0,
    )
    (screened,) = screen(problem, [Signature(by_id["defocus"], (0.15,), column[None])], residual)
    amplitude = (column @ residual - 50.0) / (column @ column)
    assert screened.numbers["sigma_px"] == pytest.approx(0.15 * amplitude)
    remainder = residual - amplitude * column
    assert screened.chi2 == pytest.approx(remainder @ remainder + 100.0 * amplitude)


@pytest.mark.parametrize(("scale", "brighter"), [(1.0, 1.0), (0.5, 1.0), (1.0, 1.3)])
def test_a_blur_gains_what_it_averages_of_the_pictures_noise_at_the_lamps_power(scale, brighter):
    """Variance 9 over a camera's sigma of 2 at 5000 samples; a blur that halves noise leaves a quarter of its square,
    and no more or less where it makes all signals brighter, which the lamp's fit takes back.
    Within four standard errors, 2 % each. What acts on light gains nothing: noise is drawn again there."""
    by_id = {h.effect.id: h for h in hypotheses(("f400",), cornell_box(), RenderSettings())}
    shape = (2, 50, 50)
    predictor = SimpleNamespace(
        settings=SimpleNamespace(seed=5),
        signal=lambda effects: np.zeros(shape),
        signal_and_noise=lambda effects, noise: (
            np.full(shape, 7.0 * brighter ** len(effects)),
            noise * (brighter / 2) ** len(effects),
        ),
    )
    model = SimpleNamespace(used=np.ones(shape, bool), sigma=np.full(5000, 2.0))
    problem = build_problem(predictor, model, (), scale, np.full(shape, 9.0))
    blur, haze = (
        by_id["defocus"].at({"sigma_px": 0.2}),
        by_id["haze"].at({"extinction_per_m": 0.1, "albedo": 0.9}),
    )
    expected = 5000 * (scale * 3 / 2) ** 2 * (1 - 1 / 4)
    assert problem.noise_averaging_gain(blur) == pytest.approx(expected, rel=0.08)
    assert problem.noise_averaging_gain(haze) == 0


def test_the_error_of_an_index_is_not_that_of_its_coordinate():
    """Filter shift is searched in 1 / n^2; a small error of that, as an index' own."""
    (p,) = next(h for h in hypotheses(("f400",), cornell_box(), RenderSettings()) if h.effect.id == "filter-shift").free
    coordinate, error = p.to_coordinate(2.0), 1e-6
    ends = [p.from_coordinate(coordinate + sign * error) for sign in (-1, 1)]
    assert p.deviation(2.0, error) == pytest.approx((ends[0] - ends[1]) / 2, rel=1e-4)
