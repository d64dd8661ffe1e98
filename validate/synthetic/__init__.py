"""Synthetic captures of a model: open ones, and blind ones with a sealed answer."""

from .blind import Answer, Score, draw_effect, open_seal, read_diagnosis, score, seal
from .model_capture import perturbed_camera, photographed_scene, write_model_capture
from .strengths import STRENGTHS, at_strength, scale_of
from .varied import varied_settings, with_block_offsets

__all__ = [
    "STRENGTHS",
    "Answer",
    "Score",
    "at_strength",
    "draw_effect",
    "open_seal",
    "perturbed_camera",
    "photographed_scene",
    "read_diagnosis",
    "scale_of",
    "score",
    "seal",
    "varied_settings",
    "with_block_offsets",
    "write_model_capture",
]
