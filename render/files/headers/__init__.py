"""Headers of picture files: entries, windows, layers of channels, units of wavelength."""

from .envi_header import EnviHeader, is_envi, read_header
from .exr_layers import layers_of, listed, one_layer_hint, require_one_layer
from .wavelength_units import LONGEST_NM, SHORTEST_NM, in_nanometres, nanometres_per_unit, same_unit, states_no_unit
from .windows import (
    Window,
    common_pixels,
    exr_window,
    inside_display,
    window_in_file,
    window_of,
    window_of_header,
    with_window,
)

__all__ = [
    "LONGEST_NM",
    "SHORTEST_NM",
    "EnviHeader",
    "Window",
    "common_pixels",
    "exr_window",
    "in_nanometres",
    "inside_display",
    "is_envi",
    "layers_of",
    "listed",
    "nanometres_per_unit",
    "one_layer_hint",
    "read_header",
    "require_one_layer",
    "same_unit",
    "states_no_unit",
    "window_in_file",
    "window_of",
    "window_of_header",
    "with_window",
]
