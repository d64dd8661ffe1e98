"""Regression of renderers: verdict on two pictures, and the name of the change."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .grids import Common
    from .inputs import SIDES, View, assert_same_light, input_files, regress_inputs, regress_pictures
    from .outcome import (
        UNKNOWN,
        NamedChange,
        Outcome,
        as_percent,
        change_text,
        github_lines,
        name_line,
        summary,
        write_junit,
    )
    from .pooled import SYSTEMATIC, PooledMean
    from .sides import Side, SurfaceIndices, cut_camera, cut_side, in_common_quantity, read_side, side_of
    from .strata import BLOCKS, strata_of
    from .verdict import FALSE_ALARMS, compared_areas, regress_sides
    from .where import Spot

__all__ = [
    "BLOCKS",
    "FALSE_ALARMS",
    "SIDES",
    "SYSTEMATIC",
    "UNKNOWN",
    "Common",
    "NamedChange",
    "Outcome",
    "PooledMean",
    "Side",
    "Spot",
    "SurfaceIndices",
    "View",
    "as_percent",
    "assert_same_light",
    "change_text",
    "compared_areas",
    "cut_camera",
    "cut_side",
    "github_lines",
    "in_common_quantity",
    "input_files",
    "name_line",
    "read_side",
    "regress_inputs",
    "regress_pictures",
    "regress_sides",
    "side_of",
    "strata_of",
    "summary",
    "write_junit",
]

__getattr__, __dir__ = lazy_names(__name__)
