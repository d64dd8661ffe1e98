"""The camera's pose from a flat target at a stated place in the box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import REFERENCE_ROTATION, Camera
from cboxlab.utils.distributions import chi2_tail
from numpy.typing import NDArray

from .camera_fit import FALSE_ALARM
from .camera_jacobian import inverse_information, parameter_jacobian
from .lens_model import LensModel
from .surveyed_points import SurveyedPoints
from .target_adjustment import HINT, adjust, view_jacobian
from .targets import TargetView

__all__ = ["BoardPlace", "fit_placed", "place_notes", "placed_points"]


@dataclass(frozen=True, eq=False)
class BoardPlace:
    """Place of a board in the box."""

    #: (3,) first inner corner or circle, mm.
    origin_mm: NDArray[np.float64]
    #: (3, 3) columns along the board's rows, along its columns, and into the board, in the box's axes.
    axes: NDArray[np.float64]
    #: Whether the pattern looks the same after half a turn, so that its first point is not marked.
    symmetric: bool

    def in_box(self, board_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions in the box of points on the board.

        Parameters
        ----------
        board_mm
            (n, 3) points in the board's axes, mm.

        Returns
        -------
        NDArray
            (n, 3) points in the box's axes, mm.
        """
        return self.origin_mm + board_mm @ self.axes.T


def _orders(world: NDArray[np.float64], board: BoardPlace) -> list[NDArray[np.float64]]:
    """The board's points in every order that a detection of an unmarked pattern may have."""
    if not board.symmetric:
        return [world]
    extent = world.max(axis=0)
    orders = [world, extent - world]
    if np.isclose(extent[0], extent[1]):
        turned = np.stack([world[:, 1], extent[0] - world[:, 0], world[:, 2]], axis=1)
        orders += [turned, extent - turned]
    return orders


def placed_points(
    views: Sequence[TargetView], boards: Sequence[BoardPlace], cameras: Sequence[Camera], names: Sequence[str]
) -> tuple[SurveyedPoints, Camera]:
    """Points of boards at stated places as surveyed points, and the camera before them.

    An unmarked pattern looks the same after half a turn. Of the orders of its points, the one is taken that puts the
    camera nearest to one that stands upright and looks along the box's z axis.

    Parameters
    ----------
    views
        Points of each board in its own axes, mm, and in the image, px.
    boards
        Place of each board.
    cameras
        Camera of each view, in the board's axes.
    names
        Name of each view.

    Returns
    -------
    SurveyedPoints
        Points of all boards in the box's axes.
    Camera
        Camera with its pose in the box by the first board, without covariance.
    """
    worlds, ids, posed = [], [], []
    for (world, _), board, camera, name in zip(views, boards, cameras, names, strict=True):
        poses = []
        for order in _orders(world, board):
            # Rigid motion of the board's own axes that takes the detected order to this one.
            motion = np.linalg.lstsq(np.c_[world[:, :2], np.ones(len(world))], order[:, :2], rcond=None)[0].T
            turn = np.eye(3)
            turn[:2, :2] = np.round(motion[:, :2])
            shift = np.append(motion[:, 2], 0.0)
            rotation = camera.rotation @ turn.T @ board.axes.T
            position = board.in_box((turn @ camera.position_mm + shift)[None])[0]
            poses.append((float(np.trace(rotation @ REFERENCE_ROTATION.T)), rotation, position, order))
        _, rotation, position, order = max(poses, key=lambda entry: entry[0])
        posed.append(replace(camera, rotation=rotation, position_mm=position, covariance=None))
        worlds.append(board.in_box(order))
        ids += [f"{name} {number}" for number in range(len(order))]
    images = [image for _, image in views]
    points = SurveyedPoints(tuple(ids), np.concatenate(worlds), np.concatenate(images), ", ".join(names))
    return points, posed[0]


def fit_placed(
    cameras: Sequence[Camera], measured: Sequence[TargetView], sigma_px: float, model: LensModel, source: str
) -> tuple[Camera, dict[str, float]]:
    """Camera before boards at stated places, with the lens that all boards share.

    Parameters
    ----------
    cameras
        Initial cameras of the other views, and last the one before the boards at stated places.
    measured
        Points of each, mm and px.
    sigma_px
        Standard deviation of their image coordinates, px.
    model
        Formula of the lens and the parameters that are fitted.
    source
        Frames of the boards, for messages.

    Returns
    -------
    Camera
        The last camera, with its covariance; that of the boards' places is not in it.
    dict
        Standard deviations of the fitted terms of the lens beyond k1, by term.

    Raises
    ------
    InputError
        If the boards do not determine the camera.
    """
    sigmas = [sigma_px] * len(cameras)
    fitted = adjust(cameras, measured, sigmas, model)
    inverse = inverse_information(view_jacobian(fitted, measured, sigmas, model), source, HINT)
    order = np.r_[len(inverse) - 6 : len(inverse), 0 : model.shared]
    camera, covariance = fitted[-1], inverse[np.ix_(order, order)]
    return replace(camera, covariance=model.covariance(camera, covariance)), model.term_sigmas(covariance)


def place_notes(
    views: Sequence[TargetView],
    boards: Sequence[BoardPlace | None],
    names: Sequence[str],
    camera: Camera,
    sigma_px: float,
) -> list[str]:
    """Notes on boards that the surveyed camera does not see where they are stated to be.

    Parameters
    ----------
    views
        Points of each board in its own axes, mm, and in the image, px.
    boards
        Place of each board in the box; None where it is not stated.
    names
        Name of each view.
    camera
        Camera of the survey, with its covariance.
    sigma_px
        Standard deviation of the boards' image coordinates, px.

    Returns
    -------
    list
        One sentence for each board whose mean displacement has a probability below FALSE_ALARM.
    """
    notes = []
    for (world, image), board, name in zip(views, boards, names, strict=True):
        if board is None:
            continue
        orders = [board.in_box(order) for order in _orders(world, board)]
        points = min(
            orders, key=lambda order: float(np.sum(np.nan_to_num(image - camera.project(order), nan=1e6) ** 2))
        )
        residual = image - camera.project(points)
        mean_by_camera = parameter_jacobian(camera, points).reshape(-1, 2, 10).mean(axis=0)
        spread = sigma_px**2 / len(points) * np.eye(2)
        if camera.covariance is not None:
            spread += mean_by_camera @ camera.covariance @ mean_by_camera.T
        mean = residual.mean(axis=0)
        if not chi2_tail(mean @ np.linalg.solve(spread, mean), 2) >= FALSE_ALARM:
            notes.append(
                f"{name}: by the surveyed points the board lies {np.linalg.norm(mean):.2f} px from its stated place "
                f"(rms of its points {np.sqrt(np.mean(residual**2)):.2f} px); the points are in use"
            )
    return notes
