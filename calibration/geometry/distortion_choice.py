"""Choice of the distortion model by cross-validation over surveyed points.

More terms always fit the same points better; held-out points test whether they describe the lens. The models are
OpenCV's: radial terms k1, k2, k3 and the decentring terms p1, p2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from .camera_fit import CameraFit
from .surveyed_points import SurveyedPoints

__all__ = ["MODELS", "DistortionChoice", "choose_distortion"]

_NONE = cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST

#: OpenCV's flags (terms held at zero) by name, the simplest first; "k1" is the model of ``Camera``.
MODELS = {
    "none": _NONE,
    "k1": _NONE & ~cv2.CALIB_FIX_K1,
    "k1 k2": _NONE & ~cv2.CALIB_FIX_K1 & ~cv2.CALIB_FIX_K2,
    "k1 p1 p2": _NONE & ~cv2.CALIB_FIX_K1 & ~cv2.CALIB_ZERO_TANGENT_DIST,
    "k1 k2 k3": _NONE & ~cv2.CALIB_FIX_K1 & ~cv2.CALIB_FIX_K2 & ~cv2.CALIB_FIX_K3,
}

#: Fewest points for a choice: ten parameters are fitted to nine tenths of them.
_FEWEST_POINTS = 12
#: Number of parts of the points; each is held out once.
_FOLDS = 10
#: Standard errors of the paired difference by which a more complex model must predict better.
_CLEAR_ERRORS = 2.0


@dataclass(frozen=True, eq=False)
class DistortionChoice(FrozenMappings):
    """Distortion model selected by its prediction of held-out points."""

    #: By model, root mean square error of held-out points, per coordinate, px.
    held_out_rms_px: Mapping[str, float]
    #: Simplest model that no more complex one significantly improves on.
    model: str
    #: One sentence if the model has more terms than k1, the model of ``Camera``; otherwise None.
    note: str | None


def _fit(
    fit: CameraFit, world: NDArray[np.float64], image: NDArray[np.float64], flags: int
) -> tuple[NDArray, NDArray, NDArray, NDArray] | None:
    """Camera matrix, distortion, rotation vector and translation by OpenCV; None where it fails."""
    camera = fit.camera
    u, v = camera.principal_point_px
    matrix = np.array([[camera.focal_length_px, 0, u], [0, camera.focal_length_px, v], [0, 0, 1]])
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            [world.astype(np.float32)],
            [image.astype(np.float32)],
            (camera.width_px, camera.height_px),
            matrix,
            np.zeros(5),
            flags=flags,
        )
    except cv2.error:
        return None
    return matrix, distortion, turns[0], shifts[0]


def choose_distortion(points: SurveyedPoints, fit: CameraFit, seed: int = 0) -> DistortionChoice | None:
    """Distortion model by ten-fold cross-validation over the points used in the fit.

    Two models are compared by the mean paired difference of their squared errors on the same held-out points. A more
    complex model must be better by two standard errors of that difference.

    Parameters
    ----------
    points
        Surveyed points.
    fit
        Camera fitted to them: the initial value of every model, and the selection of points.
    seed
        Seed of the random partition of the points.

    Returns
    -------
    DistortionChoice | None
        Selected model; None for fewer than twelve points or if no model can be fitted.
    """
    world, image = points.points_mm[fit.in_use], points.image_px[fit.in_use]
    count = len(world)
    if count < _FEWEST_POINTS:
        return None
    order = np.random.default_rng(seed).permutation(count)
    squares: dict[str, NDArray[np.float64]] = {}
    for name, flags in MODELS.items():
        errors = np.full(count, np.nan)
        for held_out in np.array_split(order, _FOLDS):
            rest = np.setdiff1d(order, held_out)
            fitted = _fit(fit, world[rest], image[rest], flags)
            if fitted is None:
                continue
            matrix, distortion, turn, shift = fitted
            projected, _ = cv2.projectPoints(world[held_out], turn, shift, matrix, distortion)
            errors[held_out] = np.sum((projected.reshape(-1, 2) - image[held_out]) ** 2, axis=1)
        if np.all(np.isfinite(errors)):
            squares[name] = errors
    if not squares:
        return None
    rms = {name: float(np.sqrt(errors.mean() / 2)) for name, errors in squares.items()}
    names = list(squares)
    model = names[0]
    for name in names[1:]:
        gain = squares[model] - squares[name]
        if gain.mean() > _CLEAR_ERRORS * gain.std(ddof=1) / np.sqrt(count):
            model = name
    note = None
    if model not in ("none", "k1") and "k1" in rms:
        note = (
            f"distortion model '{model}' predicts held-out points better ({rms[model]:.3f} px) "
            f"than the model in use, k1 ({rms['k1']:.3f} px)"
        )
    return DistortionChoice(rms, model, note)
