"""Pictures of any scene: colours as a renderer stored them, and surfaces of their layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .absent_numbers import NotNumbers, nearest_numbers, not_numbers, of_any
    from .guides import GUIDES
    from .layer_changes import LayerChange, changed_layers
    from .number_steps import NumberSteps, steps_of
    from .pfm import PFM_ENDING, read_pfm
    from .reading import AS_STORED, cube_paths, read_scene_picture
    from .tiles import lost_tiles

__all__ = [
    "AS_STORED",
    "GUIDES",
    "PFM_ENDING",
    "LayerChange",
    "NotNumbers",
    "NumberSteps",
    "changed_layers",
    "cube_paths",
    "lost_tiles",
    "nearest_numbers",
    "not_numbers",
    "of_any",
    "read_pfm",
    "read_scene_picture",
    "steps_of",
]

__getattr__, __dir__ = lazy_names(__name__)
