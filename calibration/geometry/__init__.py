"""Camera calibration from surveyed points and flat targets, with covariance."""

from .camera_calibration import calibrate_camera
from .camera_fit import CameraFit, fit_camera, read_points
from .camera_jacobian import parameter_jacobian
from .surveyed_points import SurveyedPoints
from .target_camera import TargetFit

__all__ = [
    "CameraFit",
    "SurveyedPoints",
    "TargetFit",
    "calibrate_camera",
    "fit_camera",
    "parameter_jacobian",
    "read_points",
]
