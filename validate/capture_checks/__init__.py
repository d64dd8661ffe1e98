"""Checks of a capture's photographs against each other and against a rendering of its scene."""

from .find import find_scene_suspicions, with_scene_checks

__all__ = ["find_scene_suspicions", "with_scene_checks"]
