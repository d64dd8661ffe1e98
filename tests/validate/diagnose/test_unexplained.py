"""When a family of levels beats the effects of the catalogue: both pay for what they may choose; levels of frames."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.effects import catalogue
from cboxlab.validation.diagnose.evidence import explained_part
from cboxlab.validation.diagnose.field_fit.light_exchange import _cosine
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.unexplained import _repeats, family_beats_effects

#: A residual of chi2 4000, which effects leave.
LEFT = np.array([np.sqrt(4000.0), 0.0, 0.0])


@pytest.mark.parametrize("numbers", [0, 1, 3])
@pytest.mark.parametrize("effects", [1, 2])
def test_levels_must_gain_more_than_effects_less_what_those_paid(numbers, effects):
    """Effects explain 1000, and a hundredth more by errors of their shapes. They paid 4.6 for each number, and twice
    the logarithm of the catalogue's length for each choice; the family must be ahead by 9.2."""
    model = SimpleNamespace(chi2=5000.0, count=2000, residual=np.zeros(3), whiten=lambda change: np.zeros(3))
    traced = SimpleNamespace(free=(None,) * numbers, effect=SimpleNamespace(stage="transport"))
    selection = [SimpleNamespace(hypothesis=traced)] * effects
    paid = effects * (4.6 * numbers + 2 * np.log(len(catalogue())))
    for chi2, wins in ((1010 - paid + 9.2 - 0.1, False), (1010 - paid + 9.2 + 0.1, True)):
        explanation = SimpleNamespace(family="time-order", levels=True, change=None, gain=50.0, evidence=50.0 + chi2)
        assert family_beats_effects(explanation, model, selection, model, LEFT) == wins


@pytest.mark.parametrize(("remaining", "part"), [(100.0, 0.0), (70.0, 0.5), (40.0, 1.0), (20.0, 1.0)])
def test_the_explained_part_is_that_of_the_excess(remaining, part):
    """Of chi2 100 over its expectation 40; effects that leave less than that explain all and no more."""
    assert explained_part(SimpleNamespace(chi2=100.0, count=40), np.sqrt([remaining, 0.0])) == pytest.approx(part)


@pytest.mark.parametrize(
    ("family", "smear", "effects", "wins"),
    [
        ("blur", True, 1, True),
        ("blur", True, 2, False),
        ("blur", False, 1, False),
        ("object", True, 1, False),
    ],
)
def test_one_effect_and_a_smear_next_to_it_are_one_blur(family, smear, effects, wins):
    """Though the effect explains more alone: a round blur takes most of what a smear does."""
    model = _model(left_by_family=4500.0)
    stand_in = SimpleNamespace(family=family, levels=False, change=None, gain=500.0, evidence=450.0)
    smeared = SimpleNamespace(family="blur", smear=smear)
    assert family_beats_effects(stand_in, model, [None] * effects, model, LEFT, smeared) == wins
    assert not family_beats_effects(stand_in, model, [None] * effects, model, LEFT)


@pytest.mark.parametrize(("ahead", "wins"), [(29.9, False), (30.1, True)])
def test_a_family_must_leave_less_than_effects_do_by_the_errors_of_the_picture(ahead, wins):
    """0.015 per sample of 2000, next to its complexity of 50. How much of its change the errors that bands and faces
    share could make is no matter: what each leaves after them counts."""
    model = _model(left_by_family=4000.0 - 50.0 - ahead)
    stand_in = SimpleNamespace(
        family="paint-spectrum", levels=False, smear=False, change=None, gain=60.0, evidence=10.0
    )
    assert family_beats_effects(stand_in, model, [None], model, LEFT) == wins


@pytest.mark.parametrize(("score", "wins"), [(1000.0, False), (-1000.0, True)])
def test_next_to_flaws_of_the_base_scores_with_flaws_free_decide(score, wins):
    """A free field that explains flaws as well as the cause leaves less, but no less than effects and flaws do."""
    model = _model(left_by_family=2000.0)
    stand_in = SimpleNamespace(family="sensor-gain", levels=False, smear=False, change=None, gain=60.0, evidence=10.0)
    assert family_beats_effects(stand_in, model, [None], model, LEFT)
    scores = (2000.0, 2000.0 + score)
    assert family_beats_effects(stand_in, model, [None], model, LEFT, scores=lambda residual: scores) == wins


