"""Camera calibration from surveyed points and flat targets, with covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .camera_calibration import BoardViews, calibrate_camera, detect_boards
    from .camera_fit import CameraFit, fit_camera, read_points
    from .camera_jacobian import parameter_jacobian
    from .surveyed_points import SurveyedPoints, capture_points
    from .target_camera import TargetFit, fit_camera_targets

__all__ = [
    "BoardViews",
    "CameraFit",
    "SurveyedPoints",
    "TargetFit",
    "calibrate_camera",
    "capture_points",
    "detect_boards",
    "fit_camera",
    "fit_camera_targets",
    "parameter_jacobian",
    "read_points",
]

__getattr__, __dir__ = lazy_names(__name__)
