"""The images that integrators return, their blur, basis, noise and shares of light."""

from .blur import blur
from .film import means_by_strips
from .image import LAMP, NOTHING, RenderedImage
from .light_shares import Accumulators, LightShares, accumulators, light_shares
from .pixel_noise import ESTIMATE_DEGREES, high_pass, variance_of_neighbours
from .render_job import BATCH_SEED_STEP, RenderJob
from .spectral_basis import from_basis

__all__ = [
    "BATCH_SEED_STEP",
    "ESTIMATE_DEGREES",
    "LAMP",
    "NOTHING",
    "Accumulators",
    "LightShares",
    "RenderJob",
    "RenderedImage",
    "accumulators",
    "blur",
    "from_basis",
    "high_pass",
    "light_shares",
    "means_by_strips",
    "variance_of_neighbours",
]
