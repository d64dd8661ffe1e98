"""Parameters of a camera that a fit determines: pose, intrinsics, terms of the lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.lens import PLAIN_LENS, Lens
from numpy.typing import NDArray

from .camera_jacobian import parameter_jacobian, term_jacobian

__all__ = ["ONE_TERM", "POSE", "LensModel"]

#: Parameters of a pose in PARAMETER_NAMES.
POSE = slice(0, 6)

#: Positions of the intrinsics in PARAMETER_NAMES: focal length, principal point, k1.
_INTRINSICS = (6, 7, 8, 9)

#: Standard deviation of a stated focal length, relative: the last digit of a calibration with four.
_STATED_FOCAL_LENGTH = 1e-4

#: Standard deviation of a stated k1: it moves a point at the slope 0.5 by a hundredth of a pixel in 1000.
_STATED_K1 = 1e-4

#: Third of the cube in tan t = t + t^3 / 3 + ...: what a fisheye's k1 exceeds a polynomial's by.
_FISHEYE_K1 = 1 / 3


@dataclass(frozen=True)
class LensModel:
    """Formula of a lens with the parameters that are fitted."""

    #: Formula, and the values of terms that are not fitted.
    lens: Lens = PLAIN_LENS
    #: Terms of the lens that are fitted, besides k1.
    terms: tuple[str, ...] = ()
    #: Stated focal length, px, which is not fitted; None where it is fitted.
    focal_length_px: float | None = None
    #: Stated k1, which is not fitted; None where it is fitted.
    k1: float | None = None

    @property
    def states_something(self) -> bool:
        """Whether the focal length or k1 is stated."""
        return self.focal_length_px is not None or self.k1 is not None

    @property
    def intrinsics(self) -> list[int]:
        """Positions of the fitted intrinsics in PARAMETER_NAMES."""
        values = (self.focal_length_px, None, None, self.k1)
        return [i for i, value in zip(_INTRINSICS, values, strict=True) if value is None]

    @property
    def shared(self) -> int:
        """Number of fitted parameters that all pictures of the camera share."""
        return len(self.intrinsics) + len(self.terms)

    @property
    def count(self) -> int:
        """Number of fitted parameters of one picture: six of the pose and the shared ones."""
        return 6 + self.shared

    def start(self, camera: Camera) -> Camera:
        """Camera of this formula that projects nearly like another one.

        Parameters
        ----------
        camera
            Camera of any formula.

        Returns
        -------
        Camera
            Camera with this formula and the stated parameters.
        """
        k1, focal = self.k1, camera.focal_length_px if self.focal_length_px is None else self.focal_length_px
        if k1 is None:
            formulas = [1.0 if lens.model == "fisheye" else 0.0 for lens in (self.lens, camera.lens)]
            k1 = camera.k1 + _FISHEYE_K1 * (formulas[0] - formulas[1])
        return replace(
            camera, lens=self.lens, k1=k1, focal_length_px=camera.focal_length_px if focal is None else focal
        )

    def values(self, camera: Camera) -> NDArray[np.float64]:
        """Fitted parameters of a camera.

        Parameters
        ----------
        camera
            The camera.

        Returns
        -------
        NDArray
            (count,) pose, intrinsics, terms.
        """
        parameters = camera.parameters
        terms = [getattr(camera.lens, term) for term in self.terms]
        return np.concatenate([parameters[POSE], parameters[self.intrinsics], terms])

    def applied(self, camera: Camera, values: NDArray[np.float64]) -> Camera:
        """Camera with other values of the fitted parameters.

        Parameters
        ----------
        camera
            Camera with the other parameters.
        values
            (count,) pose, intrinsics, terms.

        Returns
        -------
        Camera
            The camera, with the same covariance.
        """
        changed = camera.with_parameters(self._ten(camera, values))
        terms: dict[str, Any] = dict(zip(self.terms, values[6 + len(self.intrinsics) :].tolist(), strict=True))
        return replace(changed, lens=replace(changed.lens, **terms)) if terms else changed

    def jacobian(
        self, camera: Camera, points_mm: NDArray[np.float64], values: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Derivatives of projected positions by the fitted parameters.

        Parameters
        ----------
        camera
            The camera.
        points_mm
            (n, 3) points, mm.
        values
            (count,) values to use; None for the camera's. See ``parameter_jacobian``.

        Returns
        -------
        NDArray
            (2 n, count) derivatives, px per unit of the parameter.
        """
        if values is None:
            values = self.values(camera)
        ten = self._ten(camera, values)
        camera = self.applied(camera, values)
        by_ten = parameter_jacobian(camera, points_mm, ten)
        if not self.terms and not self.states_something:
            return by_ten
        return np.hstack([by_ten[:, POSE], by_ten[:, self.intrinsics], term_jacobian(camera, points_mm, self.terms)])

    def covariance(self, camera: Camera, fitted: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance of the ten parameters from that of the fitted ones.

        Parameters
        ----------
        camera
            The camera.
        fitted
            (count, count) covariance of the fitted parameters.

        Returns
        -------
        NDArray
            (10, 10) covariance; stated parameters have a small variance.
        """
        positions = [*range(6), *self.intrinsics]
        covariance = np.diag([0.0] * 6 + [(_STATED_FOCAL_LENGTH * camera.focal_length_px) ** 2, 0, 0, _STATED_K1**2])
        covariance[np.ix_(positions, positions)] = fitted[: len(positions), : len(positions)]
        return covariance

    def term_sigmas(self, fitted: NDArray[np.float64]) -> dict[str, float]:
        """Standard deviations of the fitted terms.

        Parameters
        ----------
        fitted
            Covariance of the fitted parameters, the terms last.

        Returns
        -------
        dict
            By term.
        """
        sigmas = np.sqrt(np.diag(fitted))[len(fitted) - len(self.terms) :]
        return dict(zip(self.terms, sigmas.tolist(), strict=True))

    def with_terms(self, terms: Sequence[str]) -> LensModel:
        """The same model with other fitted terms.

        Parameters
        ----------
        terms
            Names of fields of ``Lens``.

        Returns
        -------
        LensModel
            The model.
        """
        return replace(self, terms=tuple(terms))

    def _ten(self, camera: Camera, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(10,) parameters of a camera with the fitted values."""
        ten = camera.parameters
        ten[POSE] = values[:6]
        ten[self.intrinsics] = values[6 : 6 + len(self.intrinsics)]
        return ten


#: Today's lens: k1 alone, fitted with the other nine parameters.
ONE_TERM = LensModel()
