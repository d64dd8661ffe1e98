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
from cboxlab.rendering.visibility import part_of_lamps, point_to_polygon
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray
from scipy.ndimage import (
    distance_transform_edt,
    gaussian_filter,
    map_coordinates,
    maximum_filter,
    minimum_filter,
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

#: Pixels around a corner whose faces are computed, px: the square, the shift and the blur.
_MARGIN_PX = 13

#: Rays across a pixel, odd so that one is at its centre. An edge along the rows is then known to 0.06 px.
_RAYS_ACROSS = 9

#: Distance across a pixel of points at which the light of the lamps is computed, as a part of 1: three a pixel.
_LIGHT_ACROSS = 3

#: Smallest scatter of the part of the lamps that a face sees, for a shadow on it.
_LEAST_SHADOW = 0.02

#: Smallest scatter of the form factor to another face: a smaller one is as a polynomial.
_LEAST_NEAR_LIGHT = 0.01

#: Distance of a plane at which a point lies in it, mm: its normal is rounded.
_IN_PLANE_MM = 0.5

#: Distance towards the camera at which light is computed, as a part of the way: else a face would shade itself.
_OFF_THE_FACE = 1e-5

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
class _Light:
    """Light on a face around a corner that is no polynomial."""

    #: Number of the face.
    face: int
    #: (n, n) the light at each ray; beyond the rim of the face, as at its nearest point.
    shape: NDArray[np.float64]
    #: Whether it multiplies the polynomial of the face's brightness; otherwise it has one level.
    is_factor: bool


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
        self._faces = _faces_around(scene, camera, middle)
        self._further_light = partial(_light_around, scene, camera, middle, corner_mm)
        self._lit: list[_Light] = []
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
            index = (at - shift[::-1, None] + _MARGIN_PX) * _RAYS_ACROSS + (_RAYS_ACROSS - 1) / 2
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


def _faces_around(scene: Scene, camera: Camera, middle: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, n) number of the flat face that each ray around a pixel meets first; 0 for none."""
    pixels = 2 * _MARGIN_PX + 1
    first = middle - _MARGIN_PX - 0.5
    # by rays at the pixels' corners: pixels in which an edge may be; only there are all rays traced
    across = np.arange(-1, pixels + 2)
    coarse = _first_met(scene, camera, middle, *np.meshgrid(first[0] + across, first[1] + across))[0]
    is_mixed = maximum_filter(coarse, 4, origin=-1) != minimum_filter(coarse, 4, origin=-1)
    rays = (np.arange(_RAYS_ACROSS) + 0.5) / _RAYS_ACROSS
    row, column = np.nonzero(is_mixed[:pixels, :pixels])
    number = np.repeat(np.repeat(coarse[1:-2, 1:-2], _RAYS_ACROSS, axis=0), _RAYS_ACROSS, axis=1)
    u = first[0] + column[:, None, None] + rays
    v = first[1] + row[:, None, None] + rays[:, None]
    blocks = number.reshape(pixels, _RAYS_ACROSS, pixels, _RAYS_ACROSS).swapaxes(1, 2)
    blocks[row, column] = _first_met(scene, camera, middle, *np.broadcast_arrays(u, v))[0]
    return number


def _first_met(
    scene: Scene, camera: Camera, middle: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Number of the flat face that each ray (u, v) meets first, 0 for none; (n, 3) where; (k, 4) planes of the faces.

    A plane is the normal n and n . p, rounded.
    """
    direction = camera.directions(u.ravel(), v.ravel())
    nearest, number = np.full(len(direction), np.inf), np.zeros(len(direction), np.int64)
    flat: dict[tuple[float, ...], int] = {}
    for surface in scene.all_surfaces:
        for face in surface.faces:
            corners = surface.vertices_mm[face]
            if not _may_be_seen(camera, corners, middle):
                continue
            a, b, c = corners
            normal = np.cross(b - a, c - a)
            length = float(np.linalg.norm(normal))
            if length == 0:
                continue
            key = (*(normal / length).round(3), round(float(a @ normal) / length, 1))
            from_a = camera.position_mm - a
            turned = np.cross(from_a, b - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = direction @ np.cross(c - a, b - a)
                first, second = direction @ np.cross(c - a, from_a) / slope, direction @ turned / slope
                distance = float((c - a) @ turned) / slope
            hit = (first >= -1e-9) & (second >= -1e-9) & (first + second <= 1 + 1e-9) & (distance > 1e-6)
            nearer = hit & (distance < nearest)
            nearest[nearer] = distance[nearer]
            number[nearer] = flat.setdefault(key, len(flat) + 1)
    travelled = np.where(number > 0, nearest, 0.0) * (1 - _OFF_THE_FACE)
    planes = np.array([*flat]).reshape(-1, 4)
    return number.reshape(u.shape), camera.position_mm + travelled[:, None] * direction, planes


def _may_be_seen(camera: Camera, triangle_mm: NDArray[np.float64], middle: NDArray[np.int64]) -> bool:
    """Whether the image of a triangle may reach the rays around a pixel."""
    image = camera.project(triangle_mm)
    if not np.isfinite(image).all():
        return True  # partly behind the camera
    reach = _MARGIN_PX + 2
    return bool(np.all(image.max(axis=0) > middle - reach) and np.all(image.min(axis=0) < middle + reach))


def _light_around(
    scene: Scene, camera: Camera, middle: NDArray[np.int64], corner_mm: NDArray[np.float64]
) -> list[_Light]:
    """Half shadows on the faces around a corner, and the light of the faces that meet there on each other."""
    size = (2 * _MARGIN_PX + 1) * _LIGHT_ACROSS
    at = (np.arange(size) + 0.5) / _LIGHT_ACROSS - _MARGIN_PX - 0.5
    u, v = np.meshgrid(middle[0] + at, middle[1] + at)
    number, positions, planes = _first_met(scene, camera, middle, u, v)
    positions = positions.reshape(*number.shape, 3)
    rays = (np.arange(size * _RAYS_ACROSS // _LIGHT_ACROSS) + 0.5) * _LIGHT_ACROSS / _RAYS_ACROSS - 0.5
    grid = np.meshgrid(rays, rays, indexing="ij")
    lights = []
    for face in np.unique(number[number > 0]):
        of_face = number == face
        points, plane = positions[of_face], planes[face - 1]
        shapes = [(part_of_lamps(scene, points), True, _LEAST_SHADOW)]
        if abs(corner_mm @ plane[:3] - plane[3]) < _IN_PLANE_MM:
            plane = plane * np.sign(camera.position_mm @ plane[:3] - plane[3])
            shapes += [(light, False, _LEAST_NEAR_LIGHT) for light in _near_light(scene, corner_mm, plane, points)]
        nearest = tuple(distance_transform_edt(~of_face, return_distances=False, return_indices=True))
        for values, is_factor, least in shapes:
            if np.std(values) > least:
                light = np.zeros(number.shape)
                light[of_face] = values
                at_rays = map_coordinates(light[nearest], grid, order=1, mode="nearest")
                lights.append(_Light(int(face), np.asarray(at_rays, np.float64), is_factor))
    return lights


def _near_light(
    scene: Scene, corner_mm: NDArray[np.float64], plane: NDArray[np.float64], points: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """(n,) form factors from points of a plane (n, n . p) to each face that meets it at a corner, all in front of it.

    So the floor has those of a block's faces; the floor lies on both sides of the block's.
    """
    factors: dict[tuple[float, ...], NDArray[np.float64]] = {}
    for corners in np.concatenate([surface.vertices_mm[surface.faces] for surface in scene.surfaces]):
        a, b, c = corners
        normal = np.cross(b - a, c - a)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
        height = corners @ plane[:3] - plane[3]
        is_at_corner = abs((corner_mm - a) @ normal) < _IN_PLANE_MM
        if is_at_corner and height.min() > -_IN_PLANE_MM and height.max() > _IN_PLANE_MM:
            factor = np.where((points - a) @ normal > 0, point_to_polygon(points, plane[:3], corners), 0.0)
            key = tuple(normal.round(3))
            factors[key] = factors.get(key, 0.0) + factor
    return [*factors.values()]


def _blurred(
    faces: NDArray[np.int64], lights: Sequence[_Light], blur_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(k, n, n) shares of faces around each ray within pixel and blur, times lamp light too; (m, n, n) other light."""
    numbers, counts = np.unique(faces, return_counts=True)
    large = numbers[counts > _SMALLEST_SHARE * faces.size]
    shares = [(faces == k).astype(float) for k in large]
    of_large = [light for light in lights if light.face in large]
    shares += [(faces == light.face) * light.shape for light in of_large if light.is_factor]
    levels = [(faces == light.face) * light.shape for light in of_large if not light.is_factor]
    blurred = [gaussian_filter(uniform_filter(part, _RAYS_ACROSS), blur_px * _RAYS_ACROSS) for part in shares + levels]
    return np.array(blurred[: len(shares)]), np.array(blurred[len(shares) :])
