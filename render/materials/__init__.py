"""Materials and media for Mitsuba and for the spectral integrators."""

from .bsdf import SpectralBsdfs, bsdf_dict
from .medium import SpectralMedium

__all__ = [
    "SpectralBsdfs",
    "SpectralMedium",
    "bsdf_dict",
]
