"""Patterns of a difference: at edges, and with means that cancel (grids, lines, tiles, textures, black pixels)."""

from .dark import dark_pixels
from .difference import Difference, Finding
from .edges import EDGE_PATTERNS, EdgePattern, edge_patterns
from .lines import odd_lines, odd_tiles, tile_steps
from .periodic import periodic, without_period
from .texture import FIXED_TEXTURE, textures

__all__ = [
    "EDGE_PATTERNS",
    "FIXED_TEXTURE",
    "Difference",
    "EdgePattern",
    "Finding",
    "dark_pixels",
    "edge_patterns",
    "odd_lines",
    "odd_tiles",
    "periodic",
    "textures",
    "tile_steps",
    "without_period",
]
