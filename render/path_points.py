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
#: Words of each point: two columns, 16 bits of each, in a word; gathering is what takes time.
_WORDS = _PIXEL + 1
#: Words of each point for its vertices: the lamp's two columns, and above them that of the roulette.
_LAMP_WORDS = _JOINT_VERTICES
#: Paths beyond so many take other scramblings of the same points.
_LOG2_MOST_POINTS = 16


@lru_cache(maxsize=8)
def _reversed_tables(log2_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Sobol' points, 2^m of them, m <= 16: (2^m * _WORDS,) 32 bits and (2^m * _LAMP_WORDS,) 64 bits.

    Of each column its leading 16 bits, in reverse order, as scrambling needs them.
    """
    count = 2 * (_WORDS + _LAMP_WORDS) + 1
    leading = (qmc.Sobol(count, scramble=False, bits=32).random_base2(log2_points) * 2.0**16).astype(">u2")
    bits = np.unpackbits(leading.view(np.uint8).reshape(*leading.shape, 2), axis=-1)
    columns = np.packbits(bits[..., ::-1], axis=-1).view(">u2")[..., 0].astype(np.uint64)
    pairs = columns[:, 0:-1:2] | columns[:, 1::2] << np.uint64(16)
    lamp = pairs[:, _WORDS:] | columns[:, -1:] << np.uint64(32)
    return pairs[:, :_WORDS].astype(np.uint32).ravel(), lamp.ravel()


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
        words, lamp_words = _reversed_tables(log2)
        self._table, self._lamp_table = mi.UInt32(words), mi.UInt64(lamp_words)
        self._mask = dr.opaque(mi.UInt32, (1 << log2) - 1)
        self._lane_seed = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))[0]

    def pixel(self, index: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where in its pixel path ``index`` begins."""
        index, seed = self._own(index)
        return _pair(self._word(index, _PIXEL), _turned(seed))

    def at_vertex(self, index: mi.UInt32, depth: mi.UInt32) -> VertexPoints:
        """Numbers of vertex ``depth`` (0 is what the camera sees) of path ``index``."""
        point, joint, seed = self._point(index, depth)
        seed = _turned(seed * 0x2C1B3C6D)
        word = dr.gather(mi.UInt64, self._lamp_table, point * _LAMP_WORDS + dr.select(joint, depth, 0))
        roulette = _scrambled(mi.UInt32(word >> 32), _turned(_turned(seed)))
        return VertexPoints(*_pair(mi.UInt32(word), seed), roulette)

    def direction(self, index: mi.UInt32, depth: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Where path ``index`` goes from vertex ``depth``."""
        point, joint, seed = self._point(index, depth)
        return _pair(self._word(point, dr.select(joint, depth, 0)), _turned(seed))

    def onward(self, index: mi.UInt32, depth: mi.UInt32, ended: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """``direction``, or ``pixel`` of the next path where this one has ``ended``: at the cost of one."""
        point, joint, seed = self._point(index, depth)
        next_index, next_seed = self._own(index + 1)
        column = dr.select(ended, _PIXEL, dr.select(joint, depth, 0))
        word = self._word(dr.select(ended, next_index, point), column)
        return _pair(word, _turned(dr.select(ended, next_seed, seed)))

    def _own(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """A path's index in its set of points, and the seed of that set."""
        if not self._several_sets:
            return index, self._lane_seed
        return index & self._mask, _mixed(self._lane_seed + (index >> _LOG2_MOST_POINTS) * 0x9E3779B9)

    def _point(self, index: mi.UInt32, depth: mi.UInt32) -> tuple[mi.UInt32, mi.Bool, mi.UInt32]:
        """Which point a vertex takes, whether all its columns or the joint set's, and the vertex' seed."""
        index, seed = self._own(index)
        seed = _mixed(seed ^ ((depth + 1) * 0x85EBCA6B))
        joint = depth < _JOINT_VERTICES
        return dr.select(joint, index, _permuted(index, seed) & self._mask), joint, seed

    def _word(self, point: mi.UInt32, column: mi.UInt32 | int) -> mi.UInt32:
        return dr.gather(mi.UInt32, self._table, point * _WORDS + column)


def _pair(word: mi.UInt32, seed: mi.UInt32) -> tuple[mi.Float, mi.Float]:
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
