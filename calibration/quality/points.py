"""Checks of surveyed points against the frame, the scene and the fitted camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.scene import Surface
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..capture import Capture
from ..geometry import CameraFit, SurveyedPoints, capture_points, fit_camera
from .frame_checks import Suspicion

__all__ = ["check_points", "distance_to_surface", "explain_points"]

#: Largest distance of a surveyed point from a surface, mm: boxes are built to a few mm.
OFF_SURFACE_MM = 15.0

#: Largest share of points off all surfaces: some may be marked on what the scene does not contain.
LARGEST_OFF_SHARE = 0.3

#: Another unit or order of axes must reduce the share of points off the surfaces below this share of it.
EXPLAINED_SHARE = 0.5

#: Smallest extent of the points over that of the scene: points in too small a unit lie in one corner.
SMALLEST_SPREAD = 0.2

#: Distance of a point outside the frame that is not suspected, px.
OUTSIDE_PX = 2

#: Largest share of points outside the frame.
LARGEST_OUTSIDE_SHARE = 0.05

#: Largest ratio of the points' scatter to that stated.
LARGEST_SCATTER_RATIO = 2.0

#: Smallest ratio of the points' scatter to that stated: too large a stated scatter does less harm.
SMALLEST_SCATTER_RATIO = 1 / LARGEST_SCATTER_RATIO / 1.5

#: Fewest degrees of freedom of the fit at which its scatter is compared.
FEWEST_DEGREES = 6

#: Residual of a wrong point, in standard deviations of the points.
WRONG_POINT_SIGMAS = 12

#: Smallest standard deviation for that, px: interpolation within a pixel is not better.
SMALLEST_SIGMA_PX = 0.05

#: Smallest share of the points that fit a camera if their error is explained.
EXPLAINED_POINTS = 0.8

#: Largest scatter of explained points, in standard deviations of the points.
EXPLAINED_SIGMAS = 5

#: Standard deviation of the points if it is not stated, px.
DEFAULT_SIGMA_PX = 0.5

#: Changes of units and axes of points (n, 3), by the words of the suspicion.
UNITS_AND_AXES: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "in cm": lambda p: 10 * p,
    "in m": lambda p: 1000 * p,
    "in um": lambda p: p / 1000,
    "in inches": lambda p: 25.4 * p,
    "with x and z exchanged": lambda p: p[:, [2, 1, 0]],
    "with y and z exchanged": lambda p: p[:, [0, 2, 1]],
    "with x and y exchanged": lambda p: p[:, [1, 0, 2]],
    "with axes in the order z, x, y": lambda p: p[:, [1, 2, 0]],
    "with axes in the order y, z, x": lambda p: p[:, [2, 0, 1]],
}


def check_points(capture: Capture, fit: CameraFit | None) -> Iterator[Suspicion]:
    """Check that points are in the frame and on the scene's surfaces, and scatter as stated.

    Parameters
    ----------
    capture
        A capture; without surveyed points nothing is checked.
    fit
        Camera fitted to the points; None if there is none.

    Yields
    ------
    Suspicion
        For the points together, then for single wrong ones.
    """
    points = capture_points(capture) if fit is None else fit.points
    if points is None:
        return
    name = str(capture.manifest.geometry.points) if capture.manifest.geometry else ""
    yield from _check_frame(points, _stored_corners(capture), name)
    scene = capture.scene
    if scene is not None:
        yield from _check_surfaces(points, scene, name)
    if fit is not None:
        yield from _check_scatter(fit)
        yield from _check_outliers(points, fit, name)


def _stored_corners(capture: Capture) -> NDArray[np.float64]:
    """(2, 2) first and last pixel of the stored frames, in pixels in use.

    A window of the frames may leave points outside it.
    """
    height, width = capture.shape
    if capture.reduction is None:
        return np.array([[0.0, 0.0], [width - 1.0, height - 1.0]])
    full = [[0.0, 0.0], [capture.reduction.full_width_px - 1.0, capture.reduction.full_height_px - 1.0]]
    return capture.reduction.positions(np.array(full))


def _check_frame(points: SurveyedPoints, corners: NDArray[np.float64], name: str) -> Iterator[Suspicion]:
    """Points outside the frame.

    corners : (2, 2) its first and last pixel. name : of the points' file.
    """
    first, last = corners
    width, height = np.rint(last - first + 1).astype(int)
    outside = np.any((points.image_px < first - OUTSIDE_PX) | (points.image_px > last + OUTSIDE_PX), axis=1)
    if np.count_nonzero(outside) > max(1, LARGEST_OUTSIDE_SHARE * len(points.ids)):
        yield Suspicion(
            "the points are those of another picture (another size, or another capture)",
            name,
            f"{np.count_nonzero(outside)} of {len(points.ids)} are outside the frame of {width} x {height} px; they "
            f"reach to ({points.image_px[:, 0].max():.0f}, {points.image_px[:, 1].max():.0f}).",
        )


def _check_surfaces(points: SurveyedPoints, scene: Scene, name: str) -> Iterator[Suspicion]:
    """Points off the scene's surfaces, with the unit or order of axes that explains it.

    name : of the points' file.
    """
    size = float(np.ptp(scene.corners_mm, axis=0).max())

    def off_share(positions: NDArray[np.float64]) -> float:
        """Share of positions (n, 3) off all surfaces; 1 if all lie in one corner (a small unit)."""
        if np.ptp(positions, axis=0).max() < SMALLEST_SPREAD * size:
            return 1.0
        return float(np.mean(_distance_to_surfaces(scene, positions) > OFF_SURFACE_MM))

    as_stated = off_share(points.points_mm)
    if as_stated <= LARGEST_OFF_SHARE:
        return
    shares = {how: off_share(change(points.points_mm)) for how, change in UNITS_AND_AXES.items()}
    how = min(shares, key=shares.__getitem__)
    unexplained = "not in the scene's axes, in mm, or the box is not the one that capture.toml states (scene)"
    guess = how if shares[how] < EXPLAINED_SHARE * as_stated else unexplained
    yield Suspicion(
        f"the points are {guess}",
        f"{name}: x_mm, y_mm, z_mm",
        f"{as_stated:.0%} of them lie in one corner of the scene {scene.name} or more than {OFF_SURFACE_MM:g} mm from "
        "all its surfaces" + (f", {shares[how]:.0%} when taken {how}." if guess == how else "."),
    )


def _check_scatter(fit: CameraFit) -> Iterator[Suspicion]:
    """Scatter of the points about their projection against that stated."""
    if fit.sigma_estimated or fit.degrees_of_freedom < FEWEST_DEGREES:
        return
    ratio = fit.reprojection_rms_px / fit.point_sigma_px * np.sqrt(2 * fit.in_use.sum() / fit.degrees_of_freedom)
    if not SMALLEST_SCATTER_RATIO < ratio < LARGEST_SCATTER_RATIO:
        yield Suspicion(
            "the points do not scatter as stated (a wrong point_sigma_px, or points of another picture)",
            "geometry.point_sigma_px",
            f"They scatter by {ratio * fit.point_sigma_px:.3g} px about the camera's projection; "
            f"{fit.point_sigma_px:g} px are stated.",
        )


def _check_outliers(points: SurveyedPoints, fit: CameraFit, name: str) -> Iterator[Suspicion]:
    """Points far from their projection by the camera fitted to the others. name : of the file."""
    distance = np.linalg.norm(fit.residuals_px, axis=1)
    far = distance > WRONG_POINT_SIGMAS * max(fit.point_sigma_px, SMALLEST_SIGMA_PX)
    if np.any(far & ~fit.in_use):
        names = [i for i, f in zip(points.ids, far & ~fit.in_use, strict=True) if f]
        yield Suspicion(
            "surveyed points are wrong",
            f"{name}: {', '.join(names[:5])}",
            f"They are up to {distance[far].max():.1f} px from their projection by the camera fitted to the other "
            "points.",
        )


def explain_points(capture: Capture, fault: InputError) -> Suspicion | None:
    """Likely error of points that no camera fits.

    Parameters
    ----------
    capture
        A capture with surveyed points.
    fault
        The refusal of the fit.

    Returns
    -------
    Suspicion or None
        The correction by which a camera fits best; None if no common error explains the points.
    """
    points = capture_points(capture)
    if points is None:
        return None
    height, width = capture.shape
    geometry = capture.manifest.geometry
    sigma = (geometry.point_sigma_px if geometry else None) or DEFAULT_SIGMA_PX
    scene = capture.scene
    agreeing: dict[str, tuple[float, float]] = {}
    for how, corrected in _corrections(points, width, height).items():
        try:
            fit = fit_camera(corrected, width_px=width, height_px=height, point_sigma_px=None)
        except InputError:
            continue
        if fit.in_use.mean() < EXPLAINED_POINTS or fit.reprojection_rms_px > EXPLAINED_SIGMAS * sigma:
            continue
        # Several mirrorings fit equally well; the right one has an upright camera and points on surfaces.
        off = 0.0
        if scene is not None:
            off = float(np.mean(_distance_to_surfaces(scene, corrected.points_mm) > OFF_SURFACE_MM))
        agreeing[how] = (1 + float(fit.camera.rotation[1, 1]) + 4 * off, fit.reprojection_rms_px)
    if not agreeing:
        return None
    how = min(agreeing, key=agreeing.__getitem__)
    return Suspicion(
        f"no camera fits the points: {how}",
        str(geometry.points) if geometry else "geometry.points",
        f"As stated: {fault.found}. With this corrected they scatter by {agreeing[how][1]:.2f} px.",
    )


def _corrections(points: SurveyedPoints, width: int, height: int) -> dict[str, SurveyedPoints]:
    """Points corrected for each common error, by the words of the suspicion.

    width, height : of the frame, px.
    """
    image, world = points.image_px, points.points_mm
    return {
        "focal length or pixel pitch is wrong": points,
        "u and v are exchanged": replace(points, image_px=image[:, ::-1].copy()),
        "v runs upwards": replace(points, image_px=np.column_stack([image[:, 0], height - 1 - image[:, 1]])),
        "u runs to the left": replace(points, image_px=np.column_stack([width - 1 - image[:, 0], image[:, 1]])),
        "x and z are exchanged": replace(points, points_mm=world[:, [2, 1, 0]].copy()),
        "y and z are exchanged": replace(points, points_mm=world[:, [0, 2, 1]].copy()),
        "x and y are exchanged": replace(points, points_mm=world[:, [1, 0, 2]].copy()),
        "an axis points the other way": replace(points, points_mm=world * np.array([1.0, 1.0, -1.0])),
    }


def _distance_to_surfaces(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance of points (n, 3), mm, to the nearest surface or lamp of a scene, mm."""
    return np.min([distance_to_surface(surface, points) for surface in scene.all_surfaces], axis=0)


def distance_to_surface(surface: Surface, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of points to a surface.

    Parameters
    ----------
    surface
        The surface.
    points
        (n, 3) positions, mm.

    Returns
    -------
    NDArray
        (n,) mm.
    """
    return np.min([_distance_to_triangle(points, surface.vertices_mm[face]) for face in surface.faces], axis=0)


def _distance_to_triangle(points: NDArray[np.float64], triangle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance of points (n, 3) to a triangle (3, 3): height above it, or to its edges."""
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    height = (points - a) @ normal
    foot = points - height[:, None] * normal
    inside = np.ones(len(points), bool)
    rim = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= np.cross(edge, foot - start) @ normal >= -1e-9
        share = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-12), 0, 1)
        rim = np.minimum(rim, np.linalg.norm(points - start - share[:, None] * edge, axis=1))
    return np.where(inside, np.abs(height), rim)
