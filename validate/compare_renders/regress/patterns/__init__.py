"""Patterns of a difference whose means cancel: grids, ripples, lines, tiles, textures."""

from .all_patterns import all_patterns
from .correlation import clustering_by_filter, clustering_of_blocks, clustering_of_neighbours, difference_variance
from .dark import cut_values, dark_pixels
from .difference import Difference, Finding, common_size
from .fine_light import BLOCK_PX, alike_along_edges, block_sums, moved_slightly, other_contrast, sum_by_blocks
from .moved import mirror_order, moved_texture
from .noise_of_sides import filtered_noise, reused_numbers, shared_numbers
from .odd_parts import fixed_lines, odd_lines, odd_tiles, tile_steps
from .odd_squares import moved_part, small_part
from .periodic import periodic, without_period
from .pooled_mean import (
    CANCELLING,
    GRIDS,
    HIDDEN_BY,
    MEANS,
    POWER,
    SHARES,
    STRUCTURE,
    PooledMean,
    certain_layers,
    certain_numbers,
    pool_of_finding,
    unknown_mean,
)
from .slow import slow_change, without_slow
from .spread import block_changes, block_spread, ranked_squares, scatter_of_blocks, steady_sigmas
from .texture import FIXED_TEXTURE, fine_structure, fixed_pixels, textures
from .wave import ripple

__all__ = [
    "BLOCK_PX",
    "CANCELLING",
    "FIXED_TEXTURE",
    "GRIDS",
    "HIDDEN_BY",
    "MEANS",
    "POWER",
    "SHARES",
    "STRUCTURE",
    "Difference",
    "Finding",
    "PooledMean",
    "alike_along_edges",
    "all_patterns",
    "block_changes",
    "block_spread",
    "block_sums",
    "certain_layers",
    "certain_numbers",
    "clustering_by_filter",
    "clustering_of_blocks",
    "clustering_of_neighbours",
    "common_size",
    "cut_values",
    "dark_pixels",
    "difference_variance",
    "filtered_noise",
    "fine_structure",
    "fixed_lines",
    "fixed_pixels",
    "mirror_order",
    "moved_part",
    "moved_slightly",
    "moved_texture",
    "odd_lines",
    "odd_tiles",
    "other_contrast",
    "periodic",
    "pool_of_finding",
    "ranked_squares",
    "reused_numbers",
    "ripple",
    "scatter_of_blocks",
    "shared_numbers",
    "slow_change",
    "small_part",
    "steady_sigmas",
    "sum_by_blocks",
    "textures",
    "tile_steps",
    "unknown_mean",
    "without_period",
    "without_slow",
]
