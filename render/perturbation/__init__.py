"""Small changes of a picture without a new rendering: camera motion, surfaces, haze, blur."""

from .brdf_change import Reflection, changed_reflection, with_reflection
from .coat import Coat, fresnel
from .edge_blur import build_edge_blur
from .haze import STEPS, AirTransport, air_transport
from .patch_light import PatchLight, band_shares, patch_light, with_albedo
from .patch_transport import PatchTransport, build_patch_transport
from .warp import Warp, build_warp, pixels_per_unit, warp_change, warp_derivatives

__all__ = [
    "STEPS",
    "AirTransport",
    "Coat",
    "PatchLight",
    "PatchTransport",
    "Reflection",
    "Warp",
    "air_transport",
    "band_shares",
    "build_edge_blur",
    "build_patch_transport",
    "build_warp",
    "changed_reflection",
    "fresnel",
    "patch_light",
    "pixels_per_unit",
    "warp_change",
    "warp_derivatives",
    "with_albedo",
    "with_reflection",
]
