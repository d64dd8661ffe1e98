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

__all__ = [
    "BandErrors",
    "LinearModel",
    "build_linear_model",
    "model_variance",
    "nuisance_priors",
    "smooth_excess",
    "smooth_part",
]
