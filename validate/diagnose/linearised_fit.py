"""The fit of camera and lamp to a rendered picture, linearised: what effects are fitted and judged on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.calibration.instrument import tabulation_errors
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import displacement
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

from ..compare import Predicted, Prepared, Rendered, camera_jacobian
from ..predict import Predictor, picture_errors
from .fitting import Fitted, fit, gauss_newton, with_all_numbers
from .linear_model import BandErrors, LinearModel, build_linear_model, model_variance
from .search import (
    Candidate,
    Problem,
    build_problem,
    steps_of,
)

__all__ = ["LinearisedFit", "linearised_fit", "refitted_together", "residual_with", "residual_with_rendered"]

#: Relative step of the lamp's scale for the derivative by it.
_LAMP_STEP = 0.01

#: Stages with whose effects the picture is rendered again: their shapes have no error of their own.
_RENDERED = stages_between("scene", "settings")


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """A rendered picture, and the linear model of its residual about the fitted camera and lamp.

    given : the model's own effects. base : (band, y, x) DN predicted under them, from which changes by further
    effects are counted. predictor : of the picture as the fitted camera sees it.
    derivative : (10, band, y, x) of the signals with respect to the camera's parameters.
    """

    rendered: Predicted
    predictor: Predictor
    model: LinearModel
    given: tuple[AppliedEffect, ...]
    base: NDArray[np.float64]
    derivative: NDArray[np.float32]

    @property
    def scale(self) -> float:
        """The fitted factor on the lamp's power."""
        return self.rendered.fit.lamp_scale

    def counting_errors(self, more: Sequence[NDArray[np.float64]]) -> LinearisedFit:
        """The same fit, the picture's own errors counted in the covariance. more : (n,) DN each at the used pixels, one
        standard deviation of errors beside those of bands, faces and their parts."""
        model = self.model
        others = [*model.shared_errors[: model.count].T, *(error / model.sigma for error in more)]
        signal, coverage = self.scale * self.rendered.signal, self.rendered.image.coverage
        return replace(self, model=model.counting(picture_errors(signal, coverage, model.used, model.sigma, others)))

    def problem(self, chosen: Sequence[Candidate]) -> Problem:
        """What a further effect is fitted to, with these in place and their numbers marginalised over."""
        applied = [c.applied for c in chosen]
        changes = []
        for index, one in enumerate(chosen):
            rest = self._problem(self.model, [*applied[:index], *applied[index + 1 :]])
            here = rest.change(one.applied)
            changes += [rest.change(step.after.applied) - here for step in steps_of(one)]
        return self._problem(self.model.marginalised_over(changes), applied)

    def _problem(self, model: LinearModel, others: Sequence[AppliedEffect]) -> Problem:
        return build_problem(self.predictor, model, (*self.given, *others), self.scale, self.rendered.variance)


def linearised_fit(
    prepared: Prepared,
    rendered: Rendered,
    given: Sequence[AppliedEffect],
    added: Sequence[AppliedEffect] = (),
) -> LinearisedFit:
    """Linearise about the fitted camera and lamp. added : effects that the picture holds beside ``given``.

    Raises InputError where nothing could be compiled and so nothing can be predicted.
    """
    if not isinstance(rendered, Predicted):
        raise variant.not_compiled("diagnosis")
    fit_ = rendered.fit
    predictor = rendered.predictor.seen_by(fit_.camera)
    base = predictor.signal(given)
    # the variance at the signal with the best effects known: a model without interreflection predicts too dark a
    # picture, and too little noise
    lit = prepared.lit(fit_.lamp_scale * rendered.signal)
    noise = fit_.lamp_scale**2 * rendered.variance
    variance = prepared.calibration.predicted_variance(lit) + noise + model_variance(lit)
    lamp = Spectrum(WAVELENGTH_NM, prepared.scene.lamp_radiance(WAVELENGTH_NM))
    derivative = camera_jacobian(predictor.warp, fit_.camera)
    model = build_linear_model(
        measured=prepared.measured,
        base=base,
        variance=variance,
        used=rendered.used,
        coverage=rendered.image.coverage,
        fit=fit_,
        calibrated=prepared.expected_camera(given),
        derivative=np.concatenate([fit_.lamp_scale * derivative, _by_lamp_scale(predictor, (*given, *added))[None]]),
        lamp_sigma=prepared.lamp_sigma,
        band_errors=BandErrors(
            tabulation_errors(prepared.responses, lamp), prepared.calibration.noise.rounding_error_dn
        ),
    )
    single = derivative.astype(np.float32)
    return LinearisedFit(rendered, predictor, model, tuple(given), base, single)


def _by_lamp_scale(predictor: Predictor, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
    """Derivative (band, y, x) DN of the signals by the lamp's scale: offsets of counts do not grow with it."""
    ahead = predictor.at_lamp((1 + _LAMP_STEP) * predictor.lamp_scale)
    return ((1 + _LAMP_STEP) * ahead.signal(effects) - predictor.signal(effects)) / _LAMP_STEP


def residual_with(linearised: LinearisedFit, chosen: Sequence[Candidate]) -> NDArray[np.float64]:
    """(n + 11,) projected residual with these effects in place."""
    if not chosen:
        return linearised.model.residual
    added = [c.applied for c in chosen]
    signal = linearised.predictor.signal((*linearised.given, *added))
    model, camera = linearised.model, linearised.predictor.camera
    change = model.whiten(linearised.scale * (signal - linearised.base))
    return model.residual - change - model.camera_change(displacement(camera, linearised.given, added))


def residual_with_rendered(linearised: LinearisedFit, chosen: Sequence[Candidate]) -> NDArray[np.float64]:
    """(n + 11,) projected residual with those of these effects in place with which the picture is rendered again."""
    return residual_with(linearised, [c for c in chosen if c.hypothesis.effect.stage in _RENDERED])


def refitted_together(linearised: LinearisedFit, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Fit all chosen effects' numbers together. Each one's ``predicted`` is then what it changes that the others'
    numbers cannot; ``chi2`` is that of all together."""
    problem = linearised.problem(())
    if len(chosen) == 1:
        return [fit(problem, chosen[0], linearised.model.residual)]

    def evaluate(candidates: Sequence[Candidate]) -> Fitted:
        averaged = problem.noise_averaging_gain(*(c.applied for c in candidates))
        return Fitted(tuple(candidates), residual_with(linearised, candidates), averaged)

    start = evaluate([with_all_numbers(c) for c in chosen])
    best, derivatives = gauss_newton(evaluate, linearised.model, start)
    owner = np.repeat(np.arange(len(chosen)), [len(c.numbers) if c.hypothesis.free else 0 for c in best.candidates])
    found = []
    for index, candidate in enumerate(best.candidates):
        others = [c for i, c in enumerate(best.candidates) if i != index]
        theirs, change = derivatives[:, owner != index], residual_with(linearised, others) - best.left
        own = change - theirs @ np.linalg.lstsq(theirs, change)[0]
        found.append(replace(candidate, chi2=best.chi2, predicted=own.astype(np.float32)))
    return found
