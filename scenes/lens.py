"""Distortion of a lens beyond one radial term: OpenCV's polynomial and fisheye models.

Both map the slopes (x, y) = (X / Z, Y / Z) of a ray to distorted ones (x', y'). With r^2 = x^2 + y^2 and t = atan r:

- polynomial: x' = x q + 2 p1 x y + p2 (r^2 + 2 x^2), y' = y q + p1 (r^2 + 2 y^2) + 2 p2 x y, with
  q = 1 + k1 r^2 + k2 r^4 + k3 r^6;
- fisheye: (x', y') = (x, y) t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) / r.

A camera multiplies x' by its focal length and y' by the focal length times ``aspect``. The coefficient k1 belongs to
the camera, since it is one of its ten parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["LENS_TERMS", "PLAIN_LENS", "Lens"]

#: Fields of ``Lens`` that are numbers, by model.
LENS_TERMS = {"polynomial": ("k2", "k3", "p1", "p2", "aspect"), "fisheye": ("k2", "k3", "k4", "aspect")}

#: Samples of the radial function from which its inverse starts: a start within 1e-6 for the lenses of a camera.
_SAMPLES = 1024

#: Rounds of Newton's method from that start; the error squares in each.
_ROUNDS = 8

#: Largest error of the inverted slopes: some roundings of a double.
_ACCURACY = 1e-12

#: Largest slope of a ray that the inverse of the polynomial looks for, tangent of the field angle: 89.4 degrees.
_LARGEST_SLOPE = 100.0

#: Radius below which the fisheye's quotients by r are those on the axis: their error is its square.
_NEAR_AXIS = 1e-8


@dataclass(frozen=True)
class Lens:
    """Model of the distortion with its coefficients, apart from the camera's k1."""

    #: Formula that applies.
    model: Literal["polynomial", "fisheye"] = "polynomial"
    #: Second radial coefficient, without unit.
    k2: float = 0.0
    #: Third radial coefficient.
    k3: float = 0.0
    #: Fourth radial coefficient, of a fisheye only.
    k4: float = 0.0
    #: First decentring coefficient, of a polynomial only.
    p1: float = 0.0
    #: Second decentring coefficient, of a polynomial only.
    p2: float = 0.0
    #: Vertical focal length over the horizontal one, fy / fx, above 0.
    aspect: float = 1.0

    @property
    def one_term(self) -> bool:
        """Whether the camera's k1 is the whole distortion, and pixels are square."""
        return self == PLAIN_LENS

    def record(self) -> dict[str, str | float]:
        """Formula and terms of the lens.

        Returns
        -------
        dict
            Values for JSON, by field.
        """
        return {"model": self.model, **{term: float(getattr(self, term)) for term in LENS_TERMS[self.model]}}

    def distorted(self, slopes: NDArray[np.float64], k1: float) -> NDArray[np.float64]:
        """Distorted slopes of rays.

        Parameters
        ----------
        slopes
            (n, 2) slopes x and y.
        k1
            First radial coefficient.

        Returns
        -------
        NDArray
            (n, 2) distorted slopes.
        """
        square = np.sum(slopes**2, axis=1, keepdims=True)
        if self.model == "fisheye":
            return _fisheye_ratio(self._radial(k1), square) * slopes
        radial = 1.0 + square * (k1 + square * (self.k2 + square * self.k3))
        x, y = slopes[:, :1], slopes[:, 1:]
        across = 2 * self.p1 * x * y + self.p2 * (square + 2 * x**2)
        down = self.p1 * (square + 2 * y**2) + 2 * self.p2 * x * y
        return radial * slopes + np.concatenate([across, down], axis=1)

    def slope_derivatives(self, slopes: NDArray[np.float64], k1: float) -> NDArray[np.float64]:
        """Derivatives of the distorted slopes by the slopes.

        Parameters
        ----------
        slopes
            (n, 2) slopes x and y.
        k1
            First radial coefficient.

        Returns
        -------
        NDArray
            (n, 2, 2) derivatives; the last axis is the slope.
        """
        square = np.sum(slopes**2, axis=1)
        outer = slopes[:, :, None] * slopes[:, None, :]
        if self.model == "fisheye":
            ratio = _fisheye_ratio(self._radial(k1), square)
            # d(theta_d)/dr = (d theta_d / d theta) / (1 + r^2); the ratio's own derivative by r^2 follows from it.
            rise = _slope_of(self._radial(k1), np.arctan(np.sqrt(square))) / (1 + square)
            near = square < _NEAR_AXIS**2
            by_square = np.where(near, k1 - 1 / 3, (rise - ratio) / (2 * np.where(near, 1.0, square)))
            return ratio[:, None, None] * np.eye(2) + 2 * by_square[:, None, None] * outer
        ratio = 1.0 + square * (k1 + square * (self.k2 + square * self.k3))
        by_square = k1 + square * (2 * self.k2 + 3 * square * self.k3)
        x, y = slopes.T
        decentring = np.empty((len(slopes), 2, 2))
        decentring[:, 0, 0] = 2 * self.p1 * y + 6 * self.p2 * x
        decentring[:, 0, 1] = decentring[:, 1, 0] = 2 * self.p1 * x + 2 * self.p2 * y
        decentring[:, 1, 1] = 6 * self.p1 * y + 2 * self.p2 * x
        return ratio[:, None, None] * np.eye(2) + 2 * by_square[:, None, None] * outer + decentring

    def term_derivatives(self, slopes: NDArray[np.float64], term: str) -> NDArray[np.float64]:
        """Derivatives of the distorted slopes by one coefficient.

        Parameters
        ----------
        slopes
            (n, 2) slopes x and y.
        term
            "k1" to "k4", "p1" or "p2".

        Returns
        -------
        NDArray
            (n, 2) derivatives.
        """
        square = np.sum(slopes**2, axis=1, keepdims=True)
        x, y = slopes[:, :1], slopes[:, 1:]
        if term == "p1":
            return np.concatenate([2 * x * y, square + 2 * y**2], axis=1)
        if term == "p2":
            return np.concatenate([square + 2 * x**2, 2 * x * y], axis=1)
        power = int(term[1])
        if self.model == "fisheye":
            angle = np.arctan(np.sqrt(square))
            return _fisheye_ratio((1.0,), square) * angle ** (2 * power) * slopes
        return square**power * slopes

    def undistorted(self, distorted: NDArray[np.float64], k1: float) -> NDArray[np.float64]:
        """Slopes of rays from distorted slopes.

        The radial part is inverted first, from a table and by Newton's method. Newton's method in two dimensions adds
        the decentring.

        Parameters
        ----------
        distorted
            (n, 2) distorted slopes.
        k1
            First radial coefficient.

        Returns
        -------
        NDArray
            (n, 2) slopes. NaN where no ray exists: beyond the first radius at which the radial function stops rising,
            and beyond a quarter turn.
        """
        radius = np.hypot(*distorted.T)
        straight = self._radius(radius, k1)
        slopes = distorted * np.divide(straight, radius, out=np.ones_like(radius), where=radius > 0)[:, None]
        if self.p1 == 0 and self.p2 == 0:
            return slopes
        for _ in range(_ROUNDS):
            error = self.distorted(slopes, k1) - distorted
            if not np.any(np.abs(error) > _ACCURACY):
                break
            (a, b), (c, d) = np.moveaxis(self.slope_derivatives(slopes, k1), 0, -1)
            across, down = error.T
            slopes = slopes - np.stack([d * across - b * down, a * down - c * across], -1) / (a * d - b * c)[:, None]
        lost = ~(np.abs(self.distorted(slopes, k1) - distorted).max(axis=1) < 1e3 * _ACCURACY)
        lost |= ~self.reaches(slopes, k1)
        return np.where(lost[:, None], np.nan, slopes)

    def reaches(self, slopes: NDArray[np.float64], k1: float) -> NDArray[np.bool_]:
        """Whether the radial function still rises at the slopes.

        Parameters
        ----------
        slopes
            (n, 2) slopes x and y.
        k1
            First radial coefficient.

        Returns
        -------
        NDArray
            (n,) True where the lens forms an image of the ray.
        """
        radius = np.hypot(*slopes.T)
        return np.asarray((np.arctan(radius) if self.model == "fisheye" else radius) < self._turning(k1))

    def _radial(self, k1: float) -> tuple[float, ...]:
        """Coefficients of the radial function s (c0 + c1 s^2 + ...) of a slope or angle s."""
        return (1.0, k1, self.k2, self.k3, self.k4)

    def _turning(self, k1: float) -> float:
        """Smallest slope or angle at which the radial function stops rising; infinite without one."""
        rising = np.array([(2 * i + 1) * c for i, c in enumerate(self._radial(k1))])
        roots = np.roots(np.trim_zeros(rising[::-1], "f"))
        real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
        return float(np.sqrt(real.min())) if real.size else np.inf

    def _radius(self, distorted: NDArray[np.float64], k1: float) -> NDArray[np.float64]:
        """(n,) radii, slopes, from distorted radii; NaN where no ray exists."""
        radial = self._radial(k1)
        fisheye = self.model == "fisheye"
        end = min(self._turning(k1), np.pi / 2 if fisheye else _LARGEST_SLOPE)
        greatest = np.nanmax(distorted, initial=0.0)
        # a table over twice the radii that occur, so that its samples are dense there
        while not fisheye and end > 1e-3 and _value_of(radial, np.array(end / 2)) > greatest:
            end /= 2
        samples = np.linspace(0.0, end, _SAMPLES)
        values = _value_of(radial, samples)
        start = np.interp(distorted, values, samples, right=np.nan)
        for _ in range(_ROUNDS):
            step = (_value_of(radial, start) - distorted) / _slope_of(radial, start)
            start = np.clip(start - step, 0.0, end)
            if not np.any(np.abs(step) > _ACCURACY * 1e-3):
                break
        return np.tan(start) if fisheye else start


#: Lens of a camera whose distortion is one radial term.
PLAIN_LENS = Lens()


def _value_of(radial: tuple[float, ...], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Value s (c0 + c1 s^2 + ...) of a radial function."""
    return np.asarray(s * np.polynomial.polynomial.polyval(s**2, radial))


def _slope_of(radial: tuple[float, ...], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivative c0 + 3 c1 s^2 + ... of a radial function."""
    rising = [(2 * i + 1) * c for i, c in enumerate(radial)]
    return np.asarray(np.polynomial.polynomial.polyval(s**2, rising))


def _fisheye_ratio(radial: tuple[float, ...], square: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distorted radius over radius of a fisheye, from the squared radius; 1 on the axis."""
    radius = np.sqrt(square)
    value = _value_of(radial, np.arctan(radius))
    return np.divide(value, radius, out=np.full_like(radius, radial[0]), where=radius > _NEAR_AXIS)
