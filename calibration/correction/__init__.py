"""From raw frames to corrected band images: dark frames, flat fields, defects, noise, masks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .black_level import dark_level_sigmas
    from .corrected_bands import CorrectedBands, correct_bands
    from .correction import correct, evaluate_variance, uniform_flat
    from .dark import DarkLibrary, read_darks
    from .defects import hot_pixels
    from .full_well import with_full_well
    from .merged_noise import measure_merged_noise
    from .noise import ROUNDING_VARIANCE, NoiseModel, measure_noise
    from .noise_line import VarianceSamples, samples_of_repeats
    from .nominal_fall_off import LensAxis, fall_off_terms
    from .repeat_light import WARM_UP_REPEATS, with_steady_light

__all__ = [
    "ROUNDING_VARIANCE",
    "WARM_UP_REPEATS",
    "CorrectedBands",
    "DarkLibrary",
    "LensAxis",
    "NoiseModel",
    "VarianceSamples",
    "correct",
    "correct_bands",
    "dark_level_sigmas",
    "evaluate_variance",
    "fall_off_terms",
    "hot_pixels",
    "measure_merged_noise",
    "measure_noise",
    "read_darks",
    "samples_of_repeats",
    "uniform_flat",
    "with_full_well",
    "with_steady_light",
]

__getattr__, __dir__ = lazy_names(__name__)
