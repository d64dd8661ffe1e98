"""Least squares over the shared intrinsics and the poses of several views of flat targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .camera_fit import camera_from_opencv
from .lens_model import ONE_TERM, LensModel
from .targets import TargetView

__all__ = ["HINT", "adjust", "starting_cameras", "view_jacobian"]

#: Next step in messages about views that do not determine the intrinsics.
HINT = "Photograph the target tilted by 20 to 45 degrees, in several directions, over the whole image"


def starting_cameras(
    views: Sequence[TargetView], width_px: int, height_px: int, lens: Camera | None, source: str
) -> list[Camera]:
    """Initial poses and intrinsics by OpenCV; only the poses if ``lens`` has the intrinsics.

    Parameters
    ----------
    views
        Points of each view on the target, mm, and in the image, px.
    width_px, height_px
        Size of the image, px.
    lens
        Camera whose intrinsics and lens are used; None estimates them, with k1 alone.
    source
        File or key named in the message of the error.

    Returns
    -------
    list[Camera]
        One camera per view, with equal intrinsics.

    Raises
    ------
    InputError
        If OpenCV finds no intrinsics or no pose.
    """
    worlds = [world.astype(np.float32) for world, _ in views]
    images = [image.astype(np.float32) for _, image in views]
    try:
        if lens is None:
            flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
            _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                worlds, images, (width_px, height_px), np.eye(3), np.zeros(5), flags=flags
            )
        else:
            u, v = lens.principal_point_px
            matrix = np.array([[lens.focal_length_px, 0, u], [0, lens.focal_length_px, v], [0, 0, 1]])
            distortion = np.array([lens.k1, 0, 0, 0, 0])
            if not lens.lens.one_term:
                images = [_straight(lens, image) for _, image in views]
            straight = distortion if lens.lens.one_term else np.zeros(5)
            poses = [
                cv2.solvePnP(world, image, matrix, straight, flags=cv2.SOLVEPNP_IPPE)
                for world, image in zip(worlds, images, strict=True)
            ]
            turns, shifts = [pose[1] for pose in poses], [pose[2] for pose in poses]
        results = [matrix, distortion, *turns, *shifts]
        # OpenCV returns nothing or NaN for points on a line of the image.
        failed = any(values is None or np.size(values) == 0 or not np.isfinite(values).all() for values in results)
    except cv2.error:
        failed = True
    if failed:
        raise InputError(source, "views inconsistent with any camera", "views tilted differently", HINT)
    cameras = [
        camera_from_opencv(width_px, height_px, matrix, distortion.ravel()[0], turn, shift)
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    return cameras if lens is None else [replace(camera, lens=lens.lens) for camera in cameras]


def _straight(lens: Camera, image: NDArray[np.float64]) -> NDArray[np.float32]:
    """(n, 2) image positions without the distortion of a lens, px."""
    return (lens.focal_length_px * lens.slopes(*image.T) + lens.principal_point_px).astype(np.float32)


def adjust(
    cameras: Sequence[Camera],
    measured: Sequence[TargetView],
    sigmas: Sequence[float],
    model: LensModel = ONE_TERM,
) -> list[Camera]:
    """Cameras by least squares: a shared lens, a pose per view, views weighted by sigma.

    Parameters
    ----------
    cameras
        Initial cameras; the initial intrinsics are those of the last.
    measured
        World and image positions of each camera, mm and px.
    sigmas
        Standard deviation of the image coordinates of each, px.
    model
        Formula of the lens and the parameters that are fitted.

    Returns
    -------
    list[Camera]
        Fitted cameras with equal intrinsics, without covariance.
    """
    shared = model.shared

    def of_views(values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        poses = values[shared:].reshape(-1, 6)
        return [np.concatenate([pose, values[:shared]]) for pose in poses]

    def with_values(values: NDArray[np.float64]) -> list[Camera]:
        return [model.applied(camera, fitted) for camera, fitted in zip(cameras, of_views(values), strict=True)]

    def residuals(values: NDArray[np.float64]) -> NDArray[np.float64]:
        parts = [
            ((camera.project(world) - image) / sigma).ravel()
            for camera, (world, image), sigma in zip(with_values(values), measured, sigmas, strict=True)
        ]
        # Points behind the camera get a large residual, so that the step is rejected.
        return np.nan_to_num(np.concatenate(parts), nan=1e6)

    def jacobian(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return view_jacobian(cameras, measured, sigmas, model, of_views(values))

    initial = [model.values(camera) for camera in cameras]
    start = np.concatenate([initial[-1][6:], *(values[:6] for values in initial)])
    solution = least_squares(
        residuals, start, jac=jacobian, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200
    )
    return with_values(solution.x)


def view_jacobian(
    cameras: Sequence[Camera],
    measured: Sequence[TargetView],
    sigmas: Sequence[float],
    model: LensModel = ONE_TERM,
    values: Sequence[NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """Derivative of weighted positions by the shared parameters, then by each pose.

    Parameters
    ----------
    cameras
        One camera per view.
    measured
        World and image positions of each view, mm and px.
    sigmas
        Standard deviation of the image coordinates of each view, px.
    model
        Formula of the lens and the parameters that are fitted.
    values
        Fitted parameters of each view to use instead of the cameras'; None uses the cameras'.

    Returns
    -------
    NDArray
        (m, shared + 6 views) derivatives, standard deviations per unit of the parameter.
    """
    rows, shared = [], model.shared
    for index, (camera, (world, _), sigma) in enumerate(zip(cameras, measured, sigmas, strict=True)):
        derivative = model.jacobian(camera, world, values[index] if values else None) / sigma
        block = np.zeros((len(derivative), shared + 6 * len(cameras)))
        block[:, :shared] = derivative[:, 6:]
        block[:, shared + 6 * index : shared + 6 * index + 6] = derivative[:, :6]
        rows.append(block)
    return np.concatenate(rows)
