"""Comparison of measured and modelled images, and where the model fails."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .colour_difference import COLOUR_DIFFERENCES, HEADLINE, DifferenceStatistics, White, srgb_matrix, srgb_preview
    from .comparison import ChiSquare, Comparison, Expectation, RelativeDifference, SurfaceRow
    from .corners import Corner, LocatedCorners, locate_corners, scene_corners
    from .edge_alignment import refine_geometry
    from .excess import Region, regions_of
    from .failure import OUTSIDE, Failure, Part
    from .free_scale import FreeScale, free_columns
    from .maps import read_map, write_map, write_maps
    from .nuisances import NuisanceFit, Nuisances, camera_jacobian, fit_lamp_scale, held_lamp_scale
    from .pipeline import (
        Predicted,
        Rendered,
        Validation,
        compared,
        failures,
        refitted_picture,
        rendered_from,
        validate_capture,
        validate_prepared,
    )
    from .prepared import CalibratedCapture, prepare, solved_light, with_model, with_picture
    from .regions import INTERIOR_DISTANCE_PX

__all__ = [
    "COLOUR_DIFFERENCES",
    "HEADLINE",
    "INTERIOR_DISTANCE_PX",
    "OUTSIDE",
    "CalibratedCapture",
    "ChiSquare",
    "Comparison",
    "Corner",
    "DifferenceStatistics",
    "Expectation",
    "Failure",
    "FreeScale",
    "LocatedCorners",
    "NuisanceFit",
    "Nuisances",
    "Part",
    "Predicted",
    "Region",
    "RelativeDifference",
    "Rendered",
    "SurfaceRow",
    "Validation",
    "White",
    "camera_jacobian",
    "compared",
    "failures",
    "fit_lamp_scale",
    "free_columns",
    "held_lamp_scale",
    "locate_corners",
    "prepare",
    "read_map",
    "refine_geometry",
    "refitted_picture",
    "regions_of",
    "rendered_from",
    "scene_corners",
    "solved_light",
    "srgb_matrix",
    "srgb_preview",
    "validate_capture",
    "validate_prepared",
    "with_model",
    "with_picture",
    "write_map",
    "write_maps",
]

__getattr__, __dir__ = lazy_names(__name__)
