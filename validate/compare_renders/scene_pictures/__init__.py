"""Pictures of any scene: colours as a renderer stored them, and surfaces of their layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .absent_numbers import NotNumbers, nearest_numbers, not_numbers, of_any
    from .guides import GUIDES
    from .layer_changes import LayerChange, changed_layers
    from .number_steps import NumberSteps, steps_of
    from .reading import AS_STORED, read_scene_picture

__all__ = [
    "AS_STORED",
    "GUIDES",
    "LayerChange",
    "NotNumbers",
    "NumberSteps",
    "changed_layers",
    "nearest_numbers",
    "not_numbers",
    "of_any",
    "read_scene_picture",
    "steps_of",
]

__getattr__, __dir__ = lazy_names(__name__)
