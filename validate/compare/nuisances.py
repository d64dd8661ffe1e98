"""The nuisance parameters of a comparison: lamp power and camera, fitted to the image with their priors."""

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

#: Steps of the search, first in smoothed pictures: where an edge along a row of pixels comes to the next row, the cost
#: has a kink, at which a search stops (0.06 px from the best camera were seen). Smoothed, the edge is in several rows.
#: With long steps only, it stops up to 0.04 px from the best camera if the model's edges are too sharp; with short
#: steps only, it is slow in weakly determined directions.
_SMOOTHED_STEPS_PX, _STEPS_PX = (0.3, 0.1), (0.1, 0.03)
_ROUNDS_EACH = 4

#: Weights of neighbouring rows and columns in smoothed pictures.
_SMOOTHING = np.array([1, 6, 15, 20, 15, 6, 1]) / 64

#: The search goes on with the shorter steps, at most so many times, until two after each other do not lower the cost by
#: more than this part: where edges lie along rows of pixels, as a floor's front edge may, it is slow.
_FURTHER_STEPS_PX, _MOST_FURTHER, _WORTH, _IDLE = (0.03, 0.01, 0.003), 6, 1e-3, 2

_SMALLEST_GAIN = 1.0

#: Threshold of the Huber loss in standard deviations, so that flaws of the model hardly affect the camera.
_HUBER = 3.0


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Values of all nuisances, or differences between such values.

    camera : (10,) in the order of ``Camera.parameters``. lamp_scale : factor on the lamp's stated power.
    The vector (count,) has the order of ``names``; ``of_camera`` and ``of_lamp`` are the indices in it.
    """

    camera: NDArray[np.float64]
    lamp_scale: float

    names: ClassVar[tuple[str, ...]] = (*PARAMETER_NAMES, "lamp_scale")
    count: ClassVar[int] = len(names)
    of_camera: ClassVar[slice] = slice(len(PARAMETER_NAMES))
    of_lamp: ClassVar[int] = len(PARAMETER_NAMES)

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> Nuisances:
        """From (count,) values."""
        return cls(vector[cls.of_camera], float(vector[cls.of_lamp]))

    @property
    def vector(self) -> NDArray[np.float64]:
        """(count,) values in the order of ``names``."""
        return np.append(self.camera, self.lamp_scale)


@dataclass(frozen=True, eq=False)
class NuisanceFit:
    """camera : refitted, without covariance. lamp_scale, lamp_scale_sigma : factor on the lamp's stated power."""

    camera: Camera
    lamp_scale: float
    lamp_scale_sigma: float

    def missed(self, calibrated: Camera) -> Nuisances:
        """The prior values (the surveyed camera and a lamp scale of 1) minus the fitted values."""
        return Nuisances(calibrated.parameters - self.camera.parameters, 1.0 - self.lamp_scale)


def camera_jacobian(warp: Warp, camera: Camera, step_px: float = _STEP_PX) -> NDArray[np.float64]:
    """Derivative (10, band, y, x) of the signals with respect to ``camera.parameters``.

    step_px : step of each parameter for the coverage of pixels, as the rms motion of the picture.
    """
    return warp_derivatives(warp, camera, step_px / pixels_per_unit(warp.tracer, camera))


def fit_lamp_scale(
    measured: NDArray, rendered: NDArray, variance: NDArray, used: NDArray, prior_sigma: float | None
) -> tuple[float, float]:
    """Factor on the lamp and its standard deviation; the prior is 1 +- prior_sigma (None: no prior)."""
    weight = (rendered / variance)[used]
    prior = 0.0 if prior_sigma is None else prior_sigma**-2
    information = float(weight @ rendered[used]) + prior
    return (float(weight @ measured[used]) + prior) / information, information**-0.5


def held_lamp_scale(scale: float, prior_sigma: float | None) -> float:
    """The scale, no further from 1 than twice its stated uncertainty (None: as it is)."""
    return scale if prior_sigma is None else float(np.clip(scale, 1 - 2 * prior_sigma, 1 + 2 * prior_sigma))


