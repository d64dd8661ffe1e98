"""Checks of a capture's photographs against each other and against a rendering of its scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .find import find_scene_suspicions, with_scene_checks

__all__ = ["find_scene_suspicions", "with_scene_checks"]

__getattr__, __dir__ = lazy_names(__name__)
