"""Fields that forms of several families of explanations share."""

from .band_levels import EVEN, fit_levels, level_equations, relative_levels
from .charge import TRAILS, moved_charge
from .image_copies import copies
from .sensor_patterns import SensorPatterns
from .spectra import forms_by_spectrum

__all__ = [
    "EVEN",
    "TRAILS",
    "SensorPatterns",
    "copies",
    "fit_levels",
    "forms_by_spectrum",
    "level_equations",
    "moved_charge",
    "relative_levels",
]
