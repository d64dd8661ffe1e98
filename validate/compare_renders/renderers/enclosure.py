"""Radiosity of a cube with one emitting face: an independent reference for all reflections.

It shares no code with the renderer. Form factors between square patches are exact integrals in closed form, and the
linear system is solved directly. Mean radiances of faces are extrapolated from three grids (Richardson).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

__all__ = ["FACES", "cube_radiosity"]

#: Faces of the cube: name to (axis of the normal, 0 or 1 for the side at the origin or at 1).
FACES = {"left": (0, 1), "right": (0, 0), "ceiling": (1, 1), "floor": (1, 0), "back": (2, 1), "front": (2, 0)}
#: Largest ratio of steps for which means are extrapolated: nearer to 1 they do not converge.
_MAX_STEP_RATIO = 0.9


def cube_radiosity(reflectances: Mapping[str, float], emitting: str, finest: int = 24) -> dict[str, float]:
    """Mean radiance of each face of a closed, empty cube of Lambertian faces, one emitting.

    Radiosities B of n patches solve B = E + rho F B, with the form factors F. The means of three grids, each twice as
    fine as the one before, are extrapolated by the ratio of their steps (Richardson).

    Parameters
    ----------
    reflectances
        Reflectance of each face by name; that of the emitting face is not used.
    emitting
        Name of the face that has radiance 1 and reflects nothing.
    finest
        Patches along an edge of the finest grid, a multiple of 4.

    Returns
    -------
    dict
        Mean radiance by name of the face, relative to the emitting one's.
    """
    coarse, middle, fine = (_means(reflectances, emitting, n) for n in (finest // 4, finest // 2, finest))
    means = {}
    for name, last in fine.items():
        steps = middle[name] - coarse[name], last - middle[name]
        ratio = steps[1] / steps[0] if steps[0] else 0.0
        means[name] = last + (steps[1] * ratio / (1 - ratio) if 0 < ratio < _MAX_STEP_RATIO else 0.0)
    return means


def _means(reflectances: Mapping[str, float], emitting: str, n: int) -> dict[str, float]:
    """Mean radiance of each face, on n x n patches a face."""
    names = list(FACES)
    opposed, adjacent = _parallel(n), _perpendicular(n)
    size = n * n
    factors = np.zeros((6 * size, 6 * size))
    row, column = (index.ravel() for index in np.indices((n, n)))
    for i, emitter in enumerate(names):
        for j, receiver in enumerate(names):
            axis, side = FACES[emitter]
            axis_2, side_2 = FACES[receiver]
            if i == j:
                continue
            block = np.s_[i * size : (i + 1) * size, j * size : (j + 1) * size]
            if axis == axis_2:
                difference = np.abs(row[:, None] - row), np.abs(column[:, None] - column)
                factors[block] = opposed[difference]
                continue
            # patch numbers along the other face's normal and along the common edge
            common = 3 - axis - axis_2
            numbers, numbers_2 = _patch_numbers(axis, row, column), _patch_numbers(axis_2, row, column)
            from_edge = numbers[axis_2] if side_2 == 0 else n - 1 - numbers[axis_2]
            height = numbers_2[axis] if side == 0 else n - 1 - numbers_2[axis]
            apart = np.abs(numbers[common][:, None] - numbers_2[common])
            factors[block] = adjacent[from_edge[:, None], height[None, :], apart]
    emitted = np.zeros(6 * size)
    emitted[names.index(emitting) * size : (names.index(emitting) + 1) * size] = 1.0
    reflectance = np.repeat([0.0 if name == emitting else reflectances[name] for name in names], size)
    radiance = np.linalg.solve(np.eye(6 * size) - reflectance[:, None] * factors, emitted)
    return {name: float(radiance[i * size : (i + 1) * size].mean()) for i, name in enumerate(names)}


def _patch_numbers(axis: int, row: NDArray, column: NDArray) -> dict[int, NDArray]:
    """Patch numbers along the two axes in the plane of a face with normal ``axis``."""
    first, second = (other for other in range(3) if other != axis)
    return {first: row, second: column}


def _parallel(n: int) -> NDArray[np.float64]:
    """(n, n) form factors between patches of opposed faces, by distance along each axis.

    The fourth mixed difference of Integral ln(r^2) over two opposed edges (contour integration, applied twice).
    """
    h = 1.0 / n
    d = np.arange(n) * h

    def potential(x: NDArray, y: NDArray) -> NDArray:
        a, b = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
        return y * a * np.arctan(y / a) + x * b * np.arctan(x / b) - 0.5 * np.log(1 + x * x + y * y)

    total = np.zeros((n, n))
    weights = ((-1, 1.0), (0, -2.0), (1, 1.0))
    for i, p in weights:
        for j, q in weights:
            total += p * q * potential((d + i * h)[:, None], (d + j * h)[None, :])
    return total / (2 * np.pi * h * h)


def _perpendicular(n: int) -> NDArray[np.float64]:
    """(n, n, n) form factors between patches of adjacent faces.

    Indices count patches: of the first from the common edge, of the second from it, and between the two along it.
    """
    h = 1.0 / n

    def potential(x: NDArray, z: NDArray, y: NDArray) -> NDArray:
        square = x * x + z * z
        root = np.sqrt(square)
        with np.errstate(divide="ignore", invalid="ignore"):
            arc = np.where(root > 0, y * root * np.arctan(y / root), 0.0)
            logs = np.where(square + y * y > 0, 0.25 * (square - y * y) * np.log(square + y * y), 0.0)
        return arc - logs

    edges = np.arange(n + 1) * h
    x, z = edges[:, None, None], edges[None, :, None]
    along = np.zeros((n + 1, n + 1, n))
    for j, q in ((-1, 1.0), (0, -2.0), (1, 1.0)):
        along += q * potential(x, z, ((np.arange(n) + j) * h)[None, None, :])
    mixed = np.diff(np.diff(along, axis=0), axis=1)
    return -mixed / (2 * np.pi * h * h)
