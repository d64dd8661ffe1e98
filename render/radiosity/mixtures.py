"""Textures in the final gather: points that reflect by several paints.

The gather sums light by the paints that reflected it. A point of a texture reflects by each of its paints, weighted by
the texture's weight there. The sums then hold as for plain surfaces, and no further rays are needed. The patches of the
radiosity solution have their mean weights, of the pieces' points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from cboxlab.scenes.scene import Material, Scene, Surface
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ..device import device_array, dr, mi
from ..visibility import Hit, Tracer
from .patches import Patches

__all__ = ["MixedSurface", "Mixtures", "build_mixtures", "mixed_scenes", "patch_shares"]

#: Divisions of the edges of a patch's piece, at whose parts' centres the weights are averaged: 36 points of a piece.
_DIVISIONS = 6


@dataclass(frozen=True, eq=False)
class MixedSurface(Surface):
    """Surface whose points reflect by several materials of the scene, each with a share.

    Its own material is the first of them.
    """

    #: Names of the materials.
    parts: tuple[str, ...] = ()
    #: (rows, columns, k) share of each, in the order of a texture's weights.
    shares: NDArray[np.float64] = field(default_factory=lambda: np.ones((1, 1, 0)))


def mixed_scenes(scenes: Sequence[Scene]) -> list[Scene]:
    """Scenes of one geometry with a mixture of plain materials for each texture.

    A spectrum of a texture that is that of a plain material in every scene is this material.

    Parameters
    ----------
    scenes
        Scenes that differ in spectra alone.

    Returns
    -------
    list of Scene
        The scenes with mixed surfaces; scenes without textures are returned as they are.
    """
    first = scenes[0]
    used = {surface.material for surface in first.surfaces}
    textured = [name for name, m in first.materials.items() if m.texture is not None and name in used]
    if not textured:
        return list(scenes)
    paints = {
        name: [scene.materials[name].reflectance for scene in scenes]
        for name, material in first.materials.items()
        if material.texture is None
    }
    parts: dict[str, tuple[str, ...]] = {}
    for name in textured:
        tables = [scene.materials[name].texture for scene in scenes]
        every = zip(*(table.spectra for table in tables if table is not None), strict=True)
        parts[name] = tuple(_paint(list(spectra), f"{name}-{k}", paints) for k, spectra in enumerate(every, start=1))
    return [_mixed(scene, parts, {name: each[n] for name, each in paints.items()}) for n, scene in enumerate(scenes)]


def _paint(spectra: list[Spectrum], name: str, paints: dict[str, list[Spectrum]]) -> str:
    """Name of the paint with these spectra, which is added under a new name where there is none."""
    for other, each in paints.items():
        if all(_equal(a, b) for a, b in zip(spectra, each, strict=True)):
            return other
    while name in paints:
        name += "'"
    paints[name] = spectra
    return name


def _equal(a: Spectrum, b: Spectrum) -> bool:
    """Whether two spectra have the same table."""
    return np.array_equal(a.wavelength_nm, b.wavelength_nm) and np.array_equal(a.values, b.values)


def _mixed(scene: Scene, parts: dict[str, tuple[str, ...]], paints: dict[str, Spectrum]) -> Scene:
    """A scene with mixed surfaces for those of textured materials."""
    plain = {name: material for name, material in scene.materials.items() if material.texture is None}
    materials = {name: plain.get(name, Material(name, spectrum)) for name, spectrum in paints.items()}
    surfaces = []
    for surface in scene.surfaces:
        texture = scene.materials[surface.material].texture
        if texture is not None:
            values = {each.name: getattr(surface, each.name) for each in fields(Surface)}
            names = parts[surface.material]
            surface = MixedSurface(**{**values, "material": names[0]}, parts=names, shares=texture.weights)
        surfaces.append(surface)
    return replace(scene, surfaces=tuple(surfaces), materials=materials)


@dataclass(frozen=True, eq=False)
class _Picture:
    """Weights of one texture on the device."""

    #: (rows, columns, k) weights, flattened.
    weights: mi.Float
    #: Rows and columns.
    size: tuple[int, int]
    #: Indices of the k materials.
    materials: tuple[int, ...]

    def at(self, u: mi.Float, v: mi.Float, active: mi.Bool) -> list[mi.Float]:
        """Weights, bilinear between the centres of four pixels."""
        (rows, columns), count = self.size, len(self.materials)
        x, y = u * columns - 0.5, v * rows - 0.5
        first, top = dr.floor(x), dr.floor(y)
        across, down = x - first, y - top
        sums = [mi.Float(0)] * count
        for row, part in ((top, 1 - down), (top + 1, down)):
            for column, share in ((first, 1 - across), (first + 1, across)):
                line = mi.UInt32(dr.clip(row, 0, rows - 1))
                entry = (line * columns + mi.UInt32(dr.clip(column, 0, columns - 1))) * count
                sums = [
                    dr.fma(part * share, dr.gather(mi.Float, self.weights, entry + k, active), old)
                    for k, old in enumerate(sums)
                ]
        return sums


@dataclass(frozen=True, eq=False)
class Mixtures:
    """Shares of the materials at points of a scene with mixed surfaces."""

    #: Textures, each once.
    pictures: tuple[_Picture, ...]
    #: (t,) index of each triangle's texture; their number for none.
    picture: mi.UInt32
    #: (t, 2, 4) rows (a, b) of the texture coordinates a . p + b at points p of each triangle.
    coordinates: mi.Float

    def shares(self, hit: Hit, count: int, active: mi.Bool) -> list[mi.Float]:
        """Share of each material at hits.

        Parameters
        ----------
        hit
            The hits.
        count
            Number of materials, by index.
        active
            Lanes that are evaluated.

        Returns
        -------
        list[Float]
            The shares; 0 in other lanes.
        """
        which = dr.gather(mi.UInt32, self.picture, hit.triangle, active)
        none = len(self.pictures)
        shares = [dr.select(active & (which == none) & (hit.material == m), mi.Float(1), 0) for m in range(count)]
        mixed = active & (which < none)
        u, v = (
            dr.dot(mi.Vector3f(row.x, row.y, row.z), hit.position) + row.w
            for row in (dr.gather(mi.Vector4f, self.coordinates, 2 * hit.triangle + i, mixed) for i in (0, 1))
        )
        for index, picture in enumerate(self.pictures):
            lanes = mixed & (which == index)
            for m, weight in zip(picture.materials, picture.at(u, v, lanes), strict=True):
                shares[m] += dr.select(lanes, weight, 0)
        return shares


def build_mixtures(tracer: Tracer) -> Mixtures | None:
    """Mixtures of a scene's surfaces.

    Parameters
    ----------
    tracer
        Tracer of a scene of ``mixed_scenes``.

    Returns
    -------
    Mixtures or None
        The mixtures; None for a scene without a mixed surface.
    """
    mixed = _mixed_surfaces(tracer)
    if not mixed:
        return None
    pictures: dict[tuple[int, tuple[str, ...]], _Picture] = {}
    which = np.full(len(tracer.surface), -1)
    for index, surface in mixed.items():
        key = id(surface.shares), surface.parts
        if key not in pictures:
            names = tuple(tracer.material_names.index(name) for name in surface.parts)
            pictures[key] = _Picture(device_array(mi.Float, surface.shares), surface.shares.shape[:2], names)
        which[tracer.surface == index] = list(pictures).index(key)
    which[which < 0] = len(pictures)
    return Mixtures(
        tuple(pictures.values()),
        device_array(mi.UInt32, which),
        device_array(mi.Float, _coordinates(tracer, mixed)),
    )


def _mixed_surfaces(tracer: Tracer) -> dict[int, MixedSurface]:
    """Mixed surfaces by their indices."""
    return {index: s for index, s in enumerate(tracer.scene.surfaces) if isinstance(s, MixedSurface)}


def _coordinates(tracer: Tracer, mixed: dict[int, MixedSurface]) -> NDArray[np.float64]:
    """(t, 2, 4) rows of each triangle's texture coordinates, constant along its normal."""
    rows = np.zeros((len(tracer.surface), 2, 4))
    for index, surface in mixed.items():
        on = tracer.surface == index
        corners = tracer.vertices[on]
        if surface.texture_uv is None:
            raise ValueError(f"{surface.name} has no texture coordinates")
        uv = surface.texture_uv[surface.faces]
        edges, steps = corners[:, 1:] - corners[:, :1], uv[:, 1:] - uv[:, :1]
        slopes = np.swapaxes(np.linalg.pinv(edges) @ steps, 1, 2)
        rows[on, :, :3] = slopes
        rows[on, :, 3] = uv[:, 0] - np.einsum("tij,tj->ti", slopes, corners[:, 0])
    return rows


