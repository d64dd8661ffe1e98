"""Diffuse interreflection: lamps, patches, the radiosity solution, and the final gather."""

from .final_gather import LightField, gather, render_final_gather, solve_light
from .lamp import (
    LampSampler,
    build_lamp_samplers,
    direct_light,
    lamp_pattern,
    lamp_point,
    lamp_radiance,
    lamp_seen,
)
from .mixtures import MixedSurface, build_mixtures, mixed_scenes
from .patched_scene import PatchedScene, build_patched_scene
from .patches import patch_of
from .solution import solve_exchange

__all__ = [
    "LampSampler",
    "LightField",
    "MixedSurface",
    "PatchedScene",
    "build_lamp_samplers",
    "build_mixtures",
    "build_patched_scene",
    "direct_light",
    "gather",
    "lamp_pattern",
    "lamp_point",
    "lamp_radiance",
    "lamp_seen",
    "mixed_scenes",
    "patch_of",
    "render_final_gather",
    "solve_exchange",
    "solve_light",
]
