"""Chi2 between two effects' predictions, by least squares written out, camera and lamp bound by what is known."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.effects import Effect, Parameter, catalogue
from cboxlab.rendering.model import displacement
from cboxlab.scenes import cornell_camera
from cboxlab.validation.diagnose import further_captures as module
from cboxlab.validation.diagnose.further_captures import distance, separations
from cboxlab.validation.diagnose.hypotheses import Hypothesis
from cboxlab.validation.diagnose.linear_model import model_variance
from cboxlab.validation.diagnose.search import Candidate

SHAPE = (2, 12, 12)
SCALE, READ_VARIANCE = 0.8, 25.0
#: One standard deviation each: of the camera's ten parameters, and of the lamp's power.
PRIORS = np.diag(1 / np.array([0.4, 0.4, 0.8, 0.03, 0.03, 0.01, 0.2, 0.3, 0.3, 0.002, 0.02]))
AMOUNT = Parameter("amount", null=0.0, low=-10.0, high=10.0, step=0.1)


class Pictures:
    """1000 DN, patterns by the effects' amounts, and what the camera's motion does."""

    camera = cornell_camera(12)

    def __init__(self):
        random = np.random.default_rng(6)
        self.patterns = {
            "cause": 20 * random.standard_normal(SHAPE),
            "faint": 1e-6 * random.standard_normal(SHAPE),
        }
        self.derivative = 10 * random.standard_normal((10, *SHAPE))

    def signal(self, effects):
        picture = np.full(SHAPE, 1000.0)
        for effect in effects:
            if effect.stage == "camera":
                picture += np.tensordot(displacement(self.camera, (), (effect,)), self.derivative, 1)
            else:
                picture += effect.values["amount"] * self.patterns[effect.id]
        return picture


def between(first, other, used):
    """``distance`` of two candidates in the capture itself."""
    predictor = Pictures()
    linearised = SimpleNamespace(
        scale=SCALE,
        model_effects=(),
        predictor=predictor,
        base=predictor.signal(()),
        derivative=predictor.derivative,
        model=SimpleNamespace(used=used, priors=PRIORS),
    )
    variance = SimpleNamespace(predicted_variance=lambda signal: np.full(SHAPE, READ_VARIANCE))
    return distance(SimpleNamespace(calibration=variance), linearised, None, (), first, other)


def candidate(name, amount):
    effect = Effect(name, "filter", name, (AMOUNT,), lambda value, amount: value, "")
    return Candidate(Hypothesis(effect, (AMOUNT,), {}), {"amount": amount}, {}, 0.0, np.zeros(0))


def pose(shift_mm):
    effect = catalogue()["camera-pose"]
    free = tuple(p for p in effect.numbers if p.name == "tx_mm")
    fixed = {p.name: 0.0 for p in effect.numbers if p.name != "tx_mm"}
    return Candidate(Hypothesis(effect, free, fixed), {"tx_mm": shift_mm}, {}, 0.0, np.zeros(0))


def least_squares(other, used, free):
    """The same by hand: the cause's picture over sigma, less any motion of camera and lamp within their priors, and
    any multiple of ``free`` (DN, prior rows)."""
    pictures = Pictures()
    signal = SCALE * pictures.signal([other.applied])
    sigma = np.sqrt(READ_VARIANCE + model_variance(signal))[used]
    difference = SCALE * (pictures.signal([candidate("cause", 1.0).applied]) - pictures.signal([other.applied]))
    moved = displacement(pictures.camera, (), (other.applied,)) if other.applied.stage == "camera" else np.zeros(10)
    expected = np.concatenate([difference[used] / sigma, PRIORS @ np.append(moved, 0.0)])
    nuisances = [*SCALE * pictures.derivative, pictures.signal(())]
    pixels = np.array([n[used] / sigma for n in nuisances]).T
    design = np.hstack([np.vstack([pixels, PRIORS]), np.append(free[0][used] / sigma, free[1])[:, None]])
    size = np.linalg.norm(design, axis=0)
    remainder = expected - (design / size) @ np.linalg.lstsq(design / size, expected)[0]
    return float(remainder @ remainder)


@pytest.fixture
def used():
    return np.random.default_rng(1).random(SHAPE) < 0.8


@pytest.mark.parametrize("amount", [0.0, 2.0])
def test_the_other_effects_amount_is_at_its_best_however_little_a_step_changes(used, amount):
    """Patterns of 20 DN and of a millionth of a DN: both numbers are free, whatever their unit."""
    for name in ("cause", "faint"):
        other = candidate(name, amount)
        expected = least_squares(other, used, (Pictures().patterns[name], np.zeros(11)))
        difference = between(candidate("cause", 1.0), other, used)
        assert difference == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert (difference < 1e-6) == (name == "cause")


@pytest.mark.parametrize("shift_mm", [0.5, -3.0])
def test_a_camera_that_moved_after_the_survey_pays_no_prior_for_that_motion(used, shift_mm):
    """The alternative moves the camera: its motion is free, and what the survey says counts from there."""
    other = pose(shift_mm)
    step = displacement(Pictures.camera, (), (pose(1.0).applied,))
    free = np.tensordot(step, Pictures().derivative, 1), -PRIORS @ np.append(step, 0.0)
    expected = least_squares(other, used, free)
    assert between(candidate("cause", 1.0), other, used) == pytest.approx(expected, rel=1e-6)
    assert expected > 100


@pytest.mark.parametrize(
    ("now", "further", "enough"),
    [(4.0, 26.0, True), (4.0, 24.0, False), (100.0, 110.0, False), (100.0, 126.0, True)],
)
def test_a_further_capture_is_enough_without_a_distance_that_a_remainder_hides(monkeypatch, now, further, enough):
    """Chi2 of 25 distinguishes; above it what no effect explains made this capture's own distance unreliable."""
    capture = SimpleNamespace(description="the first band once more", seconds=10.0)
    effects = [candidate(name, 1.0) for name in ("veiling-glare", "dark-offset")]
    assessed = SimpleNamespace(candidate=effects[0], indistinguishable=[effects[1]])
    monkeypatch.setattr(module, "further_captures", lambda *arguments: [capture])
    monkeypatch.setattr(module, "distance", lambda a, b, option, *others: now if option is None else further)
    (separation,) = separations(None, None, [assessed])
    assert (separation.now, separation.chi2, separation.enough) == (now, further, enough)
