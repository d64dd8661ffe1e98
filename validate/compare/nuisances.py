"""Nuisance parameters of a comparison: lamp power and camera, fitted with their priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from cboxlab.rendering.perturbation import Warp, pixels_per_unit, warp_change, warp_derivatives
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

__all__ = [
    "NuisanceFit",
    "Nuisances",
    "camera_jacobian",
    "fit_lamp_scale",
    "fit_nuisances",
    "held_lamp_scale",
]

#: Default step of the camera's derivatives, px of rms motion. Longer ones smooth edges (10% of the chi2 of a motion
#: remains unexplained).
_STEP_PX = 0.1

#: Steps of the search in smoothed pictures, px. Where an edge along a row of pixels reaches the next row, the cost has
#: a kink, at which a search stopped 0.06 px from the best camera. In a smoothed picture the edge is in several rows.
_SMOOTHED_STEPS_PX = (0.3, 0.1)

#: Steps of the search in the pictures, px. With long steps only, the search stops up to 0.04 px from the best camera if
#: the model's edges are too sharp. With short steps only, it is slow in weakly determined directions.
_STEPS_PX = (0.1, 0.03)

#: Gauss-Newton rounds for each step: the derivatives are computed once for a step.
_ROUNDS_PER_STEP = 4

#: Weights of neighbouring rows and columns in smoothed pictures.
_SMOOTHING = np.array([1, 6, 15, 20, 15, 6, 1]) / 64

#: Shorter steps with which the search continues, px: it is slow where edges lie along rows of pixels, as a floor's
#: front edge may.
_FURTHER_STEPS_PX = (0.03, 0.01, 0.003)

#: Most repetitions of the shorter steps.
_MAX_FURTHER_ROUNDS = 6

#: Relative decrease of the cost below which a step does not count as progress.
_MIN_RELATIVE_GAIN = 1e-3

#: Steps without progress after each other that end the search.
_PATIENCE = 2

#: Decrease of the cost (chi2) below which the rounds of a step end.
_MIN_GAIN = 1.0

#: Threshold of the Huber loss in standard deviations, so that flaws of the model hardly affect the camera.
_HUBER = 3.0


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Values of all nuisances, or differences between such values."""

    #: (10,) camera parameters in the order of ``Camera.parameters``.
    camera: NDArray[np.float64]
    #: Factor on the lamp's stated power.
    lamp_scale: float

    #: Names of the parameters in the order of the vector.
    names: ClassVar[tuple[str, ...]] = (*PARAMETER_NAMES, "lamp_scale")
    #: Number of parameters.
    count: ClassVar[int] = len(names)
    #: Indices of the camera in the vector.
    of_camera: ClassVar[slice] = slice(len(PARAMETER_NAMES))
    #: Index of the lamp's scale in the vector.
    of_lamp: ClassVar[int] = len(PARAMETER_NAMES)

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> Nuisances:
        """Nuisances from a vector.

        Parameters
        ----------
        vector
            (count,) values in the order of ``names``.

        Returns
        -------
        Nuisances
            The same values by name.
        """
        return cls(vector[cls.of_camera], float(vector[cls.of_lamp]))

    @property
    def vector(self) -> NDArray[np.float64]:
        """(count,) values in the order of ``names``."""
        return np.append(self.camera, self.lamp_scale)


@dataclass(frozen=True, eq=False)
class NuisanceFit:
    """Camera and lamp fitted to a picture."""

    #: Fitted camera, without covariance.
    camera: Camera
    #: Fitted factor on the lamp's stated power.
    lamp_scale: float
    #: Standard deviation of the factor.
    lamp_scale_sigma: float

    def missed(self, calibrated: Camera) -> Nuisances:
        """Prior values (the surveyed camera and a lamp scale of 1) minus the fitted values.

        Parameters
        ----------
        calibrated
            Surveyed camera.

        Returns
        -------
        Nuisances
            The differences.
        """
        return Nuisances(calibrated.parameters - self.camera.parameters, 1.0 - self.lamp_scale)


