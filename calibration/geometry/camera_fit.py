"""Camera from one view of surveyed, non-coplanar points, with its covariance (Tsai 1987).

Ten parameters are fitted: pose, focal length, principal point and one radial term; pixels are square. A ``LensModel``
adds terms of the lens, or holds stated parameters. The nominal focal length is only the initial value, not a prior; the
fit returns it for comparison.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.distributions import chi2_quantile, chi2_tail, fisher_quantile
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .camera_jacobian import inverse_information
from .lens_model import ONE_TERM, LensModel
from .surveyed_points import FEWEST_POINTS, SURVEY_HINT, SurveyedPoints, read_points, require_determined

__all__ = ["FALSE_ALARM", "CameraFit", "SurveyedPoints", "fit_camera", "read_points"]

#: Probability that a point of a survey without outliers is rejected.
FALSE_ALARM = 1e-3

#: Largest relative standard deviation of focal length or distance at which a linearised covariance is valid.
LARGEST_UNCERTAINTY = 0.2


@dataclass(frozen=True, eq=False)
class CameraFit(FrozenMappings):
    """Camera fitted to surveyed points, by `fit_camera`."""

    #: Fitted camera with its (10, 10) covariance in the order of PARAMETER_NAMES.
    camera: Camera
    #: Surveyed points; None where boards at a stated place determine the camera.
    points: SurveyedPoints | None
    #: (n, 2) measured minus projected image positions of all points, px.
    residuals_px: NDArray[np.float64]
    #: (n,) True for the points used in the fit.
    in_use: NDArray[np.bool_]
    #: Ids of the rejected points.
    outliers: tuple[str, ...]
    #: Root mean square of the residuals of the points used, per coordinate, px.
    reprojection_rms_px: float
    #: Standard deviation of a measured coordinate, px: as stated, otherwise estimated from the residuals.
    point_sigma_px: float
    #: True if `point_sigma_px` was estimated.
    sigma_estimated: bool
    #: Sum of squares over the stated variance, of the points used; None if sigma was estimated.
    chi2: float | None
    #: Probability of a larger `chi2` by noise; None if sigma was estimated. A very small value means that the stated
    #: sigma or the camera model is wrong.
    p_value: float | None
    #: Number of coordinates of the points used minus that of the fitted parameters, ten for a lens of one term.
    degrees_of_freedom: int
    #: Nominal focal length as given, px, for comparison with the fitted one; None if none was given.
    nominal_focal_length_px: float | None
    #: Standard deviations of the fitted terms of the lens beyond k1, by term.
    lens_sigmas: Mapping[str, float] = field(default_factory=dict)


def fit_camera(
    points: SurveyedPoints,
    *,
    width_px: int,
    height_px: int,
    point_sigma_px: float | None = None,
    focal_length_px: float | None = None,
    model: LensModel = ONE_TERM,
    start: Camera | None = None,
) -> CameraFit:
    """Camera fitted to surveyed points and their image positions.

    The initial pose comes from OpenCV (perspective-n-point with RANSAC), the initial intrinsics from
    ``cv2.calibrateCamera``; then least squares on ``Camera.project``. The covariance is sigma^2 (J^T J)^-1 at the
    solution.

    Points whose deleted residual would occur by noise in a fraction FALSE_ALARM of all surveys are rejected as
    outliers. If the majority of the points scatter more than the stated sigma, the observed scatter sets the threshold
    and p_value is small. With a dozen points or fewer an outlier may not be detected; then, too, only p_value shows it.

    Parameters
    ----------
    points
        Positions in the box, mm, and in the image, px.
    width_px, height_px
        Size of the image, px.
    point_sigma_px
        Standard deviation of each measured image coordinate, px; None estimates it from the residuals.
    focal_length_px
        Nominal focal length, px, as initial value; None tries several focal lengths.
    model
        Formula of the lens, the parameters that are fitted, and those that are stated.
    start
        Initial camera; None finds one.

    Returns
    -------
    CameraFit
        Camera with covariance, residuals and rejected points.

    Raises
    ------
    InputError
        If the points cannot determine the ten parameters: fewer than six, in one plane, all in a small part of the
        image, in a critical configuration, or inconsistent. Also if `point_sigma_px` is not above 0.
    """
    if point_sigma_px is not None and not point_sigma_px > 0:
        raise InputError("geometry.point_sigma_px", f"{point_sigma_px:g}", "a number above 0")
    require_determined(points, np.ones(len(points.ids), bool), width_px, height_px)
    if start is None:
        start = _starting_camera(points, width_px, height_px, focal_length_px, point_sigma_px, model)
    start = start if model == ONE_TERM else model.start(start)
    camera, in_use, scale = _robust_fit(start, points, point_sigma_px, model)
    for attempt in range(2 * len(points.ids)):
        require_determined(points, in_use, width_px, height_px)
        camera = _least_squares(camera, points, in_use, model)
        accepted = _consistent(camera, points, in_use, scale, model, estimated=point_sigma_px is None)
        if np.array_equal(accepted, in_use):
            break
        # After ten iterations points may only be removed, so that the loop ends.
        in_use = accepted if attempt < 10 else accepted & in_use
    residuals = points.image_px - camera.project(points.points_mm)
    sum_of_squares = float(np.sum(residuals[in_use] ** 2))
    freedom = 2 * int(in_use.sum()) - model.count
    sigma = point_sigma_px or float(np.sqrt(sum_of_squares / freedom))
    fitted = sigma**2 * inverse_information(
        model.jacobian(camera, points.points_mm[in_use]), points.source, SURVEY_HINT
    )
    camera = replace(camera, covariance=_checked(model.covariance(camera, fitted), camera, points, in_use))
    chi2 = sum_of_squares / point_sigma_px**2 if point_sigma_px else None
    return CameraFit(
        camera=camera,
        points=points,
        residuals_px=residuals,
        in_use=in_use,
        outliers=tuple(name for name, use in zip(points.ids, in_use, strict=True) if not use),
        reprojection_rms_px=float(np.sqrt(np.mean(residuals[in_use] ** 2))),
        point_sigma_px=sigma,
        sigma_estimated=point_sigma_px is None,
        chi2=chi2,
        p_value=None if chi2 is None else float(chi2_tail(chi2, freedom)),
        degrees_of_freedom=freedom,
        nominal_focal_length_px=focal_length_px,
        lens_sigmas=model.term_sigmas(fitted),
    )


def camera_from_opencv(
    width_px: int, height_px: int, matrix: NDArray, k1: float, turn: NDArray, shift: NDArray
) -> Camera:
    """``Camera`` with the parameters that OpenCV returns.

    Parameters
    ----------
    width_px, height_px
        Size of the image, px.
    matrix
        (3, 3) camera matrix; its first element is taken as the focal length, px.
    k1
        First radial coefficient, without unit.
    turn
        (3,) Rodrigues vector from world to camera axes, radians.
    shift
        (3,) or (3, 1) position of the world's origin in camera axes, mm.

    Returns
    -------
    Camera
        Camera without covariance.
    """
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
    points: SurveyedPoints,
    width_px: int,
    height_px: int,
    focal_length_px: float | None,
    sigma: float | None,
    model: LensModel,
) -> Camera:
    """Initial camera by RANSAC: the first focal length that fits well, otherwise the best."""
    diagonal = float(np.hypot(width_px, height_px))
    middle = focal_length_px or diagonal
    # Allows for a few percent of error in the nominal focal length and a few percent of distortion.
    tolerance = max(10 * (sigma or 0.0), 0.02 * diagonal)
    best: tuple[float, Camera, NDArray] | None = None
    shares = [1.0, 0.8, 1.25, 0.5, 2.0, 0.25, 4.0]
    fixed = model.focal_length_px
    for focal in middle * np.array(shares) if fixed is None else [fixed]:
        matrix = np.array([[focal, 0, (width_px - 1) / 2], [0, focal, (height_px - 1) / 2], [0, 0, 1.0]])
        lens = Camera(
            width_px, height_px, focal, matrix[:2, 2], model.k1 or 0.0, np.eye(3), np.zeros(3), lens=model.lens
        )
        world, image = _straightened(lens, points.points_mm, points.image_px)
        try:
            succeeded, turn, shift, inliers = cv2.solvePnPRansac(
                world,
                image,
                matrix,
                None,
                iterationsCount=500,
                reprojectionError=tolerance,
                confidence=0.9999,
                flags=cv2.SOLVEPNP_SQPNP,
            )
        except cv2.error:
            continue
        if not succeeded or inliers is None or len(inliers) < FEWEST_POINTS:
            continue
        pose = camera_from_opencv(width_px, height_px, matrix, lens.k1, turn, shift)
        camera = replace(pose, lens=lens.lens)
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
    return _opencv_calibration(best[1], points, best[2]) if model == ONE_TERM else best[1]


def _straightened(lens: Camera, world: NDArray, image: NDArray) -> tuple[NDArray, NDArray]:
    """Points and their image positions without distortion; points without a ray are left out."""
    if lens.is_pinhole:
        return world, image
    straight = lens.focal_length_px * lens.slopes(*image.T) + lens.principal_point_px
    finite = np.isfinite(straight).all(axis=1)
    return np.ascontiguousarray(world[finite]), np.ascontiguousarray(straight[finite])


def _opencv_calibration(camera: Camera, points: SurveyedPoints, selected: NDArray[np.int_]) -> Camera:
    """Camera fitted by OpenCV to the selected points; the initial one if OpenCV fits worse."""
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
            [points.points_mm[selected].astype(np.float32)],
            [points.image_px[selected].astype(np.float32)],
            (camera.width_px, camera.height_px),
            matrix,
            np.zeros(5),
            flags=flags,
        )
    except cv2.error:
        return camera
    refined = camera_from_opencv(camera.width_px, camera.height_px, matrix, distortion.ravel()[0], turns[0], shifts[0])
    errors = [c.project(points.points_mm[selected]) - points.image_px[selected] for c in (camera, refined)]
    return refined if np.sum(errors[1] ** 2) < np.sum(errors[0] ** 2) else camera


def _robust_fit(
    start: Camera, points: SurveyedPoints, sigma: float | None, model: LensModel
) -> tuple[Camera, NDArray[np.bool_], float]:
    """Robustly fitted camera, the points consistent with it (n,), and the majority's scatter.

    The Cauchy loss grows like a logarithm, so the influence of an outlier decreases with its size. The scale of the
    loss follows the decreasing scatter of the residuals. The scatter is a standard deviation per coordinate, px.
    """
    camera, count = start, len(points.ids)
    # Residuals of n points on 10 fitted parameters are smaller than the noise by this factor.
    shrinkage = np.sqrt(2 * count / (2 * count - model.count))
    scale = np.inf
    for loss in ("soft_l1", "cauchy", "cauchy", "cauchy"):
        errors = np.linalg.norm(points.image_px - camera.project(points.points_mm), axis=1)
        # The length of a 2-D Gaussian error has the median sigma sqrt(2 ln 2).
        scale = shrinkage * float(np.median(np.nan_to_num(errors, nan=1e6))) / np.sqrt(2 * np.log(2))
        # The lower bound avoids a scale of zero for points without noise.
        camera = _least_squares(camera, points, np.ones(count, bool), model, loss, 2 * max(scale, sigma or 0.0, 1e-6))
    errors = np.linalg.norm(points.image_px - camera.project(points.points_mm), axis=1)
    scale = shrinkage * float(np.median(errors)) / np.sqrt(2 * np.log(2))
    scale = max(scale, sigma or 0.0, 1e-6)
    in_use = errors < scale * np.sqrt(chi2_quantile(FALSE_ALARM / count, 2))
    return camera, in_use, scale


def _least_squares(
    camera: Camera,
    points: SurveyedPoints,
    in_use: NDArray[np.bool_],
    model: LensModel,
    loss: str = "linear",
    scale: float = 1.0,
) -> Camera:
    """Camera fitted to the points in use by least squares, or with a robust loss of a scale, px."""
    world, image = points.points_mm[in_use], points.image_px[in_use]

    def residuals(values: NDArray[np.float64]) -> NDArray[np.float64]:
        # Points behind the camera get a large residual, so that the step is rejected.
        return np.nan_to_num((model.applied(camera, values).project(world) - image).ravel(), nan=1e6)

    def jacobian(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return model.jacobian(camera, world, values)

    solution = least_squares(
        residuals,
        model.values(camera),
        jac=jacobian,
        x_scale="jac",
        loss=loss,
        f_scale=scale,
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
        max_nfev=200,
    )
    return model.applied(camera, solution.x)


def _consistent(
    camera: Camera,
    points: SurveyedPoints,
    in_use: NDArray[np.bool_],
    scale: float,
    model: LensModel,
    *,
    estimated: bool,
) -> NDArray[np.bool_]:
    """(n,) True for points consistent with the camera fitted to the other points in use.

    The deleted residual of point i has the squared Mahalanobis length r^T (I - H_i)^-1 r / sigma^2 if i was in the fit.
    Otherwise it is r^T (I + H_i)^-1 r / sigma^2. H_i is J_i (J^T J)^-1 J_i^T. The length follows chi2(2), or 2 F(2, m)
    with sigma^2 from the m remaining degrees of freedom (Cook & Weisberg 1982).
    """
    residuals = points.image_px - camera.project(points.points_mm)
    jacobian = model.jacobian(camera, points.points_mm).reshape(-1, 2, model.count)
    fitted = jacobian[in_use].reshape(-1, model.count)
    inverse = inverse_information(fitted, points.source, SURVEY_HINT)
    influence = jacobian @ inverse @ jacobian.transpose(0, 2, 1)
    spread = np.eye(2) + np.where(in_use, -1.0, 1.0)[:, None, None] * influence
    # A point without which a parameter is undetermined cannot be checked: it is kept.
    checkable = np.linalg.eigvalsh(spread)[:, 0] > 1e-6
    squares = np.zeros(len(in_use))
    squares[checkable] = np.einsum(
        "ni,nij,nj->n", residuals[checkable], np.linalg.inv(spread[checkable]), residuals[checkable]
    )
    level = FALSE_ALARM / len(in_use)
    if not estimated:
        return ~(squares / scale**2 > chi2_quantile(level, 2))
    rest = np.sum(residuals[in_use] ** 2) - np.where(in_use, squares, 0.0)
    freedom = 2 * (int(in_use.sum()) - in_use) - model.count
    # Six points without a stated sigma leave no degrees of freedom for a test.
    testable = freedom > 0
    ratio = squares[testable] / 2 / np.maximum(rest[testable] / freedom[testable], 1e-16)
    accepted = np.ones(len(in_use), bool)
    accepted[testable] = ~(ratio > fisher_quantile(level, 2, freedom[testable]))
    return accepted


def _checked(
    covariance: NDArray[np.float64], camera: Camera, points: SurveyedPoints, in_use: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The (10, 10) covariance; InputError if it is too large to be linearised."""
    distance = float(np.median(np.linalg.norm(points.points_mm[in_use] - camera.position_mm, axis=1)))
    deviations = np.sqrt(np.diag(covariance))
    share = {
        "focal length": deviations[6] / camera.focal_length_px,
        "distance": max(deviations[:3]) / distance,
    }
    for name, value in share.items():
        if value > LARGEST_UNCERTAINTY:
            raise InputError(
                points.source,
                f"a relative uncertainty of the {name} of {value:.0%}",
                f"at most {LARGEST_UNCERTAINTY:.0%}",
                SURVEY_HINT,
            )
    return covariance
