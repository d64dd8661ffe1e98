"""The nuisances of every comparison: lamp power and camera, fitted to the image within what is known of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.render.warp import Warp, pixels_per_unit, warp_change
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

__all__ = ["NuisanceFit", "camera_jacobian", "fit_lamp_scale", "fit_nuisances"]

#: Step of the camera's derivatives, in px of mean motion, where noise and what nuisances can imitate are told apart:
#: shorter ones are lost in the sampling of edges, longer ones smear them (a tenth of a motion's chi2 is left over).
_STEP_PX = 0.1

#: Steps that the search goes through. With long ones alone it stops where a model whose edges are too sharp leaves
#: large residuals there, up to 0.04 px from the best camera; short ones alone are slow in weakly determined directions.
_SEARCH_STEPS_PX = (0.3, 0.1, 0.03)
_ROUNDS_EACH = 4

_SMALLEST_GAIN = 1.0

#: Residuals beyond so many standard deviations pull no harder: what the model lacks shall not move the camera.
_HUBER = 3.0


@dataclass(frozen=True, eq=False)
class NuisanceFit:
    """camera : refitted, without a covariance. lamp_scale : on the lamp's stated power."""

    camera: Camera
    lamp_scale: float
    lamp_scale_sigma: float


def camera_jacobian(warp: Warp, camera: Camera, step_px: float = _STEP_PX) -> NDArray[np.float64]:
    """Derivative (10, band, y, x) of the signals with respect to ``camera.parameters``, by central differences.

    step_px : how far each parameter moves the picture in the mean.
    """
    steps = step_px / pixels_per_unit(warp.tracer, camera)
    result = []
    for axis, step in zip(np.eye(10), steps, strict=True):
        ahead, behind = (camera.with_parameters(camera.parameters + sign * step * axis) for sign in (1, -1))
        result.append((warp_change(warp, ahead) - warp_change(warp, behind)) / (2 * step))
    return np.array(result)


def fit_lamp_scale(
    measured: NDArray, rendered: NDArray, variance: NDArray, used: NDArray, prior_sigma: float | None
) -> tuple[float, float]:
    """Factor on the lamp and its standard deviation; the prior is 1 +- prior_sigma (None: no prior)."""
    weight = (rendered / variance)[used]
    prior = 0.0 if prior_sigma is None else prior_sigma**-2
    information = float(weight @ rendered[used]) + prior
    return (float(weight @ measured[used]) + prior) / information, information**-0.5


def fit_nuisances(
    measured: NDArray,
    variance: NDArray,
    used: NDArray,
    signal: NDArray,
    warp: Warp,
    calibrated: Camera,
    lamp_sigma: float | None,
) -> NuisanceFit:
    """Damped Gauss-Newton on the ten camera parameters and the lamp's scale, robust against what the model lacks.

    measured, variance, signal : (band, y, x), signal as rendered through ``warp.camera``. used : mask.
    calibrated : the survey's camera; its covariance is the prior of the ten parameters (none: they stay).
    """
    camera = warp.camera
    if calibrated.covariance is None:
        scale, sigma = fit_lamp_scale(measured, signal, variance, used, lamp_sigma)
        return NuisanceFit(camera, scale, sigma)
    prior = np.zeros((11, 11))
    prior[:10, :10] = np.linalg.inv(calibrated.covariance)
    prior[10, 10] = 0.0 if lamp_sigma is None else lamp_sigma**-2
    target, inverse = measured[used], 1 / variance[used]
    scale, current = fit_lamp_scale(measured, signal, variance, used, lamp_sigma)[0], signal[used]
    pixels = pixels_per_unit(warp.tracer, camera)

    def cost(there: Camera, factor: float, values: NDArray) -> float:
        deviation = np.append(calibrated.parameters - there.parameters, 1.0 - factor)
        z = np.abs(target - factor * values) * np.sqrt(inverse)
        robust = np.where(z < _HUBER, z**2, 2 * _HUBER * z - _HUBER**2)
        return float(robust.sum() + deviation @ prior @ deviation)

    design = np.empty((11, len(target)))
    lowest = cost(camera, scale, current)
    for search_step in _SEARCH_STEPS_PX:
        design[:10] = camera_jacobian(warp, camera, search_step)[:, used]
        for _ in range(_ROUNDS_EACH):
            scaled = design * scale
            scaled[10] = current
            residual = target - scale * current
            weight = inverse * np.minimum(1.0, _HUBER / np.maximum(np.abs(residual) * np.sqrt(inverse), 1e-9))
            information = (scaled * weight) @ scaled.T + prior
            deviation = np.append(calibrated.parameters - camera.parameters, 1.0 - scale)
            step = np.linalg.solve(information, (scaled * weight) @ residual + prior @ deviation)
            for damping in (1.0, 0.5, 0.25, 0.1):
                there = camera.with_parameters(camera.parameters + damping * step[:10])
                factor = scale + damping * float(step[10])
                values = (signal + warp_change(warp, there))[used]
                reached = cost(there, factor, values)
                if reached < lowest:
                    break
            else:
                break
            camera, scale, current, gain, lowest = there, factor, values, lowest - reached, reached
            if gain < _SMALLEST_GAIN or np.max(np.abs(step[:10]) * pixels) < 1e-3:
                break
    # noise alone would leave the camera good to less than a thousandth of a pixel; what it is really good to
    # is set by the picture's own flaws, so no covariance is stated
    return NuisanceFit(
        replace(camera, covariance=None), scale, float(np.sqrt(np.linalg.inv(information)[10, 10]))
    )
