"""Choice of the distortion model by cross-validation over surveyed points.

More terms always fit the same points better; whether they describe the lens is tested on held-out points. The
models are OpenCV's: radial terms k1, k2, k3 and the decentring terms p1, p2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from cboxlab.utils.frozen import OwnMappings
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

# Ten parameters are fitted to nine tenths of the points.
_FEWEST_POINTS = 12
_FOLDS = 10
# A more complex model must predict better by this many standard errors of the paired difference.
_CLEARLY = 2.0


@dataclass(frozen=True, eq=False)
class DistortionChoice(OwnMappings):
    """held_out_rms_px : by model, of held-out points, per coordinate.

    chosen : the simplest model that no more complex one significantly improves on. note : one sentence if it has
    more terms than k1, the model of ``Camera``; else None.
    """

    held_out_rms_px: Mapping[str, float]
    chosen: str
    note: str | None


def _fit(
    fit: CameraFit, world: NDArray[np.float64], image: NDArray[np.float64], flags: int
) -> tuple[NDArray, NDArray, NDArray, NDArray] | None:
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
    """Ten-fold cross-validation over the points that the fit kept; None for fewer than twelve.

    Two models are compared by the mean paired difference of their squared errors on the same held-out points.
    """
    world, image = points.points_mm[fit.kept], points.image_px[fit.kept]
    count = len(world)
    if count < _FEWEST_POINTS:
        return None
    order = np.random.default_rng(seed).permutation(count)
    squares: dict[str, NDArray[np.float64]] = {}
    for name, flags in MODELS.items():
        errors = np.full(count, np.nan)
        for held in np.array_split(order, _FOLDS):
            rest = np.setdiff1d(order, held)
            found = _fit(fit, world[rest], image[rest], flags)
            if found is None:
                continue
            matrix, distortion, turn, shift = found
            shown, _ = cv2.projectPoints(world[held], turn, shift, matrix, distortion)
            errors[held] = np.sum((shown.reshape(-1, 2) - image[held]) ** 2, axis=1)
        if np.all(np.isfinite(errors)):
            squares[name] = errors
    if not squares:
        return None
    rms = {name: float(np.sqrt(errors.mean() / 2)) for name, errors in squares.items()}
    names = list(squares)
    chosen = names[0]
    for name in names[1:]:
        gain = squares[chosen] - squares[name]
        if gain.mean() > _CLEARLY * gain.std(ddof=1) / np.sqrt(count):
            chosen = name
    note = None
    if chosen not in ("none", "k1") and "k1" in rms:
        note = (
            f"distortion model '{chosen}' predicts held-out points better ({rms[chosen]:.3f} px) "
            f"than the model in use, k1 ({rms['k1']:.3f} px)"
        )
    return DistortionChoice(rms, chosen, note)
