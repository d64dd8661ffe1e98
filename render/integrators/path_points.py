"""Sample points of paths of any length: Owen-scrambled Sobol' points, padded."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..device import device_array, dr, mi, seed_of_lanes, sobol_table

__all__ = ["PathPoints", "VertexPoints"]

#: Number of vertices that share one joint point set. Its first columns, the best stratified, are used for the
#: directions, two per vertex, where stratification helps most. The lamp's columns come last, since the contribution of
#: a fully visible lamp is analytic.
_JOINT_VERTICES = 3
#: Index of the word with the position in the pixel, after those of the directions.
_PIXEL = _JOINT_VERTICES
#: Words of each point, with 16 bits of two columns in each; this reduces the number of gathers, which take most time.
_WORDS = _PIXEL + 1
#: 64-bit words of each point: the two columns of the lamp and, in the upper half, that of Russian roulette.
_LAMP_WORDS = _JOINT_VERTICES
#: Logarithm of the largest number of points; beyond 2^16 paths, the same points are used with other scramblings.
_LOG2_MOST_POINTS = 16


@lru_cache(maxsize=8)
def _reversed_tables(log2_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Words of 2^m Sobol' points, m <= 16, as arrays of 32 and of 64 bits.

    They are (2^m * _WORDS,) and (2^m * _LAMP_WORDS,), and hold the leading 16 bits of each column, in reverse order for
    the scrambling.
    """
    count = 2 * (_WORDS + _LAMP_WORDS) + 1
    leading = (sobol_table(count, log2_points) >> 16).astype(">u2")
    bits = np.unpackbits(leading.view(np.uint8).reshape(*leading.shape, 2), axis=-1)
    columns = np.packbits(bits[..., ::-1], axis=-1).view(">u2")[..., 0].astype(np.uint64)
    pairs = columns[:, 0:-1:2] | columns[:, 1::2] << np.uint64(16)
    lamp = pairs[:, _WORDS:] | columns[:, -1:] << np.uint64(32)
    return pairs[:, :_WORDS].astype(np.uint32).ravel(), lamp.ravel()


@dataclass
class VertexPoints:
    """Numbers in [0, 1) of each lane for a vertex of a path."""

    #: First number for the point of a lamp.
    light_u: mi.Float
    #: Second number for the point of a lamp.
    light_v: mi.Float
    #: Number for Russian roulette.
    roulette: mi.Float


