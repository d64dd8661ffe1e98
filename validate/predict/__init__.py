"""Prediction of the signals of one capture, with any effects."""

from .charge import charge_exchange
from .external_picture import ExternalPicture, external_picture, require_level
from .picture_cache import cached_picture, default_cache, digest_of
from .picture_errors import (
    PictureErrors,
    errors_of_cells,
    picture_errors,
    sample_blocks,
    sparse_columns,
    squares_of,
)
from .plain_rendering import render_plainly
from .predictor import Predictor, build_predictor, effects_key
from .rendering import CONVERGENCE, Picture, render_to_noise
from .sensing import sensing
from .traced_picture import traced_picture
from .transported import Coated, coated, transported

__all__ = [
    "CONVERGENCE",
    "Coated",
    "ExternalPicture",
    "Picture",
    "PictureErrors",
    "Predictor",
    "build_predictor",
    "cached_picture",
    "charge_exchange",
    "coated",
    "default_cache",
    "digest_of",
    "effects_key",
    "errors_of_cells",
    "external_picture",
    "picture_errors",
    "render_plainly",
    "render_to_noise",
    "require_level",
    "sample_blocks",
    "sensing",
    "sparse_columns",
    "squares_of",
    "traced_picture",
    "transported",
]
