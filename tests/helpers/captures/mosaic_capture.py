"""Captures of a rendered image behind a mosaic: one frame of all channels, which stands in a band for each channel."""

from cboxlab.rendering.synthetic import CaptureSettings, behind_mosaic, unit_factors
from cboxlab.validation.synthetic.model_capture import photograph_image

__all__ = ["write_mosaic_capture"]


def write_mosaic_capture(folder, pattern, image, scene, camera, seed, effects=(), **changes):
    """Photograph an image behind a mosaic, without a filter; return the folder and the true constant C."""
    settings = behind_mosaic(CaptureSettings(**changes), pattern)
    photograph_image(folder, image, effects, scene, scene, camera, settings=settings, seed=seed)
    factors = unit_factors(settings, camera.width_px)
    return folder, factors.factor[0] * (settings.f_number * settings.image_distance_mm) ** 2
