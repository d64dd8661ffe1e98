"""Shares of pixels covered by a few flat faces, seen through a pinhole.

From one point a face's depth and sides are linear functions of a ray's slopes: with the ray e + t d, e the eye, the
plane n . p = c is met at 1 / t = n . d / (c - n . e), and the ray passes inside a side a . p > b where
(a + (a . e - b) n / (c - n . e)) . d > 0. The face with the greatest 1 / t is seen. Most pixels see only a few faces,
which are chosen beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..device import SobolPoints, device_array, dr, mi
from .flat_faces import FlatFaces
from .tracer import undistorted_positions

__all__ = ["polygon_coverage"]

#: Pixels are sorted by how many faces may be seen in them; each class is a kernel of its own.
_CLASSES = (2, 4, 8)

#: Part of a pixel by which its borders are moved out, for the curvature of distorted lines.
_MARGIN = 0.01


def polygon_coverage(
    faces: FlatFaces, cameras: Sequence[Camera], pixels: NDArray[np.int64], samples: int, seed: int
) -> NDArray[np.float32]:
    """(c, n, f) share, 0 to 1, of some ``pixels`` (n,) of each of c cameras in which a face is the nearest.

    cameras : with one picture size; pixels are counted along its rows. samples : low-discrepancy positions in each
    pixel that may see several faces, the same ones for all cameras.
    """
    functions = np.array([_functions(faces.planes, camera) for camera in cameras])
    found = [_candidates(own, camera, pixels) for own, camera in zip(functions, cameras, strict=True)]
    candidates, alone = np.array(found).swapaxes(0, 1)
    coverage = alone.astype(np.float32)
    counts = np.where(alone.any(axis=-1), 0, candidates.sum(axis=-1))
    count = functions.shape[1]
    limits = [*(k for k in _CLASSES if k < count), count]
    for fewest, most in zip([0, *limits], limits, strict=False):
        seen_by, own = np.nonzero((counts > fewest) & (counts <= most))
        if len(own):
            near = candidates[seen_by, own]
            chosen = np.argsort(~near, axis=1, kind="stable")[:, :most]
            near = np.take_along_axis(near, chosen, axis=1)
            # the last function is that of no face
            listed = np.where(near, seen_by[:, None] * count + chosen, len(cameras) * count)
            pixel, of = (device_array(mi.UInt32, index) for index in (pixels[own], seen_by))
            positions, points = (
                undistorted_positions(cameras, pixel, of),
                SobolPoints(2, samples, pixel, seed),
            )
            shares = _sampled(functions.reshape(-1, *functions.shape[2:]), listed, positions, points, samples)
            rows, _ = np.nonzero(near)
            coverage[seen_by[rows], own[rows], chosen[near]] = shares[near]
    return coverage


def _functions(planes: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(f, 5, 3) coefficients of (x, y, 1): 1 / t, and the four sides, positive inside."""
    eye = camera.position_mm
    heights = planes[..., :3] @ eye - planes[..., 3]
    away = np.where(np.abs(heights[:, :1]) > 0, -heights[:, :1], np.inf)  # in its own plane no face is seen
    depth = planes[:, 0, :3] / away
    sides = planes[:, 1:, :3] + heights[:, 1:, None] * depth[:, None]
    return np.concatenate([depth[:, None], sides], axis=1) @ camera.rotation.T


def _candidates(
    functions: NDArray[np.float64], camera: Camera, pixels: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n, f) faces that may be seen in each pixel, and those that are all that it sees."""
    rows, columns = np.divmod(pixels, camera.width_px)
    down, right = np.array([[-0.5, -0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, 0.5]])[..., None]
    corners = camera.slopes(columns + right, rows + down)
    low, high = corners.min(axis=0), corners.max(axis=0)
    # (3, n) centres and half sizes, in homogeneous coordinates
    middle = np.vstack([(low + high).T / 2, np.ones(len(low))])
    half = np.vstack([(high - low).T * (0.5 + _MARGIN), np.zeros(len(low))])
    depth, *sides = functions.transpose(1, 0, 2)
    touching, covering = np.ones((2, len(depth), len(low)), bool)
    for side in sides:
        value, spread = side @ middle, np.abs(side) @ half
        touching &= value + spread > 0
        covering &= value - spread > 0
    value, spread = depth @ middle, np.abs(depth) @ half
    nearest, furthest = value + spread, value - spread
    touching &= nearest > 0
    covering &= furthest > 0
    wall = np.where(covering, furthest, -np.inf).max(axis=0)
    candidates = touching & (nearest >= wall)
    return candidates.T, (covering & candidates & (candidates.sum(axis=0) == 1)).T


def _sampled(
    functions: NDArray[np.float64],
    listed: NDArray[np.int64],
    positions: Callable[[mi.Float, mi.Float], tuple[mi.Float, mi.Float]],
    points: SobolPoints,
    samples: int,
) -> NDArray[np.float32]:
    """(n, k) shares of the faces ``listed`` (n, k) at each lane's positions; beyond the last is that of none."""
    count, most = listed.shape
    never = np.broadcast_to([0.0, 0.0, -1.0], functions[:1].shape)
    # a multiple of four numbers a face, which are read four at a time
    rows = np.concatenate([functions, never]).reshape(-1, functions[0].size)
    table = device_array(mi.Float, np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4))))
    fours = -(-rows.shape[1] // 4)
    lane = dr.arange(mi.UInt32, count)
    index = device_array(mi.UInt32, listed)
    own = []
    for k in range(most):
        start = fours * dr.gather(mi.UInt32, index, lane * most + k)
        own.append([x for i in range(fours) for x in dr.gather(mi.Vector4f, table, start + i)])

    def body(i: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
        x, y = positions(points.point(i, 0), points.point(i, 1))
        nearest, face = mi.Float(0), dr.full(mi.UInt32, most, 1)
        for k, row in enumerate(own):
            depth, *sides = (dr.fma(row[j], x, dr.fma(row[j + 1], y, row[j + 2])) for j in range(0, 15, 3))
            inside = dr.minimum(dr.minimum(sides[0], sides[1]), dr.minimum(sides[2], sides[3])) > 0
            seen = inside & (depth > nearest)
            nearest, face = dr.select(seen, depth, nearest), dr.select(seen, k, face)
        return i + 1, [total + dr.select(face == k, mi.Float(1), mi.Float(0)) for k, total in enumerate(sums)]

    last = dr.opaque(mi.UInt32, samples)
    start = (dr.zeros(mi.UInt32, count), [dr.zeros(mi.Float, count) for _ in range(most)])
    _, sums = dr.while_loop(start, lambda i, _: i < last, body)
    dr.eval(sums)
    return (np.stack([s.numpy() for s in sums], axis=-1) / samples).astype(np.float32)
