"""The pinhole camera with one radial distortion term, and what else a lens may do, in OpenCV's conventions.

Pixel (0, 0) is the centre of the top-left pixel, u runs right, v down. ``rotation`` takes world to
camera axes (x right, y down, z forward). A point at normalised image coordinates (x, y) appears at
f (1 + k1 r^2) (x, y) + principal point, r^2 = x^2 + y^2 (Tsai 1987; OpenCV's first radial term).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

__all__ = ["PARAMETER_NAMES", "REFERENCE_ROTATION", "Camera"]

#: Rotation of a camera that looks along +z with +y up; +x then points to the left in the image.
REFERENCE_ROTATION = np.diag([-1.0, -1.0, 1.0])

#: Order of ``Camera.parameters`` and of its covariance.
PARAMETER_NAMES = (
    "x_mm",
    "y_mm",
    "z_mm",
    "rx_deg",
    "ry_deg",
    "rz_deg",
    "focal_length_px",
    "principal_u_px",
    "principal_v_px",
    "k1",
)

#: Each round of the inverse leaves the part of the error by which displacements change over the displacement's length.
_INVERSION_ROUNDS = 6

#: Accuracy of the radius without distortion, tangent of the field angle.
_RADIUS_ACCURACY = 1e-15

#: Positions across and down by which cameras are compared, rounds of Gauss-Newton, and its steps of the parameters.
_GRID, _CLOSEST_ROUNDS, _PARAMETER_STEP = 15, 4, 1e-4


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with one radial distortion term.

    width_px, height_px : size of the image. focal_length_px : > 0. principal_point_px : (2,) u, v.
    k1 : radial distortion coefficient, without unit; negative is barrel distortion.
    position_mm : (3,) centre of projection. rotation : (3, 3) world to camera axes.
    covariance : (10, 10) of ``parameters`` in the order of PARAMETER_NAMES, or None where unknown.
    further_distortion : what the ten parameters do not describe, None for nothing: a smooth function of the image
    positions (n, 2), px, that they give, to the displacements (n, 2), px, at most a few pixels.
    """

    width_px: int
    height_px: int
    focal_length_px: float
    principal_point_px: NDArray[np.float64]
    k1: float
    rotation: NDArray[np.float64]
    position_mm: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None
    further_distortion: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None

    @property
    def is_pinhole(self) -> bool:
        """Whether nothing distorts the image."""
        return self.k1 == 0 and self.further_distortion is None

    @property
    def parameters(self) -> NDArray[np.float64]:
        """(10,) position (mm), Rodrigues vector of R R0^T (degrees), focal length and principal point (px), k1.

        R is ``rotation``, R0 is REFERENCE_ROTATION.
        """
        turn = Rotation.from_matrix(self.rotation @ REFERENCE_ROTATION.T).as_rotvec(degrees=True)
        return np.concatenate([self.position_mm, turn, [self.focal_length_px], self.principal_point_px, [self.k1]])

    def with_parameters(self, values: ArrayLike) -> Camera:
        """The same image size with other parameters (10,), in the order of PARAMETER_NAMES."""
        p = np.asarray(values, float)
        rotation = Rotation.from_rotvec(p[3:6], degrees=True).as_matrix() @ REFERENCE_ROTATION
        return replace(
            self,
            position_mm=p[:3].copy(),
            rotation=rotation,
            focal_length_px=float(p[6]),
            principal_point_px=p[7:9].copy(),
            k1=float(p[9]),
        )

    def project(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Image positions (n, 2) in px of world points (n, 3); NaN for points behind the camera."""
        local = (np.asarray(points_mm, float) - self.position_mm) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(local[:, 2:] > 0, local[:, :2] / local[:, 2:], np.nan)
        radial = 1.0 + self.k1 * np.sum(xy**2, axis=1, keepdims=True)
        return self.displaced(self.focal_length_px * radial * xy + self.principal_point_px)

    def motion_px(self, other: Camera, points_mm: ArrayLike) -> float:
        """How far the points (n, 3) that both cameras see lie apart in their pictures: px, rms per coordinate."""
        return float(np.sqrt(np.nanmean((other.project(points_mm) - self.project(points_mm)) ** 2)))

    def displaced(self, image_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where image positions (n, 2), px, that the ten parameters give appear after the further distortion."""
        if self.further_distortion is None:
            return image_px
        return image_px + self.further_distortion(image_px)

    def distorted_further(self, shift: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Camera:
        """With ``shift``, a function such as ``further_distortion``, added to the further distortion."""
        first = self.further_distortion
        both = shift if first is None else lambda image_px: first(image_px) + shift(image_px)
        return replace(self, further_distortion=both)

    def closest_parameters(self) -> Camera:
        """The same camera, its ten parameters so that the further distortion is least over the image (rms).

        Where the camera stands remains as it is. A camera without further distortion is returned as it is.
        """
        first = self.further_distortion
        if first is None:
            return self
        plain = replace(self, further_distortion=None)
        u, v = np.meshgrid(np.linspace(0, self.width_px - 1, _GRID), np.linspace(0, self.height_px - 1, _GRID))
        image = np.stack([u.ravel(), v.ravel()], axis=-1)
        points, target = plain.position_mm + plain.directions(*image.T), image + first(image)
        seen = np.isfinite(points).all(axis=1)
        points, target = points[seen], target[seen]
        closest = plain
        steps = _PARAMETER_STEP * np.eye(10)[3:]
        for _ in range(_CLOSEST_ROUNDS):
            here = closest.project(points)
            moved = [closest.with_parameters(closest.parameters + s).project(points) - here for s in steps]
            design = np.array([m.ravel() for m in moved]).T
            size = np.linalg.norm(design, axis=0)
            times = np.linalg.lstsq(design / size, (target - here).ravel(), rcond=None)[0] / size
            closest = closest.with_parameters(closest.parameters + times @ steps)

        def left(image_px: NDArray[np.float64]) -> NDArray[np.float64]:
            before = plain.project(plain.position_mm + closest.directions(*image_px.T))
            return before + first(before) - image_px

        return replace(closest, further_distortion=left)

    def undisplaced(self, image_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse of ``displaced``, by fixed-point iteration: good where displacements change slowly."""
        if self.further_distortion is None:
            return image_px
        before = image_px
        for _ in range(_INVERSION_ROUNDS):
            before = image_px - self.further_distortion(before)
        return before

    def directions(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        """Unit world directions (..., 3) of the rays through pixel positions (px); NaN as of ``slopes``."""
        slopes = self.slopes(u_px, v_px)
        world = np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1) @ self.rotation
        return world / np.sqrt(np.einsum("...i,...i", world, world))[..., None]

    def slopes(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        """x / z and y / z (..., 2), in the camera's axes, of the rays through pixel positions (px); the distortion is
        inverted.

        NaN where no ray exists: with k1 < 0 the largest image radius is 2 f / (3 sqrt(-3 k1)).
        """
        u, v = np.broadcast_arrays(np.asarray(u_px, float), np.asarray(v_px, float))
        image = np.stack([u, v], -1)
        image = self.undisplaced(image.reshape(-1, 2)).reshape(image.shape)
        distorted = (image - self.principal_point_px) / self.focal_length_px
        radius = np.hypot(distorted[..., 0], distorted[..., 1])
        undistorted = np.where(radius * np.sqrt(max(-27.0 * self.k1, 0.0)) < 2.0, radius, np.nan)
        for _ in range(12):  # Newton on r (1 + k1 r^2) = radius converges quadratically
            square = self.k1 * undistorted**2
            step = (undistorted * (1 + square) - radius) / (1 + 3 * square)
            undistorted -= step
            if not np.any(np.abs(step) > _RADIUS_ACCURACY):
                break
        scale = np.divide(undistorted, radius, out=np.ones_like(radius), where=radius > 0)
        return distorted * scale[..., None]
