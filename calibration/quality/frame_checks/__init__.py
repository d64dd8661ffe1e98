"""Checks of a capture's frames, by their counts and times."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .counts import check_black_levels, check_counts, check_level_of_darks
    from .dark_light import check_dark_temperature, check_light_in_darks
    from .darks import check_bias_drift, check_darks
    from .fields import check_fields, check_lines, check_pattern
    from .fingerprint import check_division, check_fingerprint, check_flat_shapes
    from .repeats import check_independence, check_noise, check_repeats
    from .schedule import check_brackets, check_exposures, check_schedule
    from .stacks import Stack, read_stacks
    from .suspicion import Suspicion
    from .warm_up import check_warm_up

__all__ = [
    "Stack",
    "Suspicion",
    "check_bias_drift",
    "check_black_levels",
    "check_brackets",
    "check_counts",
    "check_dark_temperature",
    "check_darks",
    "check_division",
    "check_exposures",
    "check_fields",
    "check_fingerprint",
    "check_flat_shapes",
    "check_independence",
    "check_level_of_darks",
    "check_light_in_darks",
    "check_lines",
    "check_noise",
    "check_pattern",
    "check_repeats",
    "check_schedule",
    "check_warm_up",
    "read_stacks",
]

__getattr__, __dir__ = lazy_names(__name__)
