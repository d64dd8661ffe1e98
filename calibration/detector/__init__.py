"""Properties of the detector, measured from the frames."""

from .dark_fit import dark_level_sigma
from .linearity import Linearity, measure_linearity
from .response import LAWS
from .response_points import ResponseSeries, light_series
from .sensor_study import NO_STUDY, SensorStudy, study_sensor

__all__ = [
    "LAWS",
    "NO_STUDY",
    "Linearity",
    "ResponseSeries",
    "SensorStudy",
    "dark_level_sigma",
    "light_series",
    "measure_linearity",
    "study_sensor",
]