def fit_nuisances(
    measured: NDArray,
    variance: NDArray,
    used: NDArray,
    signal: NDArray,
    warp: Warp,
    calibrated: Camera,
    lamp_sigma: float | None,
) -> NuisanceFit:
    """Fit of the ten camera parameters and the lamp's scale by damped Gauss-Newton steps with a Huber loss.

    measured, variance, signal : (band, y, x) DN, DN^2, DN; signal as rendered through ``warp.camera``.
    used : (band, y, x) True for the pixels used. calibrated : the surveyed camera; its covariance is the prior of the
    ten parameters (without one they are not fitted). lamp_sigma : prior of the lamp's scale, None for none.
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
    whole = _smoothed(used.astype(float), _SMOOTHING) > 1 - 1e-9
    if whole.any():
        camera, scale, _ = _search(
            problem,
            camera,
            scale,
            lambda maps: _smoothed(np.where(used, maps, 0.0), _SMOOTHING)[whole],
            1 / _smoothed(np.where(used, variance, 0.0), _SMOOTHING**2)[whole],
            _SMOOTHED_STEPS_PX,
        )
    camera, scale, information = _search(problem, camera, scale, lambda maps: maps[used], 1 / variance[used], _STEPS_PX)
    # No covariance is stated: that from noise (below 0.001 px) is much smaller than the error by flaws of the picture.
    sigma = float(np.sqrt(np.linalg.inv(information)[of_lamp, of_lamp]))
    return NuisanceFit(replace(camera, covariance=None), scale, sigma)


@dataclass(frozen=True, eq=False)
class _Problem:
    """What a search compares, see ``fit_nuisances``. prior : (11, 11) information about the nuisances beforehand."""

    measured: NDArray
    signal: NDArray
    warp: Warp
    calibrated: Camera
    prior: NDArray[np.float64]


def _search(
    problem: _Problem,
    camera: Camera,
    scale: float,
    of: Callable[[NDArray], NDArray],
    inverse: NDArray,
    steps: Sequence[float],
) -> tuple[Camera, float, NDArray]:
    """Camera, scale and the information about both after ``steps`` and as many further ones as pay.

    of : picks the values to be compared out of maps (band, y, x). inverse : of their variance.
    """
    warp, calibrated, prior = problem.warp, problem.calibrated, problem.prior
    of_camera, of_lamp = Nuisances.of_camera, Nuisances.of_lamp
    pixels = pixels_per_unit(warp.tracer, warp.camera)
    target = of(problem.measured)

    def seen(there: Camera) -> NDArray:
        return of(problem.signal + warp_change(warp, there))

    def cost(there: Camera, factor: float, values: NDArray) -> float:
        deviation = Nuisances(calibrated.parameters - there.parameters, 1.0 - factor).vector
        z = np.abs(target - factor * values) * np.sqrt(inverse)
        robust = np.where(z < _HUBER, z**2, 2 * _HUBER * z - _HUBER**2)
        return float(robust.sum() + deviation @ prior @ deviation)

    current = seen(camera)
    design = np.zeros((Nuisances.count, len(target)))
    lowest = at_last = cost(camera, scale, current)
    idle = 0
    for index, search_step in enumerate((*steps, *_MOST_FURTHER * _FURTHER_STEPS_PX)):
        idle = 0 if at_last - lowest >= _WORTH * lowest else idle + 1
        if index >= len(steps) and idle >= _IDLE:
            break
        at_last = lowest
        for row, derivative in zip(design[of_camera], camera_jacobian(warp, camera, search_step), strict=True):
            row[:] = of(derivative)
        for _ in range(_ROUNDS_EACH):
            scaled = design * scale
            scaled[of_lamp] = current
            residual = target - scale * current
            weight = inverse * np.minimum(1.0, _HUBER / np.maximum(np.abs(residual) * np.sqrt(inverse), 1e-9))
            information = (scaled * weight) @ scaled.T + prior
            deviation = Nuisances(calibrated.parameters - camera.parameters, 1.0 - scale).vector
            step = Nuisances.from_vector(np.linalg.solve(information, (scaled * weight) @ residual + prior @ deviation))
            for damping in (1.0, 0.5, 0.25, 0.1):
                there = camera.with_parameters(camera.parameters + damping * step.camera)
                factor = scale + damping * step.lamp_scale
                values = seen(there)
                reached = cost(there, factor, values)
                if reached < lowest:
                    break
            else:
                break
            camera, scale, current, gain, lowest = there, factor, values, lowest - reached, reached
            if gain < _SMALLEST_GAIN or np.max(np.abs(step.camera) * pixels) < 1e-3:
                break
    return camera, scale, information


def _smoothed(maps: NDArray, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Maps (band, y, x) with each value replaced by a weighted sum of its neighbours along rows and columns."""
    return np.asarray(
        correlate1d(correlate1d(maps, weights, axis=-1, mode="constant"), weights, axis=-2, mode="constant")
    )