def camera_jacobian(warp: Warp, camera: Camera, step_px: float = _STEP_PX) -> NDArray[np.float64]:
    """Derivatives of the signals by the camera's parameters.

    Parameters
    ----------
    warp
        Warp of the picture.
    camera
        Camera at which the derivatives are taken.
    step_px
        Step of each parameter for the coverage of pixels, as the rms motion of the picture, px.

    Returns
    -------
    NDArray
        (10, band, y, x) DN per unit of each parameter.
    """
    return warp_derivatives(warp, camera, step_px / pixels_per_unit(warp.tracer, camera))


def fit_lamp_scale(
    measured: NDArray, rendered: NDArray, variance: NDArray, used: NDArray, prior_sigma: float | None
) -> tuple[float, float]:
    """Weighted linear fit of the factor on the lamp's power.

    Parameters
    ----------
    measured
        (band, y, x) measured signal, DN.
    rendered
        (band, y, x) rendered signal at the lamp's stated power, DN.
    variance
        (band, y, x) variance of measured minus rendered, DN^2.
    used
        (band, y, x) True for the samples used.
    prior_sigma
        Standard deviation of the prior, whose mean is 1; None for no prior.

    Returns
    -------
    float
        The factor.
    float
        Its standard deviation.
    """
    weight = (rendered / variance)[used]
    prior = 0.0 if prior_sigma is None else prior_sigma**-2
    information = float(weight @ rendered[used]) + prior
    return (float(weight @ measured[used]) + prior) / information, information**-0.5


def held_lamp_scale(scale: float, prior_sigma: float | None) -> float:
    """Lamp scale limited to 1 plus or minus twice its stated uncertainty.

    Parameters
    ----------
    scale
        Fitted factor on the lamp's power.
    prior_sigma
        Its stated relative uncertainty; None for no limit.

    Returns
    -------
    float
        The limited factor.
    """
    return scale if prior_sigma is None else float(np.clip(scale, 1 - 2 * prior_sigma, 1 + 2 * prior_sigma))


