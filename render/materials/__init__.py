"""Materials, textures and media for Mitsuba and for the spectral integrators."""

from .bsdf import SpectralBsdfs, bsdf_dict
from .medium import SpectralMedium
from .textures import SpectralTextures

__all__ = [
    "SpectralBsdfs",
    "SpectralMedium",
    "SpectralTextures",
    "bsdf_dict",
]
