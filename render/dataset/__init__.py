"""Data sets of synthetic boxes: recipes, drawn boxes, and the truth about their pictures."""

from ..radiosity import mixed_scenes
from .drawing import Box, draw_box, part_of
from .light_parts import REFLECTIONS, LightParts, light_parts
from .recipe import TRUTHS, CameraTable, Recipe, SensorTable
from .recipe_file import load_recipe
from .shared_rays import joined_scene, sharing_rays, split_image
from .visible_points import VisiblePoints, mixed_pixels, shadow_fraction, visible_points

__all__ = [
    "REFLECTIONS",
    "TRUTHS",
    "Box",
    "CameraTable",
    "LightParts",
    "Recipe",
    "SensorTable",
    "VisiblePoints",
    "draw_box",
    "joined_scene",
    "light_parts",
    "load_recipe",
    "mixed_pixels",
    "mixed_scenes",
    "part_of",
    "shadow_fraction",
    "sharing_rays",
    "split_image",
    "visible_points",
]
