"""The fit of camera and lamp to a rendered picture, linearised: basis of the effects' fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.calibration.instrument import Mask, tabulation_errors
from cboxlab.calibration.radiometry import filter_steps_nm
from cboxlab.rendering.chain import stages_between
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import displacement
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

from ..compare import CalibratedCapture, Predicted, Rendered, camera_jacobian, free_columns
from ..predict import Predictor, picture_errors
from .fitting import Fitted, fit, gauss_newton, with_all_numbers
from .linear_model import BandErrors, LinearModel, build_linear_model, model_variance
from .search import (
    Candidate,
    Problem,
    build_problem,
    steps_of,
)

__all__ = [
    "LinearisedFit",
    "linearised_fit",
    "refitted_together",
    "residual_with",
    "residual_with_exact",
    "residual_with_rendered",
]

#: Numerics: relative step of the lamp's scale for the derivative by it: the signal is linear but for offsets of counts.
_LAMP_STEP = 0.01

#: Stages whose effects enter the rendering itself when it is repeated: their shapes then have no error.
_RENDERED = stages_between("scene", "settings")

#: Stages whose effects are computed on coarse patches: 1 to 7 % of the change is wrong. All others are exact.
_APPROXIMATE = stages_between("transport", "transport")


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """A rendered picture, and the linear model of its residual about the fitted camera and lamp."""

    #: The picture with its fitted camera and lamp.
    rendered: Predicted
    #: Predictor of the picture as the fitted camera sees it.
    predictor: Predictor
    #: Linear model of measured minus `base`.
    model: LinearModel
    #: The model's own effects.
    model_effects: tuple[AppliedEffect, ...]
    #: (band, y, x) signal predicted with the model's effects, DN; changes by further effects count from it.
    base: NDArray[np.float64]
    #: (10, band, y, x) derivatives of the signals by the camera's parameters.
    derivative: NDArray[np.float32]
    #: (n,) DN each, changes of the used samples by free factors and fall-off; None with an absolute scale and flats.
    free_changes: tuple[NDArray[np.float64], ...] | None = None

    @property
    def scale(self) -> float:
        """The fitted factor on the lamp's power."""
        return self.rendered.fit.lamp_scale

    def counting_errors(self, more: Sequence[NDArray[np.float64]]) -> LinearisedFit:
        """The same fit with rendering errors counted in the covariance.

        Parameters
        ----------
        more
            (n,) DN each at the used samples: one standard deviation of errors in addition to those of bands, faces and
            their parts.

        Returns
        -------
        LinearisedFit
            With vectors whitened by the errors.
        """
        model = self.model
        others = [*model.shared_errors[: model.count].T, *(error / model.sigma for error in more)]
        signal, coverage = self.scale * self.rendered.signal, self.rendered.image.coverage
        return replace(self, model=model.counting(picture_errors(signal, coverage, model.used, model.sigma, others)))

    def problem(self, selected: Sequence[Candidate]) -> Problem:
        """The problem of a further effect, with selected effects in place.

        Parameters
        ----------
        selected
            Candidates in the model, with their numbers.

        Returns
        -------
        Problem
            Its linear model projects out steps of the selected effects' numbers, too.
        """
        applied = [c.applied for c in selected]
        changes = []
        for index, candidate in enumerate(selected):
            rest = self._problem(self.model, [*applied[:index], *applied[index + 1 :]])
            change = rest.change(candidate.applied)
            changes += [rest.change(step.after.applied) - change for step in steps_of(candidate)]
        return self._problem(self.model.marginalised_over(changes), applied)

    def _problem(self, model: LinearModel, others: Sequence[AppliedEffect]) -> Problem:
        return build_problem(self.predictor, model, (*self.model_effects, *others), self.scale, self.rendered.variance)