class PathPoints:
    """Sample points for paths of any length, independent for every lane and seed.

    The first vertices share one joint point set. Each later vertex permutes and scrambles the points independently
    (padding; Kollig and Keller 2002), so paths can have any length and each path is uniformly distributed. Scrambling
    by hashing after Laine and Karras (2011), constants of Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4),
    2020.

    Parameters
    ----------
    count
        Number of paths of each lane.
    lane
        Number of each lane, from which its scrambling is derived.
    seed
        Seed of all lanes, or of each.
    """

    def __init__(self, count: int, lane: mi.UInt32, seed: int | mi.UInt32) -> None:
        log2 = int(np.ceil(np.log2(max(count, 2))))
        self._several_sets = log2 > _LOG2_MOST_POINTS
        log2 = min(log2, _LOG2_MOST_POINTS)
        direction_words, lamp_words = _reversed_tables(log2)
        self._table, self._lamp_table = device_array(mi.UInt32, direction_words), device_array(mi.UInt64, lamp_words)
        self._mask = dr.opaque(mi.UInt32, (1 << log2) - 1)
        self._lane_seed = mi.sample_tea_32(lane, seed_of_lanes(seed))[0]

    def pixel(self, index: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Position of a path in its pixel.

        Parameters
        ----------
        index
            Index of each lane's path.

        Returns
        -------
        tuple[Float, Float]
            Numbers in [0, 1).
        """
        index, seed = self._index_and_seed(index)
        return _pair(self._word(index, _PIXEL), _next_seed(seed))

    def at_vertex(self, index: mi.UInt32, depth: mi.UInt32) -> VertexPoints:
        """Numbers for the lamp sample and Russian roulette at a vertex.

        Parameters
        ----------
        index
            Index of each lane's path.
        depth
            Number of the vertex; 0 is the first visible surface.

        Returns
        -------
        VertexPoints
            The numbers.
        """
        point, joint, seed = self._point(index, depth)
        seed = _next_seed(seed * 0x2C1B3C6D)
        word = dr.gather(mi.UInt64, self._lamp_table, point * _LAMP_WORDS + dr.select(joint, depth, 0))
        roulette = _scrambled(mi.UInt32(word >> 32), _next_seed(_next_seed(seed)))
        return VertexPoints(*_pair(mi.UInt32(word), seed), roulette)

    def direction(self, index: mi.UInt32, depth: mi.UInt32) -> tuple[mi.Float, mi.Float]:
        """Numbers for the direction of a path after a vertex.

        Parameters
        ----------
        index
            Index of each lane's path.
        depth
            Number of the vertex.

        Returns
        -------
        tuple[Float, Float]
            Numbers in [0, 1).
        """
        point, joint, seed = self._point(index, depth)
        return _pair(self._word(point, dr.select(joint, depth, 0)), _next_seed(seed))

    def onward(self, index: mi.UInt32, depth: mi.UInt32, ended: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """`direction`, or `pixel` of the next path where this one has ended, with a single gather.

        Parameters
        ----------
        index
            Index of each lane's path.
        depth
            Number of the vertex.
        ended
            Whether the path ends there.

        Returns
        -------
        tuple[Float, Float]
            Numbers in [0, 1).
        """
        point, joint, seed = self._point(index, depth)
        next_index, next_seed = self._index_and_seed(index + 1)
        column = dr.select(ended, _PIXEL, dr.select(joint, depth, 0))
        word = self._word(dr.select(ended, next_index, point), column)
        return _pair(word, _next_seed(dr.select(ended, next_seed, seed)))

    def _index_and_seed(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """Index of a path in its point set, and the seed of that set."""
        if not self._several_sets:  # the path after the last one is asked for, and not used
            return index & self._mask, self._lane_seed
        return index & self._mask, _mixed(self._lane_seed + (index >> _LOG2_MOST_POINTS) * 0x9E3779B9)

    def _point(self, index: mi.UInt32, depth: mi.UInt32) -> tuple[mi.UInt32, mi.Bool, mi.UInt32]:
        """Point of a vertex, whether it belongs to the joint set, and the seed of the vertex."""
        index, seed = self._index_and_seed(index)
        seed = _mixed(seed ^ ((depth + 1) * 0x85EBCA6B))
        joint = depth < _JOINT_VERTICES
        return dr.select(joint, index, _shuffled(index, seed) & self._mask), joint, seed

    def _word(self, point: mi.UInt32, column: mi.UInt32 | int) -> mi.UInt32:
        """Word of a point with two columns for directions or the pixel."""
        return dr.gather(mi.UInt32, self._table, point * _WORDS + column)


def _pair(word: mi.UInt32, seed: mi.UInt32) -> tuple[mi.Float, mi.Float]:
    """Two scrambled numbers from the halves of a word."""
    return _scrambled(word & 0xFFFF, seed), _scrambled(word >> 16, _next_seed(seed))


def _scrambled(reversed_bits: mi.UInt32, seed: mi.UInt32) -> mi.Float:
    """Scrambled number in [0, 1), of 24 bits, from reversed leading bits."""
    return mi.Float(dr.brev(_permuted(reversed_bits, seed)) >> 8) * (1.0 / 16777216.0)


def _next_seed(seed: mi.UInt32) -> mi.UInt32:
    """Another seed from a well-mixed one.

    Scrambling derives the leading bits from a seed's lowest bits and from those above the 16th. With a shift of 15 or
    16 bits these would be correlated, and so would columns.
    """
    seed = seed * 0x9E3779B1
    return seed ^ (seed >> 11)


def _mixed(x: mi.UInt32) -> mi.UInt32:
    """An integer hash with good avalanche: lowbias32.

    Wellons, "Prospecting for Hash Functions", 2018.
    """
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


def _shuffled(index: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """Owen's scrambling of an index, in which each bit depends on higher bits only.

    A point's low bits state in which part of the unit interval it lies. If they depended on lower bits only, the same
    half of all paths would lie in the same halves at every vertex.
    """
    return dr.brev(_permuted(dr.brev(index), seed))


def _permuted(x: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """A permutation of integers in which each bit depends on lower bits only."""
    x = x ^ (x * 0x3D20ADEA)
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)
