"""Prediction of effects in one rendered picture, camera and lamp fitted to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import seen_through
from cboxlab.rendering.perturbation import warp_change
from numpy.typing import NDArray

from ..compare import (
    ChiSquare,
    Comparison,
    NuisanceFit,
    Nuisances,
    Predicted,
    Validation,
    camera_jacobian,
    compared,
    fit_lamp_scale,
)
from ..diagnose import nuisance_priors
from ..predict import Predictor

__all__ = ["Base", "Prediction", "predict", "same_effects"]

#: Number of rounds of the fit of camera and lamp, each with weights from the last one's residuals.
_ROUNDS = 3

#: Samples of the fit of camera and lamp that are weighted at once: their numbers stay in the processor's cache.
_SAMPLES_AT_ONCE = 2**13

#: Residual beyond which a sample counts less, standard deviations, as in the complete fit of `compare`.
_HUBER_SIGMA = 3.0


def same_effects(effects: Sequence[AppliedEffect], other: Sequence[AppliedEffect]) -> bool:
    """Whether two lists hold the same effects with the same values in the same order.

    Parameters
    ----------
    effects
        One list.
    other
        The other list.

    Returns
    -------
    bool
        Standard deviations do not count.
    """
    return [(e.id, dict(e.values)) for e in effects] == [(e.id, dict(e.values)) for e in other]


@dataclass(frozen=True, eq=False)
class Base:
    """Validation to predict from: a rendered picture with its predictor, camera and lamp fitted."""

    #: The validation, with a predictor.
    validation: Validation

    def __post_init__(self) -> None:
        """InputError without a compiled variant of the engine, which predicts."""
        if not isinstance(self.validation.rendered, Predicted):
            raise variant.not_compiled("study")

    @property
    def rendered(self) -> Predicted:
        """The picture with its predictor."""
        if not isinstance(self.validation.rendered, Predicted):
            raise TypeError("a base has a predictor")
        return self.validation.rendered

    def prepare(self) -> None:
        """Compute now what every prediction needs, so that the first one is as fast as later ones.

        Changes refer to the picture by patch transport with the base's own effects.
        """
        _ = self.refit_change, self.derivative
        for predictor in (self._rough, self._retracing):
            predictor.patch_picture(predictor.included)

    def drafting(self, effects: Sequence[AppliedEffect]) -> Predictor:
        """The predictor of fewer rays for given effects.

        Effects that need no new rays it predicts as the complete one does.

        Parameters
        ----------
        effects
            Effects to predict.

        Returns
        -------
        Predictor
            Predictor with a quarter of the rays where light is traced again.
        """
        return self._retracing if self.rendered.predictor.needs_tracing(effects) else self._rough

    @cached_property
    def _retracing(self) -> Predictor:
        return self.rendered.predictor.draft()

    @cached_property
    def _rough(self) -> Predictor:
        return self.rendered.predictor.rough()

    @cached_property
    def refit_change(self) -> NDArray[np.float64]:
        """(band, y, x) DN by which the fitted camera changes the picture."""
        return warp_change(self.rendered.predictor.warp, self.rendered.fit.camera)

    @cached_property
    def derivative(self) -> NDArray[np.float64]:
        """(10, band, y, x) of the signals with respect to the fitted camera's parameters."""
        return camera_jacobian(self.rendered.predictor.warp, self.rendered.fit.camera)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of one capture by a model with given effects."""

    #: Validation from which it was predicted.
    base: Base
    #: Effects of the model, in order.
    effects: tuple[AppliedEffect, ...]
    #: The base picture with the predicted signal, and camera and lamp fitted to it.
    rendered: Predicted
    #: Whether the picture was rendered with these effects; otherwise light transport is that of the patch predictor.
    exact: bool

    @property
    def signal(self) -> NDArray[np.float64]:
        """(band, y, x) DN, the lamp's fitted power included."""
        return self.rendered.fit.lamp_scale * self.rendered.signal

    @cached_property
    def sigma(self) -> NDArray[np.float64]:
        """(band, y, x) DN, standard deviation of measured minus predicted."""
        prepared, scale = self.base.validation.prepared, self.rendered.fit.lamp_scale
        return np.sqrt(prepared.calibration.predicted_variance(self.signal) + self.rendered.variance * scale**2)

    @cached_property
    def chi2(self) -> ChiSquare:
        """Chi2 of `comparison`, computed without its maps and colours."""
        used = self.rendered.used
        residual = (self.base.validation.prepared.measured - self.signal)[used] / self.sigma[used]
        common = self.base.validation.comparison.chi2.variance_sigma
        return ChiSquare(float(residual @ residual), residual.size, residual.size - Nuisances.count, common)

    @cached_property
    def comparison(self) -> Comparison:
        """Photograph against prediction, with maps."""
        if self.exact:
            return self.base.validation.comparison
        return compared(self.base.validation.prepared, self.rendered, self.signal)


