"""Derivatives of image positions by the camera parameters, and the inverse information."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = ["inverse_information", "parameter_jacobian"]


def parameter_jacobian(
    camera: Camera, points_mm: NDArray[np.float64], values: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Derivative of the projected positions by the ten parameters of PARAMETER_NAMES.

    Rows of points behind the camera are zero.

    Parameters
    ----------
    camera
        Camera whose image size and, by default, parameters are used.
    points_mm
        (n, 3) world positions, mm.
    values
        (10,) parameters to use instead of the camera's. An optimiser whose rotation vector exceeds a half turn needs
        the derivative at that vector, not at the shorter vector of the same rotation.

    Returns
    -------
    NDArray
        (2 n, 10) derivatives, px per unit of the parameter: u and v of the first point, of the second, and so on.
    """
    values = camera.parameters if values is None else values
    camera = camera.with_parameters(values)
    local = (points_mm - camera.position_mm) @ camera.rotation.T
    behind = local[:, 2] <= 0
    depth = np.where(behind, 1.0, local[:, 2])
    x, y = local[:, 0] / depth, local[:, 1] / depth
    xy, square = np.stack([x, y], -1), x**2 + y**2
    radial = 1 + camera.k1 * square
    by_xy = camera.focal_length_px * (
        radial[:, None, None] * np.eye(2) + 2 * camera.k1 * xy[:, :, None] * xy[:, None, :]
    )
    by_local = np.zeros((len(depth), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1 / depth
    by_local[:, :, 2] = -xy / depth[:, None]
    by_local = by_xy @ by_local
    jacobian = np.zeros((len(depth), 2, len(PARAMETER_NAMES)))
    jacobian[:, :, :3] = -by_local @ camera.rotation
    # A small change dr of the rotation vector turns the camera's axes by J_left dr (left Jacobian of SO(3)).
    jacobian[:, :, 3:6] = -by_local @ _cross(local) @ _left_jacobian(np.radians(values[3:6])) * np.radians(1.0)
    jacobian[:, :, 6] = radial[:, None] * xy
    jacobian[:, :, 7:9] = np.eye(2)
    jacobian[:, :, 9] = camera.focal_length_px * square[:, None] * xy
    jacobian[behind] = 0.0
    return jacobian.reshape(-1, len(PARAMETER_NAMES))


def inverse_information(jacobian: NDArray[np.float64], source: str, hint: str) -> NDArray[np.float64]:
    """(p, p) inverse (J^T J)^-1 of the information matrix of a Jacobian.

    The columns are normalised for the test of singularity, so that it does not depend on the parameters' units.

    Parameters
    ----------
    jacobian
        (m, p) derivatives of m measurements, in standard deviations, by p parameters.
    source
        File or key named in the message of the error.
    hint
        Next step in the message of the error.

    Returns
    -------
    NDArray
        (p, p) symmetric matrix; the parameters' covariance if the rows are in standard deviations.

    Raises
    ------
    InputError
        If the measurements do not determine all parameters.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    _, singular, right = np.linalg.svd(jacobian / np.where(norms > 0, norms, 1), full_matrices=False)
    if len(jacobian) < len(norms) or not np.all(norms > 0) or singular[-1] < 1e-8 * singular[0]:
        raise InputError(
            source,
            "points that do not determine the camera",
            f"points that determine all {len(norms)} parameters",
            hint,
        )
    half = right.T / singular / norms[:, None]
    return half @ half.T


def _cross(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3, 3) matrices [v]x with [v]x w = v x w."""
    return np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2)


def _left_jacobian(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) left Jacobian J of SO(3): exp(turn + d) = exp(J d) exp(turn) to first order in d."""
    angle, cross = float(np.linalg.norm(turn)), _cross(turn)
    if angle < 1e-4:
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
