"""The random numbers of whole paths: Owen-scrambled Sobol' points, padded beyond the second vertex."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import qmc

from . import variant as _variant  # noqa: F401  (activates a variant)

__all__ = ["PathPoints", "VertexPoints"]

#: Columns of the Sobol' table. The lowest go where stratification helps most: the direction of the first
#: bounce with the lamp point seen from there, then pixel and lamp point of the first vertex.
_FIRST = {"direction_u": 0, "direction_v": 1, "light_u": 6, "light_v": 7, "roulette": 10}
_LATER = {"direction_u": 8, "direction_v": 9, "light_u": 2, "light_v": 3, "roulette": 10}
_PIXEL = (4, 5)
_COLUMNS = 11


@lru_cache(maxsize=8)
def _reversed_table(log2_points: int) -> np.ndarray:
    """(2^m * columns,) Sobol' points, their 32 bits in reverse order, which is how scrambling needs them."""
    points = (qmc.Sobol(_COLUMNS, scramble=False, bits=32).random_base2(log2_points) * 2.0**32).astype(">u4")
    bits = np.unpackbits(points.view(np.uint8).reshape(*points.shape, 4), axis=-1)
    return np.packbits(bits[..., ::-1], axis=-1).view(">u4").astype(np.uint32).ravel()


@dataclass
class VertexPoints:
    """Five numbers in [0, 1) per lane: what one vertex of a path needs."""

    direction_u: mi.Float
    direction_v: mi.Float
    light_u: mi.Float
    light_v: mi.Float
    roulette: mi.Float


class PathPoints:
    """Numbers for paths of any length, ``count`` paths per lane, other numbers for every lane and seed.

    The first two vertices use one 11-dimensional point set jointly. Each later vertex takes its points in an
    order of its own and scrambles them afresh (padding; Kollig and Keller 2002), so no path is cut short and
    each path alone is uniformly distributed. Scrambling by hashing after Laine and Karras (2011), constants
    of Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020.
    """

    def __init__(self, count: int, lane: mi.UInt32, seed: int) -> None:
        log2 = int(np.ceil(np.log2(max(count, 2))))
        self._table = mi.UInt32(_reversed_table(log2))
        self._mask = dr.opaque(mi.UInt32, (1 << log2) - 1)
        self._lane_seed = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))[0]

    def pixel(self, index: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where in its pixel path ``index`` begins."""
        u, v = (self._number(index * _COLUMNS + c, _mixed(self._lane_seed + _stride(c))) for c in _PIXEL)
        return u, v

    def at_vertex(self, index: mi.UInt32, depth: mi.UInt32) -> VertexPoints:
        """Numbers of vertex ``depth`` (0 is what the camera sees) of path ``index``."""
        vertex_seed = _mixed(self._lane_seed ^ (depth * 0x85EBCA6B))
        order = dr.select(depth < 2, index, _permuted(index, vertex_seed) & self._mask)
        base = order * _COLUMNS
        numbers = {}
        for name, column in _FIRST.items():
            where = base + dr.select(depth == 0, mi.UInt32(column), mi.UInt32(_LATER[name]))
            numbers[name] = self._number(where, _mixed(vertex_seed + _stride(column)))
        return VertexPoints(**numbers)

    def _number(self, where: mi.UInt32, seed: mi.UInt32) -> mi.Float:
        bits = dr.brev(_permuted(dr.gather(mi.UInt32, self._table, where), seed))
        return mi.Float(bits >> 8) * (1.0 / 16777216.0)


def _stride(column: int) -> int:
    """Keeps the seeds of columns apart (golden ratio)."""
    return 0x9E3779B9 * (column + 1) & 0xFFFFFFFF


def _mixed(x: mi.UInt32) -> mi.UInt32:
    """An integer hash with good avalanche (Wellons, "Prospecting for Hash Functions", 2018: lowbias32)."""
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


def _permuted(x: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """A permutation of integers in which each bit depends on lower bits only."""
    x = x ^ (x * 0x3D20ADEA)
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)
