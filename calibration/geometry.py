"""Camera geometry from one view of surveyed, non-coplanar points (Tsai 1987), with its covariance.

Ten parameters are fitted: pose, focal length, principal point and one radial term; pixels are square.
The nominal focal length only starts the search. It is no prior: the image decides, and the fit
reports how far the two differ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from cboxlab.scenes.errors import InputError
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares

from .camera_jacobian import inverse_information, parameter_jacobian
from .surveyed_points import FEWEST_POINTS, SURVEY_HINT, SurveyedPoints, read_points, require_determined

__all__ = ["FALSE_ALARM", "CameraFit", "SurveyedPoints", "fit_camera", "read_points"]

#: Probability that a survey without mistakes loses a point as a supposed mistake.
FALSE_ALARM = 1e-3

#: Largest relative standard deviation of focal length or distance at which a linear covariance says anything.
LARGEST_UNCERTAINTY = 0.2


@dataclass(frozen=True, eq=False)
class CameraFit:
    """What ``fit_camera`` found.

    camera : with its (10, 10) covariance in the order of PARAMETER_NAMES.
    residuals_px : (n, 2) measured minus projected, of all points. kept : (n,) the points that were used.
    outliers : ids of the others, taken for mistakes.
    reprojection_rms_px : sqrt(mean(du^2, dv^2)) over the kept points, per coordinate.
    point_sigma_px : of the measured coordinates, as stated, or estimated where nothing was stated.
    chi2, p_value : of the kept points against the stated sigma; None where the sigma was estimated.
        They test the survey: a tiny p_value says that the stated sigma, or the camera model, is wrong.
    degrees_of_freedom : 2 n_kept - 10.
    nominal_focal_length_px : as given, for comparison with ``camera.focal_length_px``.
    """

    camera: Camera
    residuals_px: NDArray[np.float64]
    kept: NDArray[np.bool_]
    outliers: tuple[str, ...]
    reprojection_rms_px: float
    point_sigma_px: float
    sigma_estimated: bool
    chi2: float | None
    p_value: float | None
    degrees_of_freedom: int
    nominal_focal_length_px: float | None


def fit_camera(
    points: SurveyedPoints,
    *,
    width_px: int,
    height_px: int,
    point_sigma_px: float | None = None,
    focal_length_px: float | None = None,
) -> CameraFit:
    """The camera that sees the surveyed points where the image shows them.

    point_sigma_px : standard deviation of each measured image coordinate; None: estimated from the residuals.
    focal_length_px : nominal, to start from; a range of lenses is tried if None.

    Pose from OpenCV (perspective-n-point with consensus), intrinsics from ``cv2.calibrateCamera``, then
    least squares on ``Camera.project``. Points whose deleted residual exceeds what noise does once in
    1 / FALSE_ALARM surveys are mistakes: they are left out and named. The stated sigma is not believed
    against the majority of the points: where all scatter more, none is singled out and p_value says so. Of a
    dozen points or fewer a mistake can hide in the fit itself: then too p_value is all that tells.
    The covariance is sigma^2 (J^T J)^-1 at the solution.

    Raises InputError where the points cannot determine the ten parameters: fewer than six, in one
    plane, all in a small part of the image, in a critical arrangement, or in disagreement.
    """
    if point_sigma_px is not None and not point_sigma_px > 0:
        raise InputError("geometry.point_sigma_px", f"{point_sigma_px:g}", "a number above 0")
    require_determined(points, np.ones(len(points.ids), bool), width_px, height_px)
    start = _starting_camera(points, width_px, height_px, focal_length_px, point_sigma_px)
    camera, kept, scale = _robust_fit(start, points, point_sigma_px)
    for attempt in range(2 * len(points.ids)):
        require_determined(points, kept, width_px, height_px)
        camera = _least_squares(camera, points, kept)
        accepted = _consistent(camera, points, kept, scale, estimated=point_sigma_px is None)
        if np.array_equal(accepted, kept):
            break
        # After some rounds points may only go, so that the loop comes to an end.
        kept = accepted if attempt < 10 else accepted & kept
    residuals = points.image_px - camera.project(points.points_mm)
    sum_of_squares = float(np.sum(residuals[kept] ** 2))
    freedom = 2 * int(kept.sum()) - len(PARAMETER_NAMES)
    sigma = point_sigma_px or float(np.sqrt(sum_of_squares / freedom))
    camera = replace(camera, covariance=_covariance(camera, points, kept, sigma))
    chi2 = sum_of_squares / point_sigma_px**2 if point_sigma_px else None
    return CameraFit(
        camera=camera,
        residuals_px=residuals,
        kept=kept,
        outliers=tuple(name for name, use in zip(points.ids, kept, strict=True) if not use),
        reprojection_rms_px=float(np.sqrt(np.mean(residuals[kept] ** 2))),
        point_sigma_px=sigma,
        sigma_estimated=point_sigma_px is None,
        chi2=chi2,
        p_value=None if chi2 is None else float(stats.chi2.sf(chi2, freedom)),
        degrees_of_freedom=freedom,
        nominal_focal_length_px=focal_length_px,
    )


def camera_from_opencv(
    width_px: int, height_px: int, matrix: NDArray, k1: float, turn: NDArray, shift: NDArray
) -> Camera:
    rotation = np.asarray(cv2.Rodrigues(turn)[0], float)
    return Camera(
        width_px,
        height_px,
        float(matrix[0, 0]),
        matrix[:2, 2].copy(),
        float(k1),
        rotation,
        -rotation.T @ shift.ravel(),
    )


def _starting_camera(
    points: SurveyedPoints, width_px: int, height_px: int, focal_length_px: float | None, sigma: float | None
) -> Camera:
    """Pose by consensus at the first of several focal lengths that suits, else at the one that suits best."""
    diagonal = float(np.hypot(width_px, height_px))
    middle = focal_length_px or diagonal
    # Wide enough for a nominal focal length that is some percent off and for several percent of distortion.
    tolerance = max(10 * (sigma or 0.0), 0.02 * diagonal)
    best: tuple[float, Camera, NDArray] | None = None
    for focal in middle * np.array([1.0, 0.8, 1.25, 0.5, 2.0, 0.25, 4.0]):
        matrix = np.array([[focal, 0, (width_px - 1) / 2], [0, focal, (height_px - 1) / 2], [0, 0, 1.0]])
        try:
            found, turn, shift, inliers = cv2.solvePnPRansac(
                points.points_mm,
                points.image_px,
                matrix,
                None,
                iterationsCount=500,
                reprojectionError=tolerance,
                confidence=0.9999,
                flags=cv2.SOLVEPNP_SQPNP,
            )
        except cv2.error:
            continue
        if not found or inliers is None or len(inliers) < FEWEST_POINTS:
            continue
        camera = camera_from_opencv(width_px, height_px, matrix, 0.0, turn, shift)
        errors = np.linalg.norm(points.image_px - camera.project(points.points_mm), axis=1)
        median = float(np.median(np.nan_to_num(errors, nan=diagonal)))
        if best is None or median < best[0]:
            best = median, camera, inliers.ravel()
        if median < tolerance / 2:
            break
    if best is None:
        raise InputError(
            points.source,
            "no pose that agrees with most of the points",
            "points seen by one camera",
            "Are u and v, or the axes of the box, exchanged?",
        )
    return _opencv_calibration(best[1], points, best[2])


def _opencv_calibration(camera: Camera, points: SurveyedPoints, chosen: NDArray[np.int_]) -> Camera:
    """All ten parameters by OpenCV on the chosen points; the given camera where OpenCV cannot improve it."""
    matrix = np.array(
        [
            [camera.focal_length_px, 0, camera.principal_point_px[0]],
            [0, camera.focal_length_px, camera.principal_point_px[1]],
            [0, 0, 1],
        ]
    )
    flags = (
        cv2.CALIB_USE_INTRINSIC_GUESS
        | cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST
        | cv2.CALIB_FIX_K2
        | cv2.CALIB_FIX_K3
    )
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            [points.points_mm[chosen].astype(np.float32)],
            [points.image_px[chosen].astype(np.float32)],
            (camera.width_px, camera.height_px),
            matrix,
            np.zeros(5),
            flags=flags,
        )
    except cv2.error:
        return camera
    refined = camera_from_opencv(
        camera.width_px, camera.height_px, matrix, distortion.ravel()[0], turns[0], shifts[0]
    )
    errors = [c.project(points.points_mm[chosen]) - points.image_px[chosen] for c in (camera, refined)]
    return refined if np.sum(errors[1] ** 2) < np.sum(errors[0] ** 2) else camera


def _robust_fit(
    start: Camera, points: SurveyedPoints, sigma: float | None
) -> tuple[Camera, NDArray[np.bool_], float]:
    """A fit that a few mistakes hardly move, the points it agrees with, and the scatter of the majority.

    The loss grows like the logarithm, so that a mistake's pull vanishes with its size; its scale comes
    down from the scatter of the start to that of the solution.
    """
    camera, count = start, len(points.ids)
    # Residuals of n points on 10 fitted parameters are smaller than the noise by this factor.
    shrinkage = np.sqrt(2 * count / (2 * count - len(PARAMETER_NAMES)))
    scale = np.inf
    for loss in ("soft_l1", "cauchy", "cauchy", "cauchy"):
        errors = np.linalg.norm(points.image_px - camera.project(points.points_mm), axis=1)
        # The length of a 2-D Gaussian error has the median sigma sqrt(2 ln 2).
        scale = shrinkage * float(np.median(np.nan_to_num(errors, nan=1e6))) / np.sqrt(2 * np.log(2))
        # Points without any noise would ask for a scale of zero.
        camera = _least_squares(
            camera, points, np.ones(count, bool), loss, 2 * max(scale, sigma or 0.0, 1e-6)
        )
    errors = np.linalg.norm(points.image_px - camera.project(points.points_mm), axis=1)
    scale = shrinkage * float(np.median(errors)) / np.sqrt(2 * np.log(2))
    scale = max(scale, sigma or 0.0, 1e-6)
    kept = errors < scale * np.sqrt(stats.chi2.isf(FALSE_ALARM / count, 2))
    return camera, kept, scale


def _least_squares(
    camera: Camera, points: SurveyedPoints, kept: NDArray[np.bool_], loss: str = "linear", scale: float = 1.0
) -> Camera:
    world, image = points.points_mm[kept], points.image_px[kept]

    def residuals(values: NDArray[np.float64]) -> NDArray[np.float64]:
        # A camera that has a point behind it is as wrong as a camera can be: the step is refused.
        return np.nan_to_num((camera.with_parameters(values).project(world) - image).ravel(), nan=1e6)

    def jacobian(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return parameter_jacobian(camera, world, values)

    solution = least_squares(
        residuals,
        camera.parameters,
        jac=jacobian,
        x_scale="jac",
        loss=loss,
        f_scale=scale,
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
        max_nfev=200,
    )
    return camera.with_parameters(solution.x)


def _consistent(
    camera: Camera, points: SurveyedPoints, kept: NDArray[np.bool_], scale: float, *, estimated: bool
) -> NDArray[np.bool_]:
    """(n,) which points agree with the camera that the other kept points alone would give.

    The deleted residual of point i has the squared Mahalanobis length r^T (I - H_i)^-1 r / sigma^2 when i
    was in the fit, and r^T (I + H_i)^-1 r / sigma^2 when it was not, H_i = J_i (J^T J)^-1 J_i^T; it follows
    chi2(2), or 2 F(2, m) with sigma^2 from the m degrees of freedom that remain (Cook & Weisberg 1982).
    """
    residuals = points.image_px - camera.project(points.points_mm)
    jacobian = parameter_jacobian(camera, points.points_mm).reshape(-1, 2, len(PARAMETER_NAMES))
    fitted = jacobian[kept].reshape(-1, len(PARAMETER_NAMES))
    inverse = inverse_information(fitted, points.source, SURVEY_HINT)
    influence = jacobian @ inverse @ jacobian.transpose(0, 2, 1)
    spread = np.eye(2) + np.where(kept, -1.0, 1.0)[:, None, None] * influence
    # A point that alone determines some parameter cannot be checked: it stays.
    checkable = np.linalg.eigvalsh(spread)[:, 0] > 1e-6
    squares = np.zeros(len(kept))
    squares[checkable] = np.einsum(
        "ni,nij,nj->n", residuals[checkable], np.linalg.inv(spread[checkable]), residuals[checkable]
    )
    level = FALSE_ALARM / len(kept)
    if not estimated:
        return ~(squares / scale**2 > stats.chi2.isf(level, 2))
    rest = np.sum(residuals[kept] ** 2) - np.where(kept, squares, 0.0)
    freedom = 2 * (int(kept.sum()) - kept) - len(PARAMETER_NAMES)
    # With six points and no stated sigma there is nothing to compare a residual with.
    testable = freedom > 0
    ratio = squares[testable] / 2 / np.maximum(rest[testable] / freedom[testable], 1e-16)
    accepted = np.ones(len(kept), bool)
    accepted[testable] = ~(ratio > stats.f.isf(level, 2, freedom[testable]))
    return accepted


def _covariance(
    camera: Camera, points: SurveyedPoints, kept: NDArray[np.bool_], sigma: float
) -> NDArray[np.float64]:
    covariance = sigma**2 * inverse_information(
        parameter_jacobian(camera, points.points_mm[kept]), points.source, SURVEY_HINT
    )
    distance = float(np.median(np.linalg.norm(points.points_mm[kept] - camera.position_mm, axis=1)))
    deviations = np.sqrt(np.diag(covariance))
    share = {
        "focal length": deviations[6] / camera.focal_length_px,
        "distance": max(deviations[:3]) / distance,
    }
    for name, value in share.items():
        if value > LARGEST_UNCERTAINTY:
            raise InputError(
                points.source,
                f"points that fix the {name} to {value:.0%} only",
                f"points that fix it to {LARGEST_UNCERTAINTY:.0%}",
                SURVEY_HINT,
            )
    return covariance
