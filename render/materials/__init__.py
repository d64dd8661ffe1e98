"""Materials, textures and media for Mitsuba and for the spectral integrators."""

from .bsdf import SpectralBsdfs, bsdf_dict
from .medium import SpectralMedia
from .textures import SpectralTextures

__all__ = [
    "SpectralBsdfs",
    "SpectralMedia",
    "SpectralTextures",
    "bsdf_dict",
]
