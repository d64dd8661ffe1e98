"""Checks of scene data: spectra without gaps, reflectances from 0 to 1, triangles with an area."""

from __future__ import annotations

import numpy as np
from cboxlab.utils.errors import InputError

from .scene import Material, Surface, Texture
from .spectra import Spectrum

__all__ = [
    "inside_faults",
    "radiance_faults",
    "reflectance_faults",
    "surface_faults",
    "table_faults",
    "texture_faults",
]

#: A table whose longest wavelength is shorter is in another unit.
_SHORTEST_NM = 100.0
#: A step larger than this many times the median step is a gap in a table.
LARGEST_STEP = 3.0
#: Rounding that a sum of weights times spectra may leave beyond 0 and 1.
ROUNDING = 1e-9
#: Smallest valid area of a triangle, relative to its longest edge squared.
SMALLEST_AREA = 1e-9


def table_faults(spectrum: Spectrum, where: str) -> list[InputError]:
    """One fault for a table in another unit than nm, and one for each gap: a step above three times the median step,
    too wide to interpolate over."""
    first, last = spectrum.wavelength_nm[[0, -1]]
    if last < _SHORTEST_NM:
        found = f"wavelengths from {first:g} to {last:g}"
        return [InputError(where, found, "wavelengths in nm", "multiply by 1000 if the table is in µm")]
    steps = np.diff(spectrum.wavelength_nm)
    if steps.size == 0:
        return []
    median = float(np.median(steps))
    return [
        InputError(
            where,
            f"a gap in the table from {spectrum.wavelength_nm[i]:g} to {spectrum.wavelength_nm[i + 1]:g} nm",
            f"steps up to {LARGEST_STEP * median:g} nm, {LARGEST_STEP:g} times the usual {median:g} nm",
            "fill in the missing rows",
        )
        for i in np.flatnonzero(steps > LARGEST_STEP * median)
    ]


def reflectance_faults(spectrum: Spectrum, where: str) -> list[InputError]:
    """Faults for gaps, and for the first value outside 0 to 1 (energy conservation)."""
    faults = table_faults(spectrum, where)
    outside = np.flatnonzero((spectrum.values < 0) | (spectrum.values > 1))
    if outside.size:
        value, wavelength = spectrum.values[outside[0]], spectrum.wavelength_nm[outside[0]]
        hint = "divide by 100 if the table is in percent" if 1 < spectrum.values.max() <= 100 else ""
        faults.append(InputError(where, f"reflectance {value:g} at {wavelength:g} nm", "values from 0 to 1", hint))
    return faults


def radiance_faults(spectrum: Spectrum, where: str) -> list[InputError]:
    """Faults for gaps, and for a negative radiance or one that is 0 everywhere."""
    faults = table_faults(spectrum, where)
    if spectrum.values.min() < 0:
        at = spectrum.wavelength_nm[np.argmin(spectrum.values)]
        faults.append(InputError(where, f"radiance {spectrum.values.min():g} at {at:g} nm", "values of 0 or more"))
    elif spectrum.values.max() == 0:
        faults.append(InputError(where, "a radiance of 0 everywhere", "a value above 0"))
    return faults


def texture_faults(texture: Texture, where: str) -> list[InputError]:
    """One fault for the first pixel and wavelength whose reflectance is outside 0 to 1 (energy conservation)."""
    grid, values = texture.tables
    for row, weights in enumerate(texture.weights):
        reflectance = weights @ values
        beyond = np.argwhere((reflectance < -ROUNDING) | (reflectance > 1 + ROUNDING))
        if len(beyond):
            column, at = beyond[0]
            found = f"reflectance {reflectance[column, at]:g} at {grid[at]:g} nm in row {row}, column {column}"
            return [InputError(where, found, "sums of channels times spectra from 0 to 1")]
    return []


def inside_faults(surface: Surface, material: Material, where: str) -> list[InputError]:
    """Faults of a surface that a medium fills: it lets no light in, or it is open or inside out."""
    faults = []
    if material.bsdf is None:
        expected = 'a material whose bsdf lets light through, as { type = "dielectric" } or { type = "null" }'
        faults.append(InputError(where, f"a medium behind the opaque material '{material.name}'", expected))
    corners = surface.vertices_mm[surface.faces]
    size = np.ptp(surface.vertices_mm, axis=0).max()
    places = np.rint(corners / (SMALLEST_AREA * max(size, 1e-300))).reshape(-1, 3)
    _, number = np.unique(places, axis=0, return_inverse=True)
    corner = number.reshape(-1, 3)
    edges = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    there, back = (np.unique(pairs, axis=0, return_counts=True) for pairs in (edges, edges[:, ::-1]))
    closed = np.array_equal(there[0], back[0]) and np.array_equal(there[1], back[1])
    volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    if not closed or volume <= 0:
        found = "a surface that is turned inside out" if closed else "an open surface"
        faults.append(InputError(where, found, "a closed surface, its corners counter-clockwise from outside"))
    return faults


def surface_faults(surface: Surface, where: str) -> list[InputError]:
    """One fault if any triangle has no area (its corners coincide or lie on one line)."""
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
