"""Patterns of a difference whose means cancel: grids, ripples, lines, tiles, textures."""

from .correlation import difference_variance, of_blocks, of_filter, of_neighbours
from .dark import dark_pixels
from .difference import Difference, Finding
from .lines import odd_lines, odd_tiles, tile_steps
from .mirror import mirror_order
from .moved import moved_texture
from .periodic import periodic, without_period
from .pooled_mean import CANCELLING, POWER, SHARES, PooledMean, pool_of_finding
from .spread import block_spread
from .texture import FIXED_TEXTURE, fine_structure, textures
from .wave import ripple

__all__ = [
    "CANCELLING",
    "FIXED_TEXTURE",
    "POWER",
    "SHARES",
    "Difference",
    "Finding",
    "PooledMean",
    "block_spread",
    "dark_pixels",
    "difference_variance",
    "fine_structure",
    "mirror_order",
    "moved_texture",
    "odd_lines",
    "odd_tiles",
    "of_blocks",
    "of_filter",
    "of_neighbours",
    "periodic",
    "pool_of_finding",
    "ripple",
    "textures",
    "tile_steps",
    "without_period",
]
