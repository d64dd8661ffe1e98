"""Fields fitted to what the catalogue does not explain, as effects in small files.

A field is a set of maps on the sensor or on surfaces, with coefficients in each band.
"""

from .acting import field_effect
from .effect_file import effect_text, load_effect_file, write_effect_file
from .exchange import IN_PLACE, PictureCopy, exchanges
from .fitted_field import Acts, FittedField, field_record
from .from_diagnosis import effect_of_diagnosis
from .image_maps import ImageMaps
from .levels import LEVELS, parts_of_levels
from .surface_maps import PointMap, SurfaceMap, WaveMap

__all__ = [
    "IN_PLACE",
    "LEVELS",
    "Acts",
    "FittedField",
    "ImageMaps",
    "PictureCopy",
    "PointMap",
    "SurfaceMap",
    "WaveMap",
    "effect_of_diagnosis",
    "effect_text",
    "exchanges",
    "field_effect",
    "field_record",
    "load_effect_file",
    "parts_of_levels",
    "write_effect_file",
]
