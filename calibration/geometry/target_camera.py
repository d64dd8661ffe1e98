"""Camera intrinsics from several views of flat targets (Zhang 2000).

All views share focal length, principal point and one radial term; each has its own pose. In a joint fit the targets
improve the intrinsics of the surveyed camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .camera_fit import LARGEST_UNCERTAINTY, CameraFit, camera_from_opencv
from .camera_jacobian import inverse_information, parameter_jacobian
from .surveyed_points import SurveyedPoints
from .targets import TargetView

__all__ = ["TargetFit", "fit_camera_targets"]

#: Next step in messages about views that do not determine the intrinsics.
HINT = "Photograph the target tilted by 20 to 45 degrees, in several directions, over the whole image"

#: Shared parameters in PARAMETER_NAMES: focal length, principal point, k1.
INTRINSICS = slice(6, 10)

#: Parameters of each pose in PARAMETER_NAMES.
POSE = slice(0, 6)


@dataclass(frozen=True, eq=False)
class TargetFit:
    """The result of ``fit_camera_targets``.

    cameras : one per target view, each with its (10, 10) covariance; they share the intrinsics.
    intrinsics : (4,) focal length, principal point u and v, k1, with ``intrinsics_covariance`` (4, 4).
    survey_camera : the camera of the surveyed view, from the joint fit; None without a survey.
    reprojection_rms_px : per coordinate, over all target views. view_rms_px : of each view; a large value shows
        a misdetected target or one that is not flat.
    point_sigma_px : standard deviation of the targets' image coordinates, stated or estimated.
    degrees_of_freedom : number of coordinates of all views, including the survey, minus parameters.
    """

    cameras: tuple[Camera, ...]
    intrinsics: NDArray[np.float64]
    intrinsics_covariance: NDArray[np.float64]
    survey_camera: Camera | None
    reprojection_rms_px: float
    view_rms_px: tuple[float, ...]
    point_sigma_px: float
    degrees_of_freedom: int


def fit_camera_targets(
    views: Sequence[TargetView],
    *,
    width_px: int,
    height_px: int,
    point_sigma_px: float | None = None,
    survey: tuple[SurveyedPoints, CameraFit] | None = None,
    source: str = "target views",
) -> TargetFit:
    """Shared intrinsics and the pose of every view.

    views : from ``detect_target``, in pixels of the whole frame (a crop's offset added).
    point_sigma_px : standard deviation of a target's image coordinate; None: estimated from the residuals.
    survey : surveyed points taken with the same lens and focus, and their fit; the points that it kept are fitted
        jointly, with its sigma.

    Raises InputError if the views cannot determine the intrinsics: too few points, only one view, or views
    without tilt (which do not separate focal length from distance).
    """
    if len(views) < (1 if survey else 2):
        raise InputError(source, f"{len(views)} view of a flat target", "at least two, tilted differently", HINT)
    for number, (world, _) in enumerate(views, 1):
        if len(world) < 6:
            raise InputError(f"{source}: view {number}", f"{len(world)} points", "at least 6")
    measured = list(views)
    cameras = _starting_cameras(views, width_px, height_px, survey[1].camera if survey else None, source)
    sigmas = [point_sigma_px or 1.0] * len(views)
    if survey is not None:
        points, fit = survey
        measured.append((points.points_mm[fit.kept], points.image_px[fit.kept]))
        cameras.append(fit.camera)
        sigmas.append(fit.point_sigma_px)
    count = sum(2 * len(world) for world, _ in views)
    # One iteration if the sigma is stated; else iterate, since the weights depend on the estimated sigma.
    for _ in range(1 if point_sigma_px else 6):
        cameras = _adjust(cameras, measured, sigmas)
        jacobian = _jacobian(cameras, measured, sigmas)
        inverse = inverse_information(jacobian, source, HINT)
        residuals = [image - c.project(world) for c, (world, image) in zip(cameras, measured, strict=True)]
        targets = np.concatenate(residuals[: len(views)])
        if point_sigma_px is None:
            # The targets' share of the parameters is the trace of their part of the hat matrix (Foerstner 1979).
            target_parameters = float(np.einsum("ij,jk,ik->", jacobian[:count], inverse, jacobian[:count]))
            ratio = np.sqrt(np.sum(targets**2) / (count - target_parameters)) / sigmas[0]
            sigmas[: len(views)] = [sigmas[0] * ratio] * len(views)
            if survey is None:
                inverse = inverse * ratio**2
                break
    cameras = [replace(c, covariance=_of_view(inverse, index)) for index, c in enumerate(cameras)]
    share = float(np.sqrt(inverse[0, 0])) / cameras[0].focal_length_px
    if share > LARGEST_UNCERTAINTY:
        raise InputError(
            source,
            f"a relative uncertainty of the focal length of {share:.0%}",
            f"at most {LARGEST_UNCERTAINTY:.0%}",
            HINT,
        )
    return TargetFit(
        cameras=tuple(cameras[: len(views)]),
        intrinsics=cameras[0].parameters[INTRINSICS],
        intrinsics_covariance=inverse[:4, :4],
        survey_camera=cameras[-1] if survey else None,
        reprojection_rms_px=float(np.sqrt(np.mean(targets**2))),
        view_rms_px=tuple(float(np.sqrt(np.mean(r**2))) for r in residuals[: len(views)]),
        point_sigma_px=sigmas[0],
        degrees_of_freedom=jacobian.shape[0] - jacobian.shape[1],
    )


def _starting_cameras(
    views: Sequence[TargetView], width_px: int, height_px: int, lens: Camera | None, source: str
) -> list[Camera]:
    """Initial poses and intrinsics by OpenCV; only the poses if ``lens`` has the intrinsics."""
    worlds = [world.astype(np.float32) for world, _ in views]
    images = [image.astype(np.float32) for _, image in views]
    if lens is None:
        flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
        try:
            _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                worlds, images, (width_px, height_px), np.eye(3), np.zeros(5), flags=flags
            )
        except cv2.error:
            raise InputError(source, "views inconsistent with any camera", "views tilted differently", HINT) from None
    else:
        u, v = lens.principal_point_px
        matrix = np.array([[lens.focal_length_px, 0, u], [0, lens.focal_length_px, v], [0, 0, 1]])
        distortion = np.array([lens.k1, 0, 0, 0, 0])
        poses = [
            cv2.solvePnP(world, image, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
            for world, image in zip(worlds, images, strict=True)
        ]
        turns, shifts = [pose[1] for pose in poses], [pose[2] for pose in poses]
    return [
        camera_from_opencv(width_px, height_px, matrix, distortion.ravel()[0], turn, shift)
        for turn, shift in zip(turns, shifts, strict=True)
    ]


def _adjust(cameras: Sequence[Camera], measured: Sequence[TargetView], sigmas: Sequence[float]) -> list[Camera]:
    """Cameras by least squares: shared intrinsics, a pose per view, views weighted by sigma."""

    def with_values(values: NDArray[np.float64]) -> list[Camera]:
        return [
            camera.with_parameters(np.concatenate([values[4 + 6 * i : 10 + 6 * i], values[:4]]))
            for i, camera in enumerate(cameras)
        ]

    def residuals(values: NDArray[np.float64]) -> NDArray[np.float64]:
        parts = [
            ((camera.project(world) - image) / sigma).ravel()
            for camera, (world, image), sigma in zip(with_values(values), measured, sigmas, strict=True)
        ]
        # Points behind the camera get a large residual, so that the step is rejected.
        return np.nan_to_num(np.concatenate(parts), nan=1e6)

    def jacobian(values: NDArray[np.float64]) -> NDArray[np.float64]:
        poses = [np.concatenate([values[4 + 6 * i : 10 + 6 * i], values[:4]]) for i in range(len(cameras))]
        return _jacobian(cameras, measured, sigmas, poses)

    start = np.concatenate([cameras[-1].parameters[INTRINSICS], *(camera.parameters[POSE] for camera in cameras)])
    solution = least_squares(
        residuals, start, jac=jacobian, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200
    )
    return with_values(solution.x)


def _jacobian(
    cameras: Sequence[Camera],
    measured: Sequence[TargetView],
    sigmas: Sequence[float],
    values: Sequence[NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """(m, 4 + 6 views) derivative of weighted positions by the intrinsics, then by each pose."""
    rows = []
    for index, (camera, (world, _), sigma) in enumerate(zip(cameras, measured, sigmas, strict=True)):
        derivative = parameter_jacobian(camera, world, values[index] if values else None) / sigma
        block = np.zeros((len(derivative), 4 + 6 * len(cameras)))
        block[:, :4] = derivative[:, INTRINSICS]
        block[:, 4 + 6 * index : 10 + 6 * index] = derivative[:, POSE]
        rows.append(block)
    return np.concatenate(rows)


def _of_view(covariance: NDArray[np.float64], index: int) -> NDArray[np.float64]:
    """(10, 10) covariance of one view's camera, in the order of PARAMETER_NAMES."""
    order = np.r_[4 + 6 * index : 10 + 6 * index, 0:4]
    return covariance[np.ix_(order, order)]
