"""The random numbers of whole paths: Owen-scrambled Sobol' points, padded beyond the third vertex."""

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
_PIXEL = _JOINT_VERTICES
_LIGHT = _PIXEL + 1
_ROULETTE = _LIGHT + _JOINT_VERTICES
#: Words of the table for each point: two columns, 16 bits of each, in a word; gathering is what takes time.
_WORDS = _ROULETTE + 1
#: Paths beyond so many take other scramblings of the same points.
_LOG2_MOST_POINTS = 16


@lru_cache(maxsize=8)
def _reversed_table(log2_points: int) -> np.ndarray:
    """(2^m * words,) Sobol' points, m <= 16: their leading 16 bits in reverse order, as scrambling needs them."""
    points = qmc.Sobol(2 * _WORDS - 1, scramble=False, bits=32).random_base2(log2_points)
    leading = np.zeros((len(points), 2 * _WORDS), ">u2")
    leading[:, :-1] = points * 2.0**16
    bits = np.unpackbits(leading.view(np.uint8).reshape(*leading.shape, 2), axis=-1)
    columns = np.packbits(bits[..., ::-1], axis=-1).view(">u2")[..., 0].astype(np.uint32)
    return (columns[:, 0::2] | columns[:, 1::2] << 16).ravel()


@dataclass
class VertexPoints:
    """Three numbers in [0, 1) per lane: what a vertex of a path needs beside its direction onwards."""

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
        self._several_sets = log2 > _LOG2_MOST_POINTS
        log2 = min(log2, _LOG2_MOST_POINTS)
        self._table = mi.UInt32(_reversed_table(log2))
        self._mask = dr.opaque(mi.UInt32, (1 << log2) - 1)
        self._lane_seed = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))[0]

    def pixel(self, index: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where in its pixel path ``index`` begins."""
        index, seed = self._own(index)
        return self._pair(index * _WORDS + _PIXEL, _turned(seed))

    def at_vertex(self, index: mi.UInt32, depth: mi.UInt32) -> VertexPoints:
        """Numbers of vertex ``depth`` (0 is what the camera sees) of path ``index``."""
        base, joint, seed = self._row(index, depth)
        seed = _turned(seed * 0x2C1B3C6D)
        light = self._pair(base + _LIGHT + dr.select(joint, depth, 0), seed)
        roulette = _scrambled(dr.gather(mi.UInt32, self._table, base + _ROULETTE), _turned(_turned(seed)))
        return VertexPoints(*light, roulette)

    def direction(self, index: mi.UInt32, depth: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where path ``index`` goes from vertex ``depth``."""
        base, joint, seed = self._row(index, depth)
        return self._pair(base + dr.select(joint, depth, 0), _turned(seed))

    def onward(self, index: mi.UInt32, depth: mi.UInt32, ended: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """``direction``, or ``pixel`` of the next path where this one has ``ended``: at the cost of one."""
        base, joint, seed = self._row(index, depth)
        next_index, next_seed = self._own(index + 1)
        where = dr.select(ended, next_index * _WORDS + _PIXEL, base + dr.select(joint, depth, 0))
        return self._pair(where, _turned(dr.select(ended, next_seed, seed)))

    def _own(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """A path's index in its set of points, and the seed of that set."""
        if not self._several_sets:
            return index, self._lane_seed
        return index & self._mask, _mixed(self._lane_seed + (index >> _LOG2_MOST_POINTS) * 0x9E3779B9)

    def _row(self, index: mi.UInt32, depth: mi.UInt32) -> tuple[mi.UInt32, mi.Bool, mi.UInt32]:
        """Where in the table a vertex' words begin, whether they are the joint set's, and the vertex' seed."""
        index, seed = self._own(index)
        seed = _mixed(seed ^ ((depth + 1) * 0x85EBCA6B))
        joint = depth < _JOINT_VERTICES
        return _WORDS * dr.select(joint, index, _permuted(index, seed) & self._mask), joint, seed

    def _pair(self, where: mi.UInt32, seed: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        word = dr.gather(mi.UInt32, self._table, where)
        return _scrambled(word & 0xFFFF, seed), _scrambled(word >> 16, _turned(seed))


def _scrambled(reversed_bits: mi.UInt32, seed: mi.UInt32) -> mi.Float:
    return mi.Float(dr.brev(_permuted(reversed_bits, seed)) >> 8) * (1.0 / 16777216.0)


def _turned(seed: mi.UInt32) -> mi.UInt32:
    """Another seed from a well-mixed one.

    Scrambling takes the leading bits from a seed's lowest bits and from those above the 16th: with a shift of
    15 or 16 bits, these would depend on each other, and columns too.
    """
    seed = seed * 0x9E3779B1
    return seed ^ (seed >> 11)


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
