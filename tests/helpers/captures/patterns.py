"""A picture without nuisances that effects add patterns to, over noise of 1: shapes that are known exactly."""

from types import SimpleNamespace

import numpy as np
from cboxlab.rendering.effects import Effect, Parameter
from cboxlab.scenes import cornell_camera
from cboxlab.validation.diagnose.hypotheses import Hypothesis
from cboxlab.validation.diagnose.linear_model import LinearModel
from cboxlab.validation.diagnose.linearised_fit import LinearisedFit, refitted_together
from cboxlab.validation.diagnose.search import Candidate, signature

SHAPE = (3, 40, 40)
COUNT = int(np.prod(SHAPE))
AMOUNT = Parameter("amount", null=0.0, low=-10.0, high=10.0, step=0.1)


class Patterns:
    """A predictor of pictures that are sums of patterns, by the effects' amounts."""

    camera = cornell_camera(40)
    settings = SimpleNamespace(seed=0)

    def __init__(self, patterns):
        self.patterns = patterns

    def signal(self, effects):
        return 1000.0 + sum((e.values["amount"] * self.patterns[e.id] for e in effects), np.zeros(SHAPE))


def waves(across, down):
    """A smooth pattern of mean square 1, alike in all bands."""
    v, u = np.mgrid[0:40, 0:40] / 40
    wave = np.cos(np.pi * across * u) * np.cos(np.pi * down * v)
    return np.broadcast_to(wave / np.sqrt(np.mean(wave**2)), SHAPE)


def laboratory(patterns, truth, seed=4, scale=1.0):
    """A linearised fit to a picture that holds ``truth`` (amounts by name), and all signatures."""
    predictor = Patterns(patterns)
    noise = np.random.default_rng(seed).standard_normal(SHAPE)
    residual = sum((amount * patterns[name] for name, amount in truth.items()), noise)
    everywhere = np.ones(SHAPE, bool)
    rows, columns = np.indices(SHAPE[1:]) // 5
    patch = np.broadcast_to(rows * 8 + columns, SHAPE).ravel()
    model = LinearModel(
        used=everywhere,
        interior=np.ones(COUNT, bool),
        patch=patch,
        sigma=np.ones(COUNT),
        priors=np.zeros((11, 11)),
        by_lamp=np.ones(COUNT),
        basis=np.zeros((COUNT + 11, 11)),
        shared_errors=np.zeros((COUNT + 11, 1)),
        residual=np.append(residual.ravel(), np.zeros(11)),
    )
    fit = SimpleNamespace(lamp_scale=scale)
    rendered = SimpleNamespace(fit=fit, variance=np.zeros(SHAPE))
    linearised = LinearisedFit(rendered, predictor, model, (), predictor.signal(()), np.zeros((10, *SHAPE)))
    hypotheses_by_name = [
        Hypothesis(Effect(name, "filter", name, (AMOUNT,), lambda value, amount: value, ""), (AMOUNT,), {})
        for name in patterns
    ]
    return linearised, {h.effect.id: signature(predictor, (), everywhere, h) for h in hypotheses_by_name}


def fitted_together(linearised, candidates, *names):
    """Candidates of these names, fitted together."""
    start = [Candidate(candidates[name].hypothesis, {"amount": 0.1}, {}, 0.0, np.zeros(COUNT + 11)) for name in names]
    return refitted_together(linearised, start)


def names_of(candidates):
    """The identifiers of candidates' effects."""
    return {c.hypothesis.effect.id for c in candidates}
