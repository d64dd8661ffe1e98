"""Derivatives of image positions by the camera parameters, and the inverse information."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES, Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

__all__ = ["inverse_information", "parameter_jacobian", "term_jacobian"]


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
    xy = np.stack([x, y], -1)
    by_xy, by_focal_length, by_k1 = _lens_derivatives(camera, xy)
    by_local = np.zeros((len(depth), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1 / depth
    by_local[:, :, 2] = -xy / depth[:, None]
    by_local = by_xy @ by_local
    jacobian = np.zeros((len(depth), 2, len(PARAMETER_NAMES)))
    jacobian[:, :, :3] = -by_local @ camera.rotation
    # A small change dr of the rotation vector turns the camera's axes by J_left dr (left Jacobian of SO(3)).
    jacobian[:, :, 3:6] = -by_local @ _cross(local) @ _left_jacobian(np.radians(values[3:6])) * np.radians(1.0)
    jacobian[:, :, 6] = by_focal_length
    jacobian[:, :, 7:9] = np.eye(2)
    jacobian[:, :, 9] = by_k1
    jacobian[behind] = 0.0
    return jacobian.reshape(-1, len(PARAMETER_NAMES))


def term_jacobian(camera: Camera, points_mm: NDArray[np.float64], terms: Sequence[str]) -> NDArray[np.float64]:
    """Derivative of the projected positions by terms of the lens.

    Parameters
    ----------
    camera
        The camera.
    points_mm
        (n, 3) world positions, mm; rows of points behind the camera are zero.
    terms
        t names of fields of its lens.

    Returns
    -------
    NDArray
        (2 n, t) derivatives, px per unit of the term: u and v of the first point, of the second, and so on.
    """
    local = (points_mm - camera.position_mm) @ camera.rotation.T
    behind = local[:, 2] <= 0
    xy = local[:, :2] / np.where(behind, 1.0, local[:, 2])[:, None]
    columns = []
    for term in terms:
        if term == "aspect":
            column = camera.focal_length_px * camera.lens.distorted(xy, camera.k1) * [0.0, 1.0]
        else:
            column = camera.scales_px * camera.lens.term_derivatives(xy, term)
        columns.append(np.where(behind[:, None], 0.0, column).ravel())
    return np.stack(columns, axis=1) if columns else np.zeros((2 * len(xy), 0))


def _lens_derivatives(
    camera: Camera, xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives of image positions by slopes (n, 2, 2), focal length and k1 (n, 2 each)."""
    if camera.lens.one_term:
        square = np.sum(xy**2, axis=1)
        radial = 1 + camera.k1 * square
        by_xy = radial[:, None, None] * np.eye(2) + 2 * camera.k1 * xy[:, :, None] * xy[:, None, :]
        return camera.focal_length_px * by_xy, radial[:, None] * xy, camera.focal_length_px * square[:, None] * xy
    lens, scales = camera.lens, camera.scales_px
    return (
        scales[:, None] * lens.slope_derivatives(xy, camera.k1),
        lens.distorted(xy, camera.k1) * [1.0, lens.aspect],
        scales * lens.term_derivatives(xy, "k1"),
    )


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
    x, y, z = np.moveaxis(vectors, -1, 0)
    matrices = np.zeros((*vectors.shape, 3))
    matrices[..., 0, 1], matrices[..., 0, 2] = -z, y
    matrices[..., 1, 0], matrices[..., 1, 2] = z, -x
    matrices[..., 2, 0], matrices[..., 2, 1] = -y, x
    return matrices


def _left_jacobian(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) left Jacobian J of SO(3): exp(turn + d) = exp(J d) exp(turn) to first order in d."""
    angle, cross = float(np.linalg.norm(turn)), _cross(turn)
    if angle < 1e-4:
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
