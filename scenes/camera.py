"""The pinhole camera with one radial distortion term, in OpenCV's conventions.

Pixel (0, 0) is the centre of the top-left pixel, u runs right, v down. ``rotation`` takes world to
camera axes (x right, y down, z forward). A point at normalised image coordinates (x, y) appears at
f (1 + k1 r^2) (x, y) + principal point, r^2 = x^2 + y^2 (Tsai 1987; OpenCV's first radial term).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

__all__ = ["PARAMETER_NAMES", "REFERENCE_ROTATION", "Camera"]

#: The orientation of a camera that looks along +z with +y up: +x is then to the viewer's left.
REFERENCE_ROTATION = np.diag([-1.0, -1.0, 1.0])

#: Order of ``Camera.parameters`` and of its covariance.
PARAMETER_NAMES = (
    "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg",
    "focal_length_px", "principal_u_px", "principal_v_px", "k1",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera.

    position_mm : (3,) centre of projection. rotation : (3, 3) world to camera.
    covariance : (10, 10) of ``parameters`` in the order of PARAMETER_NAMES, or None where unknown.
    """

    width_px: int
    height_px: int
    focal_length_px: float
    principal_point_px: NDArray[np.float64]
    k1: float
    rotation: NDArray[np.float64]
    position_mm: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None

    @property
    def parameters(self) -> NDArray[np.float64]:
        """(10,) position_mm, Rodrigues vector of R R0^T in degrees, focal length, principal point, k1."""
        turn = Rotation.from_matrix(self.rotation @ REFERENCE_ROTATION.T).as_rotvec(degrees=True)
        return np.concatenate(
            [self.position_mm, turn, [self.focal_length_px], self.principal_point_px, [self.k1]]
        )

    def with_parameters(self, values: ArrayLike) -> Camera:
        """The same sensor with other parameters (10,)."""
        p = np.asarray(values, float)
        rotation = Rotation.from_rotvec(p[3:6], degrees=True).as_matrix() @ REFERENCE_ROTATION
        return replace(
            self, position_mm=p[:3].copy(), rotation=rotation, focal_length_px=float(p[6]),
            principal_point_px=p[7:9].copy(), k1=float(p[9]),
        )  # fmt: skip

    def project(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Image positions (n, 2) in px of world points (n, 3); NaN for points behind the camera."""
        local = (np.asarray(points_mm, float) - self.position_mm) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(local[:, 2:] > 0, local[:, :2] / local[:, 2:], np.nan)
        radial = 1.0 + self.k1 * np.sum(xy**2, axis=1, keepdims=True)
        return self.focal_length_px * radial * xy + self.principal_point_px

    def directions(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        """Unit world directions (..., 3) of the rays through pixel positions; the distortion is inverted.

        NaN where no ray arrives: with k1 < 0 no point appears farther out than 2 f / (3 sqrt(-3 k1)).
        """
        u, v = np.broadcast_arrays(np.asarray(u_px, float), np.asarray(v_px, float))
        distorted = np.stack([u - self.principal_point_px[0], v - self.principal_point_px[1]], -1)
        distorted = distorted / self.focal_length_px
        radius = np.linalg.norm(distorted, axis=-1)
        undistorted = np.where(radius * np.sqrt(max(-27.0 * self.k1, 0.0)) < 2.0, radius, np.nan)
        for _ in range(12):  # Newton on r (1 + k1 r^2) = radius converges quadratically
            undistorted -= (undistorted * (1 + self.k1 * undistorted**2) - radius) / (
                1 + 3 * self.k1 * undistorted**2
            )
        scale = np.divide(undistorted, radius, out=np.ones_like(radius), where=radius > 0)
        local = np.concatenate([distorted * scale[..., None], np.ones((*radius.shape, 1))], axis=-1)
        world = local @ self.rotation
        return world / np.linalg.norm(world, axis=-1, keepdims=True)
