"""Positions of a scene's corners in a photograph, from clicks and the edges around them.

Clicks on six corners or more determine a first camera, which the edges of the whole scene correct
(``align_photograph``). By it, the faces that pixel p around a corner shows are known, as shares w_k(p). The photograph
there is fitted by

    I(p) = sum_k w_k(p - d) B_k(p),

with a polynomial B_k as the brightness of each face k. The shift d with the least misfit is the corner's. Where that
does not determine it, as at the foot of a block, light is added that is no polynomial. A face in half shadow counts
twice: whole, and times the part of the lamps that each of its points sees. Each other face at the corner also shines on
it: its form factor from each point, times one level. What remains bends brightness near an edge. So polynomials
of several degrees are fitted to squares of several sizes. The mean of their shifts is the position, and their scatter
is a part of its error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from cboxlab.calibration.geometry import CameraFit, SurveyedPoints, fit_camera
from cboxlab.rendering.visibility import MARGIN_PX, RAYS_ACROSS, FaceLight, faces_around, light_around
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.ndimage import (
    gaussian_filter,
    map_coordinates,
    uniform_filter,
)

from .edge_alignment import EDGE_BIAS_PX, align_photograph
from .edge_offsets import are_visible

__all__ = ["Corner", "LocatedCorners", "locate_corners", "scene_corners"]

#: Half the side of the largest square of pixels that is fitted, px: each face then has a dozen pixels or more.
_REACH_PX = 7

#: Degrees of brightness and halves of the sides of squares, px, whose shifts are averaged: where brightness is no
#: polynomial, they differ. The first one is fitted first.
_FITS = ((2, 7), (2, 5), (1, 4), (3, 7))

#: Weight that holds brightness at zero, per pixel: enough where a face is hardly in the square.
_RIDGE = 1e-8

#: Smallest share of a square that is in the picture: corners near its border have a third or more.
_SMALLEST_PART = 0.3

#: Largest shift from the position by the corrected camera, px.
_SEARCH_PX = 1.5

#: Blurs of the lens that are tried first (standard deviation), px; the pixel's width is added. Each round halves the
#: distance between them.
_BLURS_PX = (0.0, 0.3, 0.6, 0.9, 1.2)

#: Largest standard deviation of a corner by its edges, px; a click is as good as a worse one.
_LARGEST_SIGMA_PX = 0.15

#: Most rounds of search and fit.
_ROUNDS = 4

#: Largest change of a corner in the last round, px.
_LARGEST_CHANGE_PX = 0.02

#: Standard deviation of corners that all squares share, px: shading at an edge, and the camera that shows the faces. In
#: four simulated photographs whose camera is known, corners scatter by so much more than their squares do.
_COMMON_SIGMA_PX = 0.04

#: Largest last step of a fit, px.
_SETTLED_PX = 0.002

#: Most steps of a fit; four are typical.
_MAX_STEPS = 12

#: Most halvings of a step that does not lessen the misfit.
_MAX_HALVINGS = 5

#: Step of numerical derivatives, px: shares are known to a few hundredths.
_STEP_PX = 0.05

#: Smallest share of a face in the square of pixels; smaller ones are joined to their neighbours by the fit's weights.
_SMALLEST_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Corner:
    """Corner of a scene."""

    #: Unique identifier, for points.csv.
    id: str
    #: Names of the surfaces that meet there.
    name: str
    #: (3,) position in the box, mm.
    position_mm: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LocatedCorners:
    """Corners of a photograph, after the search along their edges."""

    #: Identifiers, positions in the box, and positions in the image.
    points: SurveyedPoints
    #: (n,) True where the edges determine the position; the others are as clicked.
    by_edges: NDArray[np.bool_]
    #: (n,) standard deviation of a position from the scatter of its edges, px; NaN as clicked.
    sigma_px: NDArray[np.float64]
    #: Camera fitted to the positions; None with too few of them.
    fit: CameraFit | None
    #: Reason for no camera, or why no position is refined; else empty.
    reason: str = ""
    #: (n) reasons why positions are not refined; empty texts for the others.
    reasons: tuple[str, ...] = ()


def scene_corners(scene: Scene) -> tuple[Corner, ...]:
    """Corners of a scene's surfaces, without those of the lamp and its opening.

    Parameters
    ----------
    scene
        Model of the scene.

    Returns
    -------
    tuple of Corner
        In the order of the surfaces.
    """
    lamps = len(scene.all_surfaces) - len(scene.surfaces)
    lamp = {tuple(corner.round(2)) for s in scene.all_surfaces[-lamps:] for corner in s.vertices_mm} if lamps else set()
    names: dict[tuple[float, ...], list[str]] = {}
    for surface in scene.surfaces:
        for corner in np.unique(surface.vertices_mm.round(2), axis=0):
            names.setdefault(tuple(corner.tolist()), []).append(surface.name)
    pairs = [(corner, surfaces) for corner, surfaces in names.items() if corner not in lamp]
    return tuple(
        Corner(f"c{number:02d}", ", ".join(surfaces), np.array(corner))
        for number, (corner, surfaces) in enumerate(pairs, 1)
    )


def locate_corners(
    photograph: NDArray[np.float64],
    scene: Scene,
    clicked: SurveyedPoints,
    *,
    by_edges: bool = True,
) -> LocatedCorners:
    """Positions of clicked corners by the edges around them, and the camera of them.

    Parameters
    ----------
    photograph
        (y, x) any scale; NaN marks masked pixels.
    scene
        Model of the scene.
    clicked
        Corners of the scene with rough positions in the image, within about 2 px.
    by_edges
        Whether to refine the positions; otherwise they stay as clicked.

    Returns
    -------
    LocatedCorners
        As clicked, without a camera, where the corners do not determine one.
    """
    count = len(clicked.ids)
    unrefined = ("",) * count
    corners = LocatedCorners(
        clicked, np.zeros(count, bool), np.full(count, np.nan), *_camera(clicked, photograph), unrefined
    )
    if corners.fit is None or not by_edges:
        return corners
    try:
        camera, _ = align_photograph(photograph, corners.fit.camera, scene)
    except ValueError as error:
        return replace(corners, reason=str(error))
    blurs: tuple[float, ...] = _BLURS_PX
    step = blurs[1] / 2
    for _ in range(_ROUNDS):
        in_view = are_visible(scene, camera, clicked.points_mm)
        squares = {
            index: _Square(photograph, scene, camera, clicked.points_mm[index]) for index in np.flatnonzero(in_view)
        }
        blur = _blur([*squares.values()], blurs)
        blurs, step = (max(blur - step, 0.0), blur, blur + step), step / 2
        image, sigma = clicked.image_px.copy(), np.full(count, np.nan)
        reasons = ["hidden behind a surface"] * count
        for index, square in squares.items():
            position, scatter = square.position(blur)
            reasons[index] = square.reason
            if scatter < _LARGEST_SIGMA_PX:
                image[index], sigma[index] = position, scatter
            elif square.is_usable:
                reasons[index] = "its edges do not determine it: shadows and reflected light hide them"
        refined = np.isfinite(sigma)
        change = np.abs(image - corners.points.image_px).max()
        points = replace(clicked, image_px=image)
        corners = LocatedCorners(points, refined, sigma, *_camera(points, photograph), tuple(reasons))
        by_refined, _ = _camera(_subset(points, refined), photograph)
        if by_refined is not None:
            camera = by_refined.camera
            if change < _LARGEST_CHANGE_PX:
                break
    if corners.fit is None:
        return corners
    wrong = corners.by_edges & ~corners.fit.in_use
    image = np.where(wrong[:, None], clicked.image_px, corners.points.image_px)
    points = replace(clicked, image_px=image)
    sigma = np.where(wrong, np.nan, corners.sigma_px)
    pairs = zip(wrong, corners.reasons, strict=True)
    why = tuple("its edges disagree with the other corners" if is_wrong else text for is_wrong, text in pairs)
    return LocatedCorners(points, corners.by_edges & ~wrong, sigma, *_camera(points, photograph), why)


def _subset(points: SurveyedPoints, members: NDArray[np.bool_]) -> SurveyedPoints:
    """Some of the points."""
    ids = tuple(name for name, use in zip(points.ids, members, strict=True) if use)
    return SurveyedPoints(ids, points.points_mm[members], points.image_px[members], points.source)


def _camera(points: SurveyedPoints, photograph: NDArray[np.float64]) -> tuple[CameraFit | None, str]:
    """Camera fitted to points; None with the reason if they do not determine it."""
    height, width = photograph.shape
    try:
        return fit_camera(points, width_px=width, height_px=height), ""
    except InputError as error:
        return None, str(error)


def _blur(squares: Sequence[_Square], blurs: Sequence[float]) -> float:
    """Blur of the largest likelihood, where the noise of each square is free.

    A square that no shift explains, such as a foot in its shadow, then has little influence.
    """
    usable = [square for square in squares if square.is_usable]
    return min(blurs, key=lambda blur: sum(square.log_misfit(blur) for square in usable))


class _Square:
    """Square of pixels around a corner, with the faces that are seen there by a camera."""

    def __init__(
        self, photograph: NDArray[np.float64], scene: Scene, camera: Camera, corner_mm: NDArray[np.float64]
    ) -> None:
        height, width = photograph.shape
        self._expected = camera.project(corner_mm[None])[0]
        self.is_usable, self.reason = False, "outside the picture"
        if not np.isfinite(self._expected).all() or not (np.abs(self._expected) < 2 * (height + width)).all():
            return
        middle = np.round(self._expected).astype(int)
        v, u = np.mgrid[-_REACH_PX : _REACH_PX + 1, -_REACH_PX : _REACH_PX + 1]
        rows, columns = v + middle[1], u + middle[0]
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        values = np.full(inside.shape, np.nan)
        values[inside] = photograph[rows[inside], columns[inside]]
        usable = np.isfinite(values)
        if usable.mean() < _SMALLEST_PART:
            self.reason = f"{usable.mean():.0%} of the pixels around it can be used; {_SMALLEST_PART:.0%} are needed"
            return
        self._at = np.stack([v[usable], u[usable]]).astype(float)
        self._measured = values[usable]
        self._faces = faces_around(scene, camera, middle)
        self._further_light = partial(light_around, scene, camera, middle, corner_mm)
        self._lit: list[FaceLight] = []
        self._shares: dict[float, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
        self.is_usable = len(np.unique(self._faces)) > 1
        self.reason = "" if self.is_usable else "no edge near it"

    def _of_blur(self, blur: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if blur not in self._shares:
            self._shares[blur] = _blurred(self._faces, self._lit, blur)
        return self._shares[blur]

    def _fit(
        self, blur: float, degree: int, reach: float, start: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], float, float]:
        """Shift of the least misfit, its standard deviation by noise, sum of squares."""
        near = np.abs(self._at).max(axis=0) <= reach
        at, measured = self._at[:, near], self._measured[near]
        shares, levels = self._of_blur(blur)
        y, x = at / reach
        powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        brightness = np.stack([y**i * x**j for i, j in powers], axis=1)

        def misfit(shift: NDArray[np.float64]) -> NDArray[np.float64]:
            index = (at - shift[::-1, None] + MARGIN_PX) * RAYS_ACROSS + (RAYS_ACROSS - 1) / 2
            parts = [map_coordinates(share, index, order=1, mode="nearest")[:, None] for share in (*shares, *levels)]
            design = np.concatenate(
                [*(part * brightness for part in parts[: len(shares)]), *parts[len(shares) :]], axis=1
            )
            square = design.T @ design
            square[np.diag_indices_from(square)] += _RIDGE * measured.size
            level = np.linalg.solve(square, design.T @ measured)
            return np.asarray(measured - design @ level, np.float64)

        if start is None:
            starts = 0.5 * _SEARCH_PX * np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1])).reshape(2, -1).T
            start = min(starts, key=lambda shift: float(np.sum(misfit(shift) ** 2)))
        shift, jacobian, residual = _least_squares(misfit, start)
        cost = float(residual @ residual)
        freedom = max(measured.size - len(powers) * len(shares) - len(levels) - 2, 1)
        variance = float(np.trace(np.linalg.pinv(jacobian.T @ jacobian))) * cost / freedom / 2
        outside = np.abs(shift).max() > _SEARCH_PX
        return shift, np.inf if outside or variance == 0 else float(np.sqrt(variance)), cost

    def log_misfit(self, blur: float) -> float:
        """Logarithm of the misfit with a blur: -2 log likelihood by pixel, and a constant."""
        return float(np.log(max(self._fit(blur, *_FITS[0], np.zeros(2))[2], 1e-300)))

    def position(self, blur: float) -> tuple[NDArray[np.float64], float]:
        """Position (u, v) of the corner and its standard deviation, px; else infinite.

        Further light is computed only where polynomials alone do not determine the position. What of it is unknown
        shifts edges where two faces meet, so that the error there is larger.
        """
        if not self.is_usable:
            return self._expected, np.inf
        position, scatter = self._mean_position(blur)
        if scatter < _LARGEST_SIGMA_PX:
            return position, scatter
        lights = self._further_light()
        for some in ([light for light in lights if light.is_factor], lights):
            if len(some) > len(self._lit):
                self._lit, self._shares = some, {}
                position, scatter = min((position, scatter), self._mean_position(blur), key=lambda each: each[1])
        return position, float(np.hypot(scatter, EDGE_BIAS_PX))

    def _mean_position(self, blur: float) -> tuple[NDArray[np.float64], float]:
        first = self._fit(blur, *_FITS[0])
        fits = [first, *(self._fit(blur, *form, first[0]) for form in _FITS[1:])]
        shifts = np.array([shift for shift, _, _ in fits])
        spread = float(np.sqrt(np.sum((shifts - shifts.mean(axis=0)) ** 2) / (2 * (len(fits) - 1))))
        by_noise = max(sigma for _, sigma, _ in fits)
        return self._expected + shifts.mean(axis=0), float(np.linalg.norm([spread, by_noise, _COMMON_SIGMA_PX]))


def _least_squares(
    misfit: Callable[[NDArray[np.float64]], NDArray[np.float64]], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Shift (2,) of the least sum of squares by Gauss-Newton; Jacobian and misfit there."""
    shift, residual = start.astype(float), misfit(start)
    jacobian: NDArray[np.float64] = np.zeros((residual.size, 2))
    for _ in range(_MAX_STEPS):
        jacobian = np.stack([(misfit(shift + _STEP_PX * axis) - residual) / _STEP_PX for axis in np.eye(2)], axis=1)
        step = -np.linalg.pinv(jacobian) @ residual
        step *= min(1.0, 1 / max(float(np.abs(step).max()), 1e-12))
        for _ in range(_MAX_HALVINGS):
            moved = misfit(shift + step)
            if moved @ moved < residual @ residual:
                break
            step = step / 2
        else:
            break
        shift, residual = shift + step, moved
        if np.abs(step).max() < _SETTLED_PX or np.abs(shift).max() > _SEARCH_PX:
            break
    return shift, jacobian, residual


def _blurred(
    faces: NDArray[np.int64], lights: Sequence[FaceLight], blur_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(k, n, n) shares of faces around each ray, within pixel and blur, and of their lamp light.

    Then (m, n, n) shares times other light.
    """
    numbers, counts = np.unique(faces, return_counts=True)
    large = numbers[counts > _SMALLEST_SHARE * faces.size]
    shares = [(faces == k).astype(float) for k in large]
    of_large = [light for light in lights if light.face in large]
    shares += [(faces == light.face) * light.shape for light in of_large if light.is_factor]
    levels = [(faces == light.face) * light.shape for light in of_large if not light.is_factor]
    blurred = [gaussian_filter(uniform_filter(part, RAYS_ACROSS), blur_px * RAYS_ACROSS) for part in shares + levels]
    return np.array(blurred[: len(shares)]), np.array(blurred[len(shares) :])
