"""Luminance, chromaticity and illuminance of a rendered box, by surface.

For the CIE 1931 2-degree observer and 683 lm/W.
"""

from .illuminance import surface_illuminance
from .observer import tristimulus_weights, why_no_luminance
from .surface_light import PartLight, Photometry, SurfaceSums, surface_sums

__all__ = [
    "PartLight",
    "Photometry",
    "SurfaceSums",
    "surface_illuminance",
    "surface_sums",
    "tristimulus_weights",
    "why_no_luminance",
]
