"""CIE XYZ from band signals: filter weights, their colour errors, chart patches."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .chain_check import ChainCheck, check_chain
    from .chart import chart_outlines
    from .chart_sensitivity import chart_sensitivities
    from .colorimetry import FilterWeights, xyz_image
    from .colour_error import ColourError
    from .colour_study import ColourStudy, study_colour
    from .patch_colour import ILLUMINANT, PatchErrors, patch_errors, patch_xyz, patches_csv
    from .patches import PatchTable, measure_patches

__all__ = [
    "ILLUMINANT",
    "ChainCheck",
    "ColourError",
    "ColourStudy",
    "FilterWeights",
    "PatchErrors",
    "PatchTable",
    "chart_outlines",
    "chart_sensitivities",
    "check_chain",
    "measure_patches",
    "patch_errors",
    "patch_xyz",
    "patches_csv",
    "study_colour",
    "xyz_image",
]

__getattr__, __dir__ = lazy_names(__name__)
