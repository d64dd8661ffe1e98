"""Camera with the distortion of its lens and further distortion, in OpenCV's conventions.

Pixel (0, 0) is the centre of the top-left pixel, u runs right, v down. ``rotation`` takes world to
camera axes (x right, y down, z forward). A point at normalised image coordinates (x, y) appears at
f (1 + k1 r^2) (x, y) + principal point, r^2 = x^2 + y^2 (Tsai 1987; OpenCV's first radial term).
``Lens`` states the formula for a lens of more terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .lens import PLAIN_LENS, Lens

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

#: Rounds of the fixed-point iteration in ``undisplaced``. Each multiplies the error by the displacement's gradient.
_INVERSION_ROUNDS = 6

#: Accuracy of the radius without distortion, tangent of the field angle: a few roundings of a double.
_RADIUS_ACCURACY = 1e-15

#: Image positions across and down at which cameras are compared in ``closest_parameters``.
_GRID = 15

#: Rounds of Gauss-Newton in ``closest_parameters``: its equations are almost linear for a few pixels.
_CLOSEST_ROUNDS = 4

#: Step of the parameters for derivatives in ``closest_parameters``, in degrees, px and the unit of k1.
_PARAMETER_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Camera:
    """Camera of ten parameters, with the lens's further terms where it has any.

    Examples
    --------
    >>> from cboxlab.scenes import cornell_camera
    >>> cornell_camera(100).project([[278.0, 273.0, 0.0]]).round(2)
    array([[49.5, 49.5]])
    """

    #: Width of the image, px.
    width_px: int
    #: Height of the image, px.
    height_px: int
    #: Focal length, px, above 0.
    focal_length_px: float
    #: (2,) principal point u, v, px.
    principal_point_px: NDArray[np.float64]
    #: Radial distortion coefficient, without unit; negative is barrel distortion.
    k1: float
    #: (3, 3) rotation from world to camera axes.
    rotation: NDArray[np.float64]
    #: (3,) centre of projection, mm.
    position_mm: NDArray[np.float64]
    #: (10, 10) covariance of ``parameters``; None if unknown.
    covariance: NDArray[np.float64] | None = None
    #: Smooth function of image positions (n, 2), px, by the ten parameters, to further displacements (n, 2), px.
    #: They are at most a few pixels; None for no further distortion.
    further_distortion: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None
    #: Model of the distortion, and its terms beyond `k1`.
    lens: Lens = PLAIN_LENS

    @property
    def is_pinhole(self) -> bool:
        """Whether nothing distorts the image."""
        return self.k1 == 0 and self.further_distortion is None and self.lens.one_term

    @property
    def scales_px(self) -> NDArray[np.float64]:
        """(2,) focal lengths fx and fy, px."""
        return self.focal_length_px * np.array([1.0, self.lens.aspect])

    @property
    def parameters(self) -> NDArray[np.float64]:
        """(10,) parameters in the order of PARAMETER_NAMES.

        Position (mm), Rodrigues vector of R R0^T (degrees), focal length and principal point (px), and k1, with R the
        ``rotation`` and R0 REFERENCE_ROTATION.
        """
        turn = _turn(np.asarray(self.rotation, float).tobytes())
        return np.concatenate([self.position_mm, turn, [self.focal_length_px], self.principal_point_px, [self.k1]])

    def with_parameters(self, values: ArrayLike) -> Camera:
        """Camera of the same image size with other parameters.

        Parameters
        ----------
        values
            (10,) parameters in the order and units of PARAMETER_NAMES.

        Returns
        -------
        Camera
            The camera, with the same lens, covariance and further distortion.
        """
        p = np.asarray(values, float)
        return replace(
            self,
            position_mm=p[:3].copy(),
            rotation=_rotation(p[3:6].tobytes()).copy(),
            focal_length_px=float(p[6]),
            principal_point_px=p[7:9].copy(),
            k1=float(p[9]),
        )

    def project(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Image positions of world points.

        Parameters
        ----------
        points_mm
            (n, 3) points, mm.

        Returns
        -------
        NDArray
            (n, 2) positions u, v, px; NaN for points behind the camera. They may lie outside the image.
        """
        local = (np.asarray(points_mm, float) - self.position_mm) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(local[:, 2:] > 0, local[:, :2] / local[:, 2:], np.nan)
        return self.at_slopes(xy)

    def at_slopes(self, slopes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Image positions of rays by their slopes.

        Parameters
        ----------
        slopes
            (n, 2) x / z and y / z in the camera's axes.

        Returns
        -------
        NDArray
            (n, 2) positions u, v, px.
        """
        if self.lens.one_term:
            radial = 1.0 + self.k1 * np.sum(slopes**2, axis=1, keepdims=True)
            return self.displaced(self.focal_length_px * radial * slopes + self.principal_point_px)
        return self.displaced(self.scales_px * self.lens.distorted(slopes, self.k1) + self.principal_point_px)

    def motion_px(self, other: Camera, points_mm: ArrayLike) -> float:
        """Distance between the images of points in two cameras.

        Parameters
        ----------
        other
            The other camera.
        points_mm
            (n, 3) points, mm; those behind a camera are left out.

        Returns
        -------
        float
            Root mean square difference of the coordinates, px.
        """
        return float(np.sqrt(np.nanmean((other.project(points_mm) - self.project(points_mm)) ** 2)))

    def displaced(self, image_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Image positions after the further distortion.

        Parameters
        ----------
        image_px
            (n, 2) positions that the ten parameters give, px.

        Returns
        -------
        NDArray
            (n, 2) positions, px.
        """
        if self.further_distortion is None:
            return image_px
        return image_px + self.further_distortion(image_px)

    def distorted_further(self, shift: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Camera:
        """Camera with one more displacement in its further distortion.

        Parameters
        ----------
        shift
            Function of image positions (n, 2), px, to displacements (n, 2), px.

        Returns
        -------
        Camera
            The camera; displacements add, both at the positions of the ten parameters.
        """
        first = self.further_distortion
        both = shift if first is None else lambda image_px: first(image_px) + shift(image_px)
        return replace(self, further_distortion=both)

    def closest_parameters(self) -> Camera:
        """Camera that projects alike, with the parameters that leave the least further distortion.

        The sum of squares over the image is minimised by Gauss-Newton. The position of the camera is kept.

        Returns
        -------
        Camera
            The camera; itself if it has no further distortion.
        """
        first = self.further_distortion
        if first is None:
            return self
        plain = replace(self, further_distortion=None)
        u, v = np.meshgrid(np.linspace(0, self.width_px - 1, _GRID), np.linspace(0, self.height_px - 1, _GRID))
        image = np.stack([u.ravel(), v.ravel()], axis=-1)
        points, target = plain.position_mm + plain.directions(*image.T), image + first(image)
        finite = np.isfinite(points).all(axis=1)
        points, target = points[finite], target[finite]
        closest = plain
        steps = _PARAMETER_STEP * np.eye(10)[3:]
        for _ in range(_CLOSEST_ROUNDS):
            image = closest.project(points)
            moved = [closest.with_parameters(closest.parameters + s).project(points) - image for s in steps]
            design = np.array([m.ravel() for m in moved]).T
            size = np.linalg.norm(design, axis=0)
            times = np.linalg.lstsq(design / size, (target - image).ravel(), rcond=None)[0] / size
            closest = closest.with_parameters(closest.parameters + times @ steps)

        def remaining(image_px: NDArray[np.float64]) -> NDArray[np.float64]:
            before = plain.project(plain.position_mm + closest.directions(*image_px.T))
            return before + first(before) - image_px

        return replace(closest, further_distortion=remaining)

    def undisplaced(self, image_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Inverse of ``displaced``, by fixed-point iteration.

        Parameters
        ----------
        image_px
            (n, 2) image positions, px.

        Returns
        -------
        NDArray
            (n, 2) positions before the further distortion, px. They are accurate where displacements change slowly.
        """
        if self.further_distortion is None:
            return image_px
        before = image_px
        for _ in range(_INVERSION_ROUNDS):
            before = image_px - self.further_distortion(before)
        return before

    def directions(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        """Directions of the rays through pixel positions.

        Parameters
        ----------
        u_px, v_px
            Pixel positions, px, of shapes that broadcast to (...).

        Returns
        -------
        NDArray
            (..., 3) unit vectors in world axes; NaN where no ray exists, see ``slopes``.
        """
        slopes = self.slopes(u_px, v_px)
        world = np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1) @ self.rotation
        return world / np.sqrt(np.einsum("...i,...i", world, world))[..., None]

    def slopes(self, u_px: ArrayLike, v_px: ArrayLike) -> NDArray[np.float64]:
        """Slopes of the rays through pixel positions, with the distortion inverted.

        Newton's method solves r (1 + k1 r^2) = R, with R the distorted radius over the focal length. ``Lens`` inverts
        the distortion of more terms.

        Parameters
        ----------
        u_px, v_px
            Pixel positions, px, of shapes that broadcast to (...).

        Returns
        -------
        NDArray
            (..., 2) x / z and y / z in the camera's axes. NaN where no ray exists: with k1 < 0 the largest image radius
            is 2 f / (3 sqrt(-3 k1)).
        """
        u, v = np.broadcast_arrays(np.asarray(u_px, float), np.asarray(v_px, float))
        image = np.stack([u, v], -1)
        image = self.undisplaced(image.reshape(-1, 2)).reshape(image.shape)
        if not self.lens.one_term:
            distorted = (image - self.principal_point_px) / self.scales_px
            return self.lens.undistorted(distorted.reshape(-1, 2), self.k1).reshape(distorted.shape)
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


# SciPy takes 0.2 ms for either conversion, and a fit asks for the same ones again and again


@lru_cache(maxsize=256)
def _turn(rotation: bytes) -> NDArray[np.float64]:
    """(3,) Rodrigues vector of R R0^T, degrees, from the numbers of R."""
    from scipy.spatial.transform import Rotation  # slow to import

    matrix = np.frombuffer(rotation).reshape(3, 3) @ REFERENCE_ROTATION.T
    return np.asarray(Rotation.from_matrix(matrix).as_rotvec(degrees=True))


@lru_cache(maxsize=256)
def _rotation(turn_deg: bytes) -> NDArray[np.float64]:
    """(3, 3) rotation R from the numbers of the Rodrigues vector of R R0^T, degrees."""
    from scipy.spatial.transform import Rotation  # slow to import

    return np.asarray(Rotation.from_rotvec(np.frombuffer(turn_deg), degrees=True).as_matrix() @ REFERENCE_ROTATION)
