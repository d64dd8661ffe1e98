"""Checks of surveyed points against the frame, the scene and the fitted camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ..capture import Capture
from ..geometry import CameraFit, SurveyedPoints, fit_camera, read_points
from .surface_distance import distance_to_surfaces
from .suspicion import Suspicion

__all__ = ["check_points", "explain_points"]

#: Largest distance of a surveyed point from a surface, and largest share of points beyond it.
_OFF_SURFACE_MM, _SHARE_OFF = 15.0, 0.3
_SCATTER = 2.0
#: Smallest extent of the points over that of the scene.
_LEAST_SPREAD = 0.2


def _points(capture: Capture) -> SurveyedPoints | None:
    geometry = capture.manifest.geometry
    return None if geometry is None else read_points(capture.folder / geometry.points)


def check_points(capture: Capture, fit: CameraFit | None) -> Iterator[Suspicion]:
    """Checks that points are inside the frame, on the surfaces of a known scene, and scatter as stated."""
    points = _points(capture)
    if points is None:
        return
    height, width = capture.shape
    name = str(capture.manifest.geometry.points) if capture.manifest.geometry else ""
    outside = np.any((points.image_px < -2) | (points.image_px > np.array([width, height]) + 1), axis=1)
    if np.count_nonzero(outside) > max(1, 0.05 * len(points.ids)):
        yield Suspicion(
            "the points are those of another picture (another size, or another capture)",
            name,
            f"{np.count_nonzero(outside)} of {len(points.ids)} are outside the frame of {width} x {height} px; they "
            f"reach to ({points.image_px[:, 0].max():.0f}, {points.image_px[:, 1].max():.0f}).",
        )
    scene = capture.known_scene()
    if scene is not None:
        yield from _on_surfaces(points, scene, name)
    if fit is None:
        return
    if not fit.sigma_estimated and fit.degrees_of_freedom >= 6:
        ratio = fit.reprojection_rms_px / fit.point_sigma_px * np.sqrt(2 * fit.kept.sum() / fit.degrees_of_freedom)
        if not 1 / _SCATTER / 1.5 < ratio < _SCATTER:
            yield Suspicion(
                "the points do not scatter as stated (a wrong point_sigma_px, or points of another picture)",
                "geometry.point_sigma_px",
                f"They scatter by {ratio * fit.point_sigma_px:.3g} px about the camera's projection; "
                f"{fit.point_sigma_px:g} px are stated.",
            )
    far = np.linalg.norm(fit.residuals_px, axis=1) > 12 * max(fit.point_sigma_px, 0.05)
    if np.any(far & ~fit.kept):
        names = [i for i, f in zip(points.ids, far & ~fit.kept, strict=True) if f]
        yield Suspicion(
            "surveyed points are wrong",
            f"{name}: {', '.join(names[:5])}",
            f"They are up to {np.linalg.norm(fit.residuals_px[far], axis=1).max():.1f} px from their projection by the "
            "camera fitted to the other points.",
        )


def _on_surfaces(points: SurveyedPoints, scene: Scene, name: str) -> Iterator[Suspicion]:
    size = float(np.ptp(scene.corners_mm, axis=0).max())

    def off(places: NDArray[np.float64]) -> float:
        """The share that lies off all surfaces; 1 for points in one corner, as of a small unit."""
        if np.ptp(places, axis=0).max() < _LEAST_SPREAD * size:
            return 1.0
        return float(np.mean(distance_to_surfaces(scene, places) > _OFF_SURFACE_MM))

    as_is = off(points.points_mm)
    if as_is <= _SHARE_OFF:
        return
    ways: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
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
    shares = {how: off(way(points.points_mm)) for how, way in ways.items()}
    how = min(shares, key=shares.__getitem__)
    guess = how if shares[how] < 0.5 * as_is else "not in the scene's axes, in mm"
    yield Suspicion(
        f"the points are {guess}",
        f"{name}: x_mm, y_mm, z_mm",
        f"{as_is:.0%} of them lie in one corner of the scene {scene.name} or more than {_OFF_SURFACE_MM:g} mm from all "
        "its surfaces" + (f", {shares[how]:.0%} when taken {how}." if guess == how else "."),
    )


def explain_points(capture: Capture, fault: InputError) -> Suspicion | None:
    """The likely error of points that no camera fits; None if no common error explains them."""
    points = _points(capture)
    if points is None:
        return None
    height, width = capture.shape
    size = np.array([width - 1, height - 1])
    image, world = points.image_px, points.points_mm
    ways = {
        "focal length or pixel pitch is wrong": points,
        "u and v are exchanged": replace(points, image_px=image[:, ::-1].copy()),
        "v runs upwards": replace(points, image_px=np.column_stack([image[:, 0], size[1] - image[:, 1]])),
        "u runs to the left": replace(points, image_px=np.column_stack([size[0] - image[:, 0], image[:, 1]])),
        "x and z are exchanged": replace(points, points_mm=world[:, [2, 1, 0]].copy()),
        "y and z are exchanged": replace(points, points_mm=world[:, [0, 2, 1]].copy()),
        "x and y are exchanged": replace(points, points_mm=world[:, [1, 0, 2]].copy()),
        "an axis points the other way": replace(points, points_mm=world * np.array([1.0, 1.0, -1.0])),
    }
    geometry = capture.manifest.geometry
    sigma = (geometry.point_sigma_px if geometry else None) or 0.5
    scene = capture.known_scene()
    agreeing: dict[str, tuple[float, float]] = {}
    for how, changed in ways.items():
        try:
            fit = fit_camera(changed, width_px=width, height_px=height, point_sigma_px=None)
        except InputError:
            continue
        if fit.kept.mean() < 0.8 or fit.reprojection_rms_px > 5 * sigma:
            continue
        # Several mirrorings fit equally well; the right one has an upright camera and points on surfaces.
        off = 0.0 if scene is None else float(np.mean(distance_to_surfaces(scene, changed.points_mm) > _OFF_SURFACE_MM))
        agreeing[how] = (1 + float(fit.camera.rotation[1, 1]) + 4 * off, fit.reprojection_rms_px)
    if not agreeing:
        return None
    how = min(agreeing, key=agreeing.__getitem__)
    return Suspicion(
        f"no camera fits the points: {how}",
        str(geometry.points) if geometry else "geometry.points",
        f"As stated: {fault.found}. With this corrected they scatter by {agreeing[how][1]:.2f} px.",
    )