def fit_nuisances(
    measured: NDArray,
    variance: NDArray,
    used: NDArray,
    signal: NDArray,
    warp: Warp,
    calibrated: Camera,
    lamp_sigma: float | None,
    *,
    settled: bool = False,
    draft: bool = False,
) -> NuisanceFit:
    """Fit the ten camera parameters and the lamp's scale.

    Damped Gauss-Newton steps minimise a Huber loss plus the priors, first in smoothed pictures. Their minimum is
    about 0.02 px from that of the pictures. A camera that a draft has settled is nearer, and starts without them. The
    search in a draft ends after the first step in the pictures: that of the next picture continues it.

    Parameters
    ----------
    measured
        (band, y, x) measured signal, DN.
    variance
        (band, y, x) variance of measured minus rendered, DN^2.
    used
        (band, y, x) True for the samples used.
    signal
        (band, y, x) signal rendered through ``warp.camera``, DN.
    warp
        Warp of the picture.
    calibrated
        Surveyed camera; its covariance is the prior. Without a covariance the camera is not fitted.
    lamp_sigma
        Prior of the lamp's scale; None for no prior.
    settled
        Whether ``warp.camera`` was fitted to another rendering with the same effects, and hardly moved.
    draft
        Whether the fit only gives the camera of the next rendering.

    Returns
    -------
    NuisanceFit
        Fitted camera and lamp.
    """
    camera = warp.camera
    if calibrated.covariance is None:
        scale, sigma = fit_lamp_scale(measured, signal, variance, used, lamp_sigma)
        return NuisanceFit(camera, scale, sigma)
    of_camera, of_lamp = Nuisances.of_camera, Nuisances.of_lamp
    prior = np.zeros((Nuisances.count, Nuisances.count))
    prior[of_camera, of_camera] = np.linalg.inv(calibrated.covariance)
    prior[of_lamp, of_lamp] = 0.0 if lamp_sigma is None else lamp_sigma**-2
    problem = _Problem(measured, signal, warp, calibrated, prior)
    camera, scale = warp.camera, fit_lamp_scale(measured, signal, variance, used, lamp_sigma)[0]
    if not settled and (complete := _smoothed(used.astype(float), _SMOOTHING) > 1 - 1e-9).any():  # with all neighbours
        camera, scale, _ = _search(
            problem,
            camera,
            scale,
            lambda maps: _smoothed(np.where(used, maps, 0.0), _SMOOTHING)[complete],
            1 / _smoothed(np.where(used, variance, 0.0), _SMOOTHING**2)[complete],
            _SMOOTHED_STEPS_PX,
            (),
        )
    steps, further = (_STEPS_PX[:1], ()) if draft else (_STEPS_PX, _FURTHER_STEPS_PX)
    camera, scale, information = _search(
        problem, camera, scale, lambda maps: maps[used], 1 / variance[used], steps, further
    )
    # No covariance is stated: that from noise (below 0.001 px) is much smaller than the error by flaws of the picture.
    sigma = float(np.sqrt(np.linalg.inv(information)[of_lamp, of_lamp]))
    return NuisanceFit(replace(camera, covariance=None), scale, sigma)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Data of a search, see ``fit_nuisances``."""

    #: (band, y, x) measured signal, DN.
    measured: NDArray
    #: (band, y, x) rendered signal, DN.
    signal: NDArray
    #: Warp of the picture.
    warp: Warp
    #: Surveyed camera.
    calibrated: Camera
    #: (11, 11) information of the priors: inverse of their covariance.
    prior: NDArray[np.float64]


def _search(
    problem: _Problem,
    camera: Camera,
    scale: float,
    of: Callable[[NDArray], NDArray],
    inverse: NDArray,
    steps: Sequence[float],
    further: Sequence[float],
) -> tuple[Camera, float, NDArray]:
    """Search of camera and lamp scale: ``steps``, then ``further`` ones while the cost falls.

    ``of`` selects the values to compare from maps (band, y, x); ``inverse`` is the inverse of their variance. Returns
    camera, scale and the (11, 11) information about both.
    """
    warp, calibrated, prior = problem.warp, problem.calibrated, problem.prior
    of_camera, of_lamp = Nuisances.of_camera, Nuisances.of_lamp
    pixels = pixels_per_unit(warp.tracer, warp.camera)
    target = of(problem.measured)

    def warped(moved: Camera) -> NDArray:
        return of(problem.signal + warp_change(warp, moved))

    def cost(moved: Camera, factor: float, values: NDArray) -> float:
        deviation = Nuisances(calibrated.parameters - moved.parameters, 1.0 - factor).vector
        z = np.abs(target - factor * values) * np.sqrt(inverse)
        robust = np.where(z < _HUBER, z**2, 2 * _HUBER * z - _HUBER**2)
        return float(robust.sum() + deviation @ prior @ deviation)

    current = warped(camera)
    design = np.zeros((Nuisances.count, len(target)))
    lowest = at_last = cost(camera, scale, current)
    idle = 0
    for index, search_step in enumerate((*steps, *_MAX_FURTHER_ROUNDS * tuple(further))):
        idle = 0 if at_last - lowest >= _MIN_RELATIVE_GAIN * lowest else idle + 1
        if index >= len(steps) and idle >= _PATIENCE:
            break
        at_last = lowest
        for row, derivative in zip(design[of_camera], camera_jacobian(warp, camera, search_step), strict=True):
            row[:] = of(derivative)
        for _ in range(_ROUNDS_PER_STEP):
            scaled = design * scale
            scaled[of_lamp] = current
            residual = target - scale * current
            weight = inverse * np.minimum(1.0, _HUBER / np.maximum(np.abs(residual) * np.sqrt(inverse), 1e-9))
            information = (scaled * weight) @ scaled.T + prior
            deviation = Nuisances(calibrated.parameters - camera.parameters, 1.0 - scale).vector
            step = Nuisances.from_vector(np.linalg.solve(information, (scaled * weight) @ residual + prior @ deviation))
            for damping in (1.0, 0.5, 0.25, 0.1):
                moved = camera.with_parameters(camera.parameters + damping * step.camera)
                factor = scale + damping * step.lamp_scale
                values = warped(moved)
                reached = cost(moved, factor, values)
                if reached < lowest:
                    break
            else:
                break
            camera, scale, current, gain, lowest = moved, factor, values, lowest - reached, reached
            if gain < _MIN_GAIN or np.max(np.abs(step.camera) * pixels) < 1e-3:
                break
    return camera, scale, information


def _smoothed(maps: NDArray, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Maps (band, y, x) smoothed along rows and columns with weights of neighbours."""
    return np.asarray(
        correlate1d(correlate1d(maps, weights, axis=-1, mode="constant"), weights, axis=-2, mode="constant")
    )