def predict(base: Base, effects: Sequence[AppliedEffect], *, refit: bool = True, draft: bool = False) -> Prediction:
    """The picture with given effects in place of the model's, without a new rendering.

    Parameters
    ----------
    base
        Validation to predict from.
    effects
        Effects of the model, in order.
    refit
        Whether camera and lamp are fitted within their priors. Otherwise the lamp stays as it was fitted, and the
        camera moves as far as the effects move it.
    draft
        Whether light transport takes a quarter of the rays.

    Returns
    -------
    Prediction
        The base itself for the effects of its model.

    Raises
    ------
    InputError
        If an effect cannot act on this capture.
    """
    model_effects, effects = base.validation.model.effects, tuple(effects)
    if same_effects(effects, model_effects):
        return Prediction(base, effects, base.rendered, True)
    prepared, rendered = base.validation.prepared, base.rendered
    predictor = base.drafting(effects) if draft else rendered.predictor
    before, fit = predictor.signal(effects), rendered.fit
    if refit:
        step = _camera_step(base, before, effects)
        signal = before + base.refit_change + np.tensordot(step, base.derivative, 1)
        variance = prepared.calibration.predicted_variance(signal) + rendered.variance
        lamp = fit_lamp_scale(prepared.measured, signal, variance, rendered.used, prepared.lamp_sigma)
        fit = NuisanceFit(fit.camera.with_parameters(fit.camera.parameters + step), *lamp)
    else:
        moved, still = (seen_through(prepared.calibrated_camera, each).parameters for each in (effects, model_effects))
        if np.any(moved != still):
            fit = replace(fit, camera=fit.camera.with_parameters(fit.camera.parameters + moved - still))
            signal = before + warp_change(rendered.predictor.warp, fit.camera)
        else:
            signal = before + base.refit_change
    return Prediction(base, effects, replace(rendered, fit=fit, signal=signal), False)


def _camera_step(base: Base, before: NDArray[np.float64], effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
    """(10,) first-order step from the base's camera to that of the smallest chi2, lamp free.

    Samples beyond 3 sigma are weighted down, as in the complete fit; the survey is the prior. 0 without a survey.
    before : (band, y, x) DN, predicted without any motion of the camera.
    """
    prepared, rendered = base.validation.prepared, base.rendered
    camera, scale, used = rendered.fit.camera, rendered.fit.lamp_scale, rendered.used.ravel()
    expected = prepared.expected_camera(effects)
    if expected.covariance is None:
        return np.zeros(len(camera.parameters))
    rows = nuisance_priors(expected, prepared.lamp_sigma)
    prior = rows.T @ rows
    deviation = rendered.fit.missed(expected).vector
    variance = prepared.calibration.predicted_variance(prepared.noise_reference_signal(before)) + rendered.variance
    sharpness = np.zeros(len(used))  # 1 / sigma; 0 of samples that are not used
    sharpness[used] = 1 / np.sqrt(variance.ravel()[used])
    derivative = base.derivative.reshape(len(base.derivative), -1)
    still = np.where(used, np.ravel(before + base.refit_change), 0.0)
    residual = np.where(used, prepared.measured.ravel() - scale * still, 0.0) * sharpness
    step: NDArray[np.float64] = np.zeros(Nuisances.count)
    for _ in range(_ROUNDS):
        information, gradient = prior.copy(), prior @ deviation
        for first in range(0, len(used), _SAMPLES_AT_ONCE):
            some = slice(first, first + _SAMPLES_AT_ONCE)
            columns = np.vstack([derivative[:, some] * (scale * sharpness[some]), still[some] * sharpness[some]])
            weight = np.minimum(1.0, _HUBER_SIGMA / np.maximum(np.abs(residual[some] - step @ columns), 1e-9))
            information += (columns * weight) @ columns.T
            gradient += columns @ (weight * residual[some])
        step = np.asarray(np.linalg.solve(information, gradient), np.float64)
    return Nuisances.from_vector(step).camera
