"""The model: a scene, the effects added to it, and how to render it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .model_file import (
        Model,
        checked_effects,
        load_model,
        model_text,
        named_effect,
        referred_scene,
        scene_reference,
        with_scene_file,
        write_model,
    )
    from .stages import displacement, labelled_cube, model_cube_inputs, seen_through, with_further_distortion
    from .view import view_of

__all__ = [
    "Model",
    "checked_effects",
    "displacement",
    "labelled_cube",
    "load_model",
    "model_cube_inputs",
    "model_text",
    "named_effect",
    "referred_scene",
    "scene_reference",
    "seen_through",
    "view_of",
    "with_further_distortion",
    "with_scene_file",
    "write_model",
]

__getattr__, __dir__ = lazy_names(__name__)
