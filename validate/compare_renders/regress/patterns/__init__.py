"""Patterns of a difference whose means cancel: grids, lines, tiles, textures, black pixels."""

from .dark import dark_pixels
from .difference import Difference, Finding
from .lines import odd_lines, odd_tiles, tile_steps
from .periodic import periodic, without_period
from .texture import FIXED_TEXTURE, textures

__all__ = [
    "FIXED_TEXTURE",
    "Difference",
    "Finding",
    "dark_pixels",
    "odd_lines",
    "odd_tiles",
    "periodic",
    "textures",
    "tile_steps",
    "without_period",
]