def linearised_fit(
    prepared: CalibratedCapture,
    rendered: Rendered,
    model_effects: Sequence[AppliedEffect],
    added: Sequence[AppliedEffect] = (),
) -> LinearisedFit:
    """Linearise a rendered picture about its fitted camera and lamp.

    The variance is that of `prepared.noise_reference_signal`: a model without interreflection predicts too dark a
    picture, and too little noise.

    Parameters
    ----------
    prepared
        The calibrated capture.
    rendered
        The picture, with camera and lamp fitted to the photograph.
    model_effects
        Effects of the model, from which changes are counted.
    added
        Effects that the picture holds in addition.

    Returns
    -------
    LinearisedFit
        At the fitted lamp power.

    Raises
    ------
    InputError
        Without a compiled variant of the engine, which predicts effects.
    """
    if not isinstance(rendered, Predicted):
        raise variant.not_compiled("diagnosis")
    nuisances = rendered.fit
    predictor = rendered.predictor.with_camera(nuisances.camera)
    base = predictor.signal(model_effects)
    noise_signal = prepared.noise_reference_signal(nuisances.lamp_scale * rendered.signal)
    noise = nuisances.lamp_scale**2 * rendered.variance
    variance = prepared.calibration.predicted_variance(noise_signal) + noise + model_variance(noise_signal)
    variance += prepared.calibration.bands.shared_variance(noise_signal)
    lamp = Spectrum(WAVELENGTH_NM, prepared.scene.lamp_radiance(WAVELENGTH_NM))
    derivative = camera_jacobian(predictor.warp, nuisances.camera)
    model = build_linear_model(
        measured=prepared.measured,
        base=base,
        variance=variance,
        used=rendered.used,
        coverage=rendered.image.coverage,
        fit=nuisances,
        calibrated=prepared.expected_camera(model_effects),
        derivative=np.concatenate(
            [nuisances.lamp_scale * derivative, _by_lamp_scale(predictor, (*model_effects, *added))[None]]
        ),
        lamp_sigma=prepared.lamp_sigma,
        band_errors=BandErrors(
            tabulation_errors(prepared.responses, lamp, filter_steps_nm(prepared.calibration.capture)),
            prepared.calibration.noise.rounding_error_dn,
        ),
    )
    if (bands := prepared.calibration.bands).dark_sigma_dn.any():
        model = model.with_priors_of(
            [change[rendered.used] / model.sigma for change in bands.dark_changes],
            -bands.further_dark_dn / bands.dark_sigma_dn,
        )
    columns = free_columns(prepared.calibration, prepared.free_scale, nuisances.lamp_scale * rendered.signal)
    free = tuple(column[rendered.used] for column in columns)
    model = model.marginalised_over([model.whiten_used(change) for change in free])
    if prepared.calibration.capture.cell is not None:
        in_channel = (prepared.calibration.images.mask.values & Mask.OTHER_CHANNEL) == 0
        model = replace(model, seen_share=tuple(in_channel.mean(axis=(1, 2)).tolist()))
    single = derivative.astype(np.float32)
    free_changes = None if prepared.free_scale is None else free
    return LinearisedFit(rendered, predictor, model, tuple(model_effects), base, single, free_changes)


def _by_lamp_scale(predictor: Predictor, effects: Sequence[AppliedEffect]) -> NDArray[np.float64]:
    """(band, y, x) DN derivative by the lamp's scale, with which offsets of counts do not grow."""
    ahead = predictor.at_lamp((1 + _LAMP_STEP) * predictor.lamp_scale)
    return ((1 + _LAMP_STEP) * ahead.signal(effects) - predictor.signal(effects)) / _LAMP_STEP


def residual_with(linearised: LinearisedFit, selected: Sequence[Candidate]) -> NDArray[np.float64]:
    """Residual with selected effects in place.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Candidates with their numbers; none leaves the model's own residual.

    Returns
    -------
    NDArray
        (n + 11,) projected, over sigma.
    """
    if not selected:
        return linearised.model.residual
    added = [c.applied for c in selected]
    signal = linearised.predictor.signal((*linearised.model_effects, *added))
    model, camera = linearised.model, linearised.predictor.camera
    change = model.whiten(linearised.scale * (signal - linearised.base))
    return model.residual - change - model.camera_change(displacement(camera, linearised.model_effects, added))


def residual_with_rendered(linearised: LinearisedFit, selected: Sequence[Candidate]) -> NDArray[np.float64]:
    """Residual with those selected effects with which the picture is rendered again.

    Their shapes have no error, unlike those of predicted effects.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Candidates with their numbers; those that act after the render settings are left out.

    Returns
    -------
    NDArray
        (n + 11,) projected, over sigma.
    """
    return residual_with(linearised, [c for c in selected if c.hypothesis.effect.stage in _RENDERED])


def residual_with_exact(linearised: LinearisedFit, selected: Sequence[Candidate]) -> NDArray[np.float64]:
    """Residual with those selected effects whose shapes have no error.

    Effects of scene and settings are rendered; those of camera, filters, optics and counts are computed exactly.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        Candidates with their numbers; those of light transport are left out.

    Returns
    -------
    NDArray
        (n + 11,) projected, over sigma.
    """
    return residual_with(linearised, [c for c in selected if c.hypothesis.effect.stage not in _APPROXIMATE])


def refitted_together(linearised: LinearisedFit, selected: Sequence[Candidate]) -> list[Candidate]:
    """Candidates with all their numbers fitted together.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    selected
        One candidate or several.

    Returns
    -------
    list of Candidate
        Each one's `predicted` is what it changes that the others' numbers cannot imitate; `chi2` is that of all
        together.
    """
    problem = linearised.problem(())
    if len(selected) == 1:
        return [fit(problem, selected[0], linearised.model.residual)]

    def evaluate(candidates: Sequence[Candidate]) -> Fitted:
        averaged = problem.noise_averaging_gain(*(c.applied for c in candidates))
        return Fitted(tuple(candidates), residual_with(linearised, candidates), averaged)

    start = evaluate([with_all_numbers(c) for c in selected])
    best, derivatives = gauss_newton(evaluate, linearised.model, start)
    owner = np.repeat(np.arange(len(selected)), [len(c.numbers) if c.hypothesis.free else 0 for c in best.candidates])
    refitted = []
    for index, candidate in enumerate(best.candidates):
        others = [c for i, c in enumerate(best.candidates) if i != index]
        other_derivatives, change = derivatives[:, owner != index], residual_with(linearised, others) - best.residual
        unshared_change = change - other_derivatives @ np.linalg.lstsq(other_derivatives, change)[0]
        refitted.append(replace(candidate, chi2=best.chi2, predicted=unshared_change.astype(np.float32)))
    return refitted
