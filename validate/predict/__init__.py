"""The model's expected signals for one capture, with any effects."""

from .foreign import ForeignPicture, foreign_picture, require_level
from .picture_cache import default_cache, digest_of
from .plain_rendering import render_plainly
from .predictor import Predictor, build_predictor
from .rendering import render_to_noise
from .sensing import sensing
from .transported import transported

__all__ = [
    "ForeignPicture",
    "Predictor",
    "build_predictor",
    "default_cache",
    "digest_of",
    "foreign_picture",
    "render_plainly",
    "render_to_noise",
    "require_level",
    "sensing",
    "transported",
]
