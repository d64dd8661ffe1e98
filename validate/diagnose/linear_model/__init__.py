"""Linear model of a residual over sigma, with camera and lamp projected out."""

from .model import (
    BandErrors,
    LinearModel,
    build_linear_model,
    model_variance,
    nuisance_priors,
    smooth_excess,
    smooth_part,
)
from .nuisance_columns import NuisanceColumns, nuisance_columns

__all__ = [
    "BandErrors",
    "LinearModel",
    "NuisanceColumns",
    "build_linear_model",
    "model_variance",
    "nuisance_columns",
    "nuisance_priors",
    "smooth_excess",
    "smooth_part",
]