def patch_shares(tracer: Tracer, patches: Patches, count: int) -> NDArray[np.float64]:
    """Mean share of each material in each patch.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    patches
        Its p patches.
    count
        Number of materials, by index.

    Returns
    -------
    NDArray
        (p, count) shares; 1 for the material of a plain patch.
    """
    shares = np.eye(count)[patches.material]
    mixed = _mixed_surfaces(tracer)
    if not mixed:
        return shares
    rows = _coordinates(tracer, mixed)
    for index, surface in mixed.items():
        pieces = np.flatnonzero(tracer.surface[patches.triangle] == index)
        uv = _points(patches.corners[pieces]) @ np.swapaxes(rows[patches.triangle[pieces], :, :3], 1, 2)
        uv += rows[patches.triangle[pieces], None, :, 3]
        size = np.array(surface.shares.shape[:2])
        pixels = (uv[..., ::-1] * size - 0.5).reshape(-1, 2).T
        corners = patches.corners[pieces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        owner, total = patches.patch[pieces], np.zeros((len(shares), count))
        for k, name in enumerate(surface.parts):
            each = map_coordinates(surface.shares[..., k], pixels, order=1, mode="nearest").reshape(len(pieces), -1)
            column = tracer.material_names.index(name)
            total[:, column] += np.bincount(owner, areas * each.mean(axis=1), len(shares))
        sums = np.bincount(owner, areas, len(shares))
        shares[sums > 0] = total[sums > 0] / sums[sums > 0, None]
    return shares


def _points(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, k, 3) centres of equal parts of triangles (n, 3, 3)."""
    i, j, upper = (x.ravel() for x in np.indices((_DIVISIONS, _DIVISIONS, 2)))
    inside = i + j + upper < _DIVISIONS
    third = (1 + upper[inside]) / 3
    u, v = (i[inside] + third) / _DIVISIONS, (j[inside] + third) / _DIVISIONS
    return np.einsum("kc,ncx->nkx", np.stack([1 - u - v, u, v], axis=1), corners)
