"""The images that integrators return: radiance by pixel and wavelength, their blur, basis and light shares."""

from .blur import blur
from .film import means_by_strips
from .image import LAMP, NOTHING, RenderedImage
from .light_shares import LightShares, light_shares
from .spectral_basis import from_basis

__all__ = [
    "LAMP",
    "NOTHING",
    "LightShares",
    "RenderedImage",
    "blur",
    "from_basis",
    "light_shares",
    "means_by_strips",
]
