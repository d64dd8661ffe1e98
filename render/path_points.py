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

#: So many vertices share one joint point set. Its lowest columns, the best ones, go where stratification
#: helps most: to the directions, two columns a vertex. Lamp points come last: where the lamp is seen whole,
#: their contribution is analytic.
_JOINT_VERTICES = 3
_PIXEL = 2 * _JOINT_VERTICES
_LIGHT = _PIXEL + 2
_ROULETTE = _LIGHT + 2 * _JOINT_VERTICES
_COLUMNS = _ROULETTE + 1
#: Columns of the vertices beyond, each with an order of its own.
_PADDED_DIRECTION, _PADDED_LIGHT, _PADDED_ROULETTE = 0, 2, 4


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

    The first vertices use one point set jointly. Each later vertex takes its points in an order of its own
    and scrambles them afresh (padding; Kollig and Keller 2002), so no path is cut short and each path alone
    is uniformly distributed. Scrambling by hashing after Laine and Karras (2011), constants of Burley,
    "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020.
    """

    def __init__(self, count: int, lane: mi.UInt32, seed: int) -> None:
        log2 = int(np.ceil(np.log2(max(count, 2))))
        self._table = mi.UInt32(_reversed_table(log2))
        self._mask = dr.opaque(mi.UInt32, (1 << log2) - 1)
        self._lane_seed = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))[0]

    def pixel(self, index: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where in its pixel path ``index`` begins."""
        seed = self._lane_seed
        u, v = (self._number(index * _COLUMNS + c, _seed_of(seed, c)) for c in (_PIXEL, _PIXEL + 1))
        return u, v

    def at_vertex(self, index: mi.UInt32, depth: mi.UInt32) -> VertexPoints:
        """Numbers of vertex ``depth`` (0 is what the camera sees) of path ``index``."""
        seed = _mixed(self._lane_seed ^ ((depth + 1) * 0x85EBCA6B))
        joint = depth < _JOINT_VERTICES
        base = _COLUMNS * dr.select(joint, index, _permuted(index, seed) & self._mask)
        direction = base + dr.select(joint, 2 * depth, _PADDED_DIRECTION)
        light = base + dr.select(joint, _LIGHT + 2 * depth, _PADDED_LIGHT)
        roulette = base + dr.select(joint, mi.UInt32(_ROULETTE), _PADDED_ROULETTE)
        where = (direction, direction + 1, light, light + 1, roulette)
        return VertexPoints(*(self._number(w, _seed_of(seed, c)) for c, w in enumerate(where)))

    def _number(self, where: mi.UInt32, seed: mi.UInt32) -> mi.Float:
        bits = dr.brev(_permuted(dr.gather(mi.UInt32, self._table, where), seed))
        return mi.Float(bits >> 8) * (1.0 / 16777216.0)


def _seed_of(seed: mi.UInt32, column: int) -> mi.UInt32:
    """A seed of its own for each column. Cheaper hashes leave pairs of columns dependent."""
    return _mixed(seed + (0x9E3779B9 * (column + 1) & 0xFFFFFFFF))


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
