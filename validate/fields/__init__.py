"""Fields fitted to what the catalogue leaves, as effects: maps on the sensor or on surfaces, kept in small files."""

from .acting import field_effect
from .effect_file import effect_text, load_effect_file, write_effect_file
from .exchange import (
    HALO_WIDTHS_PX,
    STREAK_WIDTHS_PX,
    neighbour_steps,
    with_halo,
    with_moments,
    with_neighbours,
    with_streak,
)
from .fitted_field import Acts, FittedField, field_record
from .from_diagnosis import effect_of_diagnosis
from .image_maps import ImageMaps
from .levels import parts_of_levels
from .surface_maps import PointMap, SurfaceMap, WaveMap

__all__ = [
    "HALO_WIDTHS_PX",
    "STREAK_WIDTHS_PX",
    "Acts",
    "FittedField",
    "ImageMaps",
    "PointMap",
    "SurfaceMap",
    "WaveMap",
    "effect_of_diagnosis",
    "effect_text",
    "field_effect",
    "field_record",
    "load_effect_file",
    "neighbour_steps",
    "parts_of_levels",
    "with_halo",
    "with_moments",
    "with_neighbours",
    "with_streak",
    "write_effect_file",
]
