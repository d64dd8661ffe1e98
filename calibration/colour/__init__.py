"""CIE XYZ from band signals: filter weights, their colour errors, chart patches."""

from .colorimetry import FilterWeights, xyz_image
from .colour_error import ColourError
from .colour_study import ColourStudy, study_colour
from .patch_colour import ILLUMINANT, PatchErrors, patch_errors, patch_xyz, patches_csv
from .patches import PatchTable, measure_patches

__all__ = [
    "ILLUMINANT",
    "ColourError",
    "ColourStudy",
    "FilterWeights",
    "PatchErrors",
    "PatchTable",
    "measure_patches",
    "patch_errors",
    "patch_xyz",
    "patches_csv",
    "study_colour",
    "xyz_image",
]
