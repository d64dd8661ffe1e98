"""Checks of scene data: textures and media that conserve energy, triangles with an area."""

from __future__ import annotations

import numpy as np
from cboxlab.utils.errors import InputError

from .scene import Material, Surface, Texture

__all__ = [
    "inside_faults",
    "surface_faults",
    "texture_faults",
]

#: Rounding that a sum of weights times spectra may leave beyond 0 and 1.
ROUNDING = 1e-9
#: Smallest valid area of a triangle, relative to its longest edge squared.
SMALLEST_AREA = 1e-9


def texture_faults(texture: Texture, where: str) -> list[InputError]:
    """Fault of a texture that does not conserve energy.

    Parameters
    ----------
    texture
        The texture.
    where
        File and key for the fault.

    Returns
    -------
    list[InputError]
        One fault, for the first pixel and wavelength whose reflectance is outside 0 to 1; empty if there is none.
    """
    grid, values = texture.tables
    for row, weights in enumerate(texture.weights):
        reflectance = weights @ values
        beyond = np.argwhere((reflectance < -ROUNDING) | (reflectance > 1 + ROUNDING))
        if len(beyond):
            column, at = beyond[0]
            value = f"reflectance {reflectance[column, at]:g} at {grid[at]:g} nm in row {row}, column {column}"
            return [InputError(where, value, "sums of channels times spectra from 0 to 1")]
    return []


def inside_faults(surface: Surface, material: Material, where: str) -> list[InputError]:
    """Faults of a surface that a medium fills: it is opaque, open or inside out.

    A surface is closed if every edge of a triangle is that of another triangle in the other direction. It is inside out
    if its signed volume is not above 0.

    Parameters
    ----------
    surface
        The surface with the medium.
    material
        The material of the surface.
    where
        File and key for the faults.

    Returns
    -------
    list[InputError]
        At most two faults.
    """
    faults = []
    if material.bsdf is None:
        expected = 'a material whose bsdf lets light through, as { type = "dielectric" } or { type = "null" }'
        faults.append(InputError(where, f"a medium behind the opaque material '{material.name}'", expected))
    corners = surface.vertices_mm[surface.faces]
    size = np.ptp(surface.vertices_mm, axis=0).max()
    cells = np.rint(corners / (SMALLEST_AREA * max(size, 1e-300))).reshape(-1, 3)
    _, number = np.unique(cells, axis=0, return_inverse=True)
    corner = number.reshape(-1, 3)
    edges = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    forward, back = (np.unique(pairs, axis=0, return_counts=True) for pairs in (edges, edges[:, ::-1]))
    closed = np.array_equal(forward[0], back[0]) and np.array_equal(forward[1], back[1])
    volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    if not closed or volume <= 0:
        shape = "a surface that is turned inside out" if closed else "an open surface"
        faults.append(InputError(where, shape, "a closed surface, its corners counter-clockwise from outside"))
    return faults


def surface_faults(surface: Surface, where: str) -> list[InputError]:
    """Fault of a surface with triangles without area: corners that coincide or lie on one line.

    Parameters
    ----------
    surface
        The surface.
    where
        File and key for the fault.

    Returns
    -------
    list[InputError]
        One fault that names the first such triangle; empty if there is none.
    """
    corners = surface.vertices_mm[surface.faces]
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    empty = np.flatnonzero(surface.areas_mm2 <= SMALLEST_AREA * edges.max(axis=1) ** 2)
    if empty.size == 0:
        return []
    first = ", ".join("(" + " ".join(f"{x:g}" for x in corner) + ")" for corner in corners[empty[0]])
    return [
        InputError(
            where,
            f"{empty.size} of {len(corners)} triangles without area, the first at {first}",
            "corners that differ and do not lie on one line",
        )
    ]