def test_errors_that_a_face_shares_are_adjusted_with_family_and_effects():
    """A change of 80 standard deviations, all of the kind that a face shares to one: half of its gain of 6400 could be
    such an error. Effects imitate it but for 200."""
    face, other = np.zeros(2011), np.zeros(2011)
    face[:1000], other[1000:2000] = 1 / np.sqrt(1000), np.sqrt(0.2)
    model = LinearModel(
        used=np.ones((1, 40, 50), bool),
        interior=np.ones(2000, bool),
        patch=np.zeros(2000, int),
        sigma=np.ones(2000),
        priors=np.zeros((11, 11)),
        by_lamp=np.ones(2000),
        basis=np.zeros((2011, 0)),
        shared_errors=face[:, None].astype(np.float32),
        residual=80 * face,
    )
    change = (80 * face[:2000]).reshape(1, 40, 50)
    stand_in = SimpleNamespace(family="paint-spectrum", levels=False, change=change, gain=3200.0, evidence=3150.0)
    assert family_beats_effects(stand_in, model, [None], model, other)
    assert not family_beats_effects(stand_in, model, [None], model, other / 2)


def _model(left_by_family):
    """A model with a residual of chi2 5000 that a family reduces to ``left_by_family``; no error is shared."""
    residual = np.array([np.sqrt(5000.0), 0.0, 0.0])
    change = residual - np.array([0.0, np.sqrt(left_by_family), 0.0])
    return SimpleNamespace(
        chi2=5000.0,
        count=2000,
        residual=residual,
        whiten=lambda _: change,
        without_shared_errors=lambda model: model,
    )


def test_levels_of_frames_are_the_lamps_with_their_noise():
    """Frames of one picture at levels of the lamp; a picture of 5000 samples of 0 to 500 DN, noise of 2 DN."""
    random = np.random.default_rng(8)
    picture, levels = random.uniform(0, 500, (50, 100)), np.array([0.99, 1.0, 1.004, 1.006])
    true = levels / levels.mean() - 1
    levels_fitted, sigmas = [], []
    for _ in range(50):
        frames = 100 + levels[:, None, None] * picture + 2 * random.standard_normal((4, 50, 100))
        capture = SimpleNamespace(
            band_ids=("lit", "single"),
            saturation_dn=4000.0,
            frames=lambda table, signal=frames: signal[: len(table.frames)],
            band=lambda name: SimpleNamespace(frames=range(4 if name == "lit" else 1)),
        )
        relative, sigma = _repeats(capture)
        assert np.isnan(relative[1]).all() and np.isinf(sigma[1])
        levels_fitted.append(relative[0])
        sigmas.append(sigma[0])
    # fifty means: four of their standard deviations; levels are relative to light above the darkest, 2.5 DN dimmer
    scatter = np.std(np.array(levels_fitted) - np.mean(levels_fitted, axis=0), ddof=1)
    assert np.mean(levels_fitted, axis=0) == pytest.approx(true, rel=0.02, abs=4 * scatter / np.sqrt(50))
    assert np.mean(sigmas) == pytest.approx(scatter, rel=0.3)


def test_a_cosine_towards_several_lamps_is_their_mean_by_the_light_of_each():
    """Straight above and at 45 degrees; whichever side of the surface the normal points to."""
    position, normal = np.zeros((3, 3)), np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 1]])
    positions = [np.array([0.0, 0, 500]), np.array([300.0, 0, 300])]
    light = np.array([[1.0, 0.0], [0.3, 0.1], [0.0, 0.0]])
    expected = [1.0, 0.75 + 0.25 * np.sqrt(0.5), 0.5 + 0.5 * np.sqrt(0.5)]
    np.testing.assert_allclose(_cosine(position, normal, positions, light), expected, rtol=1e-6)
