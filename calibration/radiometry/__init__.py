"""Radiance from corrected counts: sensor equation, constant C, spectral sensitivities."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .broad_light_sensitivity import smooth_wiener
    from .hyperspectral import HyperspectralCube, as_scene, hyperspectral_cube, region_mask
    from .named_camera_levels import channel_levels, level_notes
    from .radiometry import Radiometry, measure_constant
    from .registration import register
    from .sensor_equation import (
        band_responses,
        capture_factors,
        counts_over_constant,
        filter_steps_nm,
        missing_keys,
        optical_factor,
        response_curve,
    )
    from .spectral_sensitivity import NarrowBandReadings
    from .uncertainty import Uncertainty, measure_uncertainty, xyz_parts

__all__ = [
    "HyperspectralCube",
    "NarrowBandReadings",
    "Radiometry",
    "Uncertainty",
    "as_scene",
    "band_responses",
    "capture_factors",
    "channel_levels",
    "counts_over_constant",
    "filter_steps_nm",
    "hyperspectral_cube",
    "level_notes",
    "measure_constant",
    "measure_uncertainty",
    "missing_keys",
    "optical_factor",
    "region_mask",
    "register",
    "response_curve",
    "smooth_wiener",
    "xyz_parts",
]

__getattr__, __dir__ = lazy_names(__name__)
