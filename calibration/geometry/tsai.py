"""Conversion between Tsai's camera parameters and ``Camera``.

Reference: R. Y. Tsai, IEEE J. Robotics and Automation 3, 1987.

Tsai's radial term is the inverse relation: on the sensor, in mm, the undistorted position is the distorted one
times 1 + kappa1 r_d^2; in ``Camera`` the distorted position is the undistorted one times 1 + k1 r^2. The two are
not equivalent over a whole image; the conversion is a least-squares fit and states the remaining difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import ArrayLike, NDArray

__all__ = ["Conversion", "TsaiCamera", "from_tsai", "to_tsai"]

T = TypeVar("T", Camera, "TsaiCamera")

#: Number of image positions along each side over which a conversion is fitted and its error computed.
GRID = 33


@dataclass(frozen=True, eq=False)
class TsaiCamera:
    """A camera in Tsai's parameters."""

    #: Width of the image, px.
    width_px: int
    #: Height of the image, px.
    height_px: int
    #: Focal length f, mm.
    focal_length_mm: float
    #: (2,) centre of distortion (C_x, C_y), px; (0, 0) is the centre of the top-left pixel.
    centre_px: NDArray[np.float64]
    #: Scale factor s_x of the horizontal pitch, without unit.
    horizontal_scale: float
    #: Radial coefficient, mm^-2; positive for barrel distortion.
    kappa1_per_mm2: float
    #: (3, 3) world to camera axes (x right, y down, z forward).
    rotation: NDArray[np.float64]
    #: (3,) translation, mm: camera = rotation @ world + translation.
    translation_mm: NDArray[np.float64]
    #: (2,) effective pitch of the stored pixels (d_x', d_y), mm.
    pixel_pitch_mm: NDArray[np.float64]

    def project(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Image positions of world points.

        Parameters
        ----------
        points_mm
            (n, 3) world positions, mm.

        Returns
        -------
        NDArray
            (n, 2) pixel positions (u, v), px; NaN behind the camera or where the distortion has no solution.
        """
        local = np.asarray(points_mm, float) @ self.rotation.T + self.translation_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            direction = np.where(local[:, 2:] > 0, local[:, :2] / local[:, 2:], np.nan)
        return self._distorted(self.focal_length_mm * direction) / self._mm_per_px + self.centre_px

    def undistorted_mm(self, image_px: ArrayLike) -> NDArray[np.float64]:
        """Undistorted positions on the sensor of image positions.

        Parameters
        ----------
        image_px
            (n, 2) pixel positions (u, v), px.

        Returns
        -------
        NDArray
            (n, 2) undistorted positions from the centre, mm.
        """
        distorted = (np.asarray(image_px, float) - self.centre_px) * self._mm_per_px
        return distorted * (1 + self.kappa1_per_mm2 * np.sum(distorted**2, axis=-1, keepdims=True))

    @property
    def _mm_per_px(self) -> NDArray[np.float64]:
        return self.pixel_pitch_mm / np.array([self.horizontal_scale, 1.0])

    def _distorted(self, undistorted: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distorted positions: the inverse of 1 + kappa1 r_d^2 by Newton's method, central branch."""
        radius = np.linalg.norm(undistorted, axis=-1, keepdims=True)
        distorted = radius / np.cbrt(1 + np.abs(self.kappa1_per_mm2) * radius**2)
        for _ in range(30):
            slope = 1 + 3 * self.kappa1_per_mm2 * distorted**2
            distorted = distorted - (distorted * (1 + self.kappa1_per_mm2 * distorted**2) - radius) / slope
        # With negative kappa1 there is no solution beyond the turning point.
        slope = 1 + 3 * self.kappa1_per_mm2 * distorted**2
        error = np.abs(distorted * (1 + self.kappa1_per_mm2 * distorted**2) - radius)
        good = (slope > 0) & (error <= 1e-9 * (1 + radius))
        ratio = np.divide(distorted, radius, out=np.ones_like(radius), where=radius > 0)
        return undistorted * np.where(good, ratio, np.nan)


@dataclass(frozen=True, eq=False)
class Conversion(Generic[T]):
    """A converted camera and the difference of its image positions from those of the original.

    The difference includes the effect of pixels that are not square (s_x d_y / d_x' not 1), since ``Camera`` has only
    square pixels.
    """

    #: Converted camera.
    camera: T
    #: Root mean square length of the difference over an even grid of the image, px.
    rms_px: float
    #: Largest length of the difference, px.
    largest_px: float


def from_tsai(tsai: TsaiCamera) -> Conversion[Camera]:
    """The ``Camera`` closest to Tsai's: same pose and centre, fitted focal length and k1.

    Least squares of u - c = f x + f k1 r^2 x, linear in f and f k1, at the exact directions x of a grid of pixels. The
    covariance is None.

    Parameters
    ----------
    tsai
        Camera in Tsai's parameters.

    Returns
    -------
    Conversion
        Closest ``Camera`` and its difference from `tsai`.

    Raises
    ------
    InputError
        For lengths not above 0 and for a matrix that is not a rotation.
    """
    for name, value in (
        ("focal_length_mm", tsai.focal_length_mm),
        ("s_x", tsai.horizontal_scale),
        ("d_x", tsai.pixel_pitch_mm[0]),
        ("d_y", tsai.pixel_pitch_mm[1]),
    ):
        if not value > 0:
            raise InputError(f"Tsai camera: {name}", f"{value:g}", "a number above 0")
    orthonormal = np.allclose(tsai.rotation @ tsai.rotation.T, np.eye(3), atol=1e-3)
    if not orthonormal or np.linalg.det(tsai.rotation) < 0:
        raise InputError("Tsai camera: R", "a matrix that is not a rotation", "orthonormal, right-handed rows")
    image = _grid(tsai.width_px, tsai.height_px)
    direction = tsai.undistorted_mm(image) / tsai.focal_length_mm
    cubic = direction * np.sum(direction**2, axis=1, keepdims=True)
    terms = np.stack([direction.ravel(), cubic.ravel()], axis=1)
    focal, product = np.linalg.lstsq(terms, (image - tsai.centre_px).ravel(), rcond=None)[0]
    # Published matrices are rounded: use the nearest rotation.
    left, _, right = np.linalg.svd(tsai.rotation)
    rotation = left @ right
    camera = Camera(
        tsai.width_px,
        tsai.height_px,
        float(focal),
        tsai.centre_px.copy(),
        float(product / focal),
        rotation,
        -rotation.T @ tsai.translation_mm,
    )
    return _with_difference(camera, (terms @ [focal, product]).reshape(-1, 2) + tsai.centre_px - image)


def to_tsai(camera: Camera, pixel_pitch_mm: float) -> Conversion[TsaiCamera]:
    """Tsai's parameters closest to a ``Camera``, for square pixels of a pitch; s_x = 1.

    Least squares of f x - kappa1 r_d^2 X_d = X_d, linear in f and kappa1, over a grid of pixels.

    Parameters
    ----------
    camera
        Camera to convert.
    pixel_pitch_mm
        Pitch of the pixels, mm.

    Returns
    -------
    Conversion
        Closest Tsai camera and its difference from `camera`.

    Raises
    ------
    InputError
        For a pitch not above 0.
    """
    if not pixel_pitch_mm > 0:
        raise InputError("pixel pitch", f"{pixel_pitch_mm:g} mm", "a number above 0")
    image = _grid(camera.width_px, camera.height_px)
    local = camera.directions(image[:, 0], image[:, 1]) @ camera.rotation.T
    direction = local[:, :2] / local[:, 2:]
    distorted = (image - camera.principal_point_px) * pixel_pitch_mm
    cubic = distorted * np.sum(distorted**2, axis=1, keepdims=True)
    terms = np.stack([direction.ravel(), -cubic.ravel()], axis=1)
    scale = np.linalg.norm(terms, axis=0)
    focal, kappa1 = np.linalg.lstsq(terms / scale, distorted.ravel(), rcond=None)[0] / scale
    tsai = TsaiCamera(
        camera.width_px,
        camera.height_px,
        float(focal),
        camera.principal_point_px.copy(),
        1.0,
        float(kappa1),
        camera.rotation.copy(),
        -camera.rotation @ camera.position_mm,
        np.full(2, pixel_pitch_mm),
    )
    world = camera.position_mm + np.column_stack([direction, np.ones(len(direction))]) @ camera.rotation
    return _with_difference(tsai, tsai.project(world) - image)


def _grid(width_px: int, height_px: int) -> NDArray[np.float64]:
    """(GRID^2, 2) pixel positions over the image."""
    u, v = np.meshgrid(np.linspace(0, width_px - 1, GRID), np.linspace(0, height_px - 1, GRID))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _with_difference(camera: T, difference_px: NDArray[np.float64]) -> Conversion[T]:
    """Conversion with the rms and the largest length of the differences (n, 2), px."""
    length = np.linalg.norm(difference_px, axis=1)
    return Conversion(camera, float(np.sqrt(np.mean(length**2))), float(length.max()))
