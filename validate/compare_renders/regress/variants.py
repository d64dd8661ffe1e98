"""The scene that the pictures show, and its picture under changes, from one set of rays (``patch_transport``)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.device import variant
from cboxlab.rendering.files import xyz_weights
from cboxlab.rendering.perturbation import PatchLight, build_patch_transport, patch_light
from cboxlab.rendering.radiosity import build_patched_scene
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene, Surface
from numpy.typing import NDArray

from .sides import Side, SurfaceMap

__all__ = ["Variants", "build_variants", "mismatch", "with_lamp_size"]

#: Patches along the scene's diagonal, rays from each, rays of each pixel.
_PATCHES_PER_DIAGONAL, _PATCH_SAMPLES, _SAMPLES = 14, 1024, 128
#: Wavelengths at which variants are computed; between them their ratios are linear.
_MOST_WAVELENGTHS = 12
#: For pictures in colour.
_VISIBLE_NM = np.linspace(400.0, 700.0, _MOST_WAVELENGTHS)
#: Vertices this near to a corner of the lamp belong to the hole around it, mm.
_TOUCHING_MM = 1e-6


@dataclass(frozen=True, eq=False)
class Variants:
    """side : of the pictures compared, for its planes. coarse_nm : (c,) at which variants are computed.

    light : the scene as it is. picture : (c, y, x) its radiance over the lamp's.
    """

    scene: Scene
    camera: Camera
    side: Side
    coarse_nm: NDArray[np.float64]
    light: PatchLight
    picture: NDArray[np.float64]

    def ratio(self, picture: NDArray[np.float64]) -> NDArray[np.float64]:
        """(y, x, w) another picture (c, y, x) over the scene's own; 1 where that is dark."""
        if self.side.in_colour:
            here, there = (np.einsum("cyx,cw->yxw", p, self._colour) for p in (self.picture, picture))
            return np.divide(there, here, out=np.ones_like(here), where=here > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self.picture > 0, picture / self.picture, 1.0)
        grid = self.side.wavelength_nm
        between = np.array([np.interp(grid, self.coarse_nm, row) for row in np.eye(len(ratio))])
        return np.einsum("cyx,cw->yxw", ratio, between)

    @property
    def _colour(self) -> NDArray[np.float64]:
        """(c, 3) X, Y, Z of radiance over the lamp's, under the scene's own lamp."""
        return xyz_weights(self.coarse_nm) * self.scene.lamp_radiance(self.coarse_nm)[:, None]

    def planes(self) -> NDArray[np.float64]:
        """(y, x, n) the scene's picture in X, Y, Z, or at the coarse wavelengths."""
        here = self.picture.transpose(1, 2, 0)
        return here @ self._colour if self.side.in_colour else here

    def at(self, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """(y, x, n) the scene's own picture over the lamp's radiance, at other wavelengths."""
        count = wavelength_nm.size
        light = patch_light(
            self.light.transport, self.scene, wavelength_nm, wavelength_nm, np.eye(count), np.ones(count)
        )
        return light.picture().transpose(1, 2, 0)

    def surface_map(self) -> SurfaceMap:
        """Which surface each pixel sees."""
        transport = self.light.transport
        height, width = self.camera.height_px, self.camera.width_px
        names = tuple(surface.name for surface in self.scene.surfaces)
        shares = np.zeros((height * width, len(names) + 1))  # the last is the lamp's
        np.add.at(shares, (transport.pixel, transport.surface), transport.coverage)
        lamp = (transport.lamp_radiance > 0).any(axis=0).ravel()
        most = shares.argmax(axis=1)
        most[(shares.max(axis=1) < 0.5) | lamp | (most == len(names))] = -1
        shape = height, width
        return SurfaceMap(most.reshape(shape), names, lamp.reshape(shape))

    def with_paints(self, patches: NDArray[np.float64], fragments: NDArray[np.float64]) -> NDArray[np.float64]:
        """(c, y, x) picture with other reflectances."""
        return self.light.change(patch_reflectance=patches, fragment_reflectance=fragments).picture()

    @property
    def patch_surface(self) -> NDArray[np.int64]:
        """(p,) surface of each patch."""
        return self.light.transport.light.patches.surface


def build_variants(scene: Scene, camera: Camera, side: Side) -> Variants:
    """side : of the pictures compared, for its planes.

    Raises InputError for a scene that is not diffuse, and where nothing can be compiled.
    """
    variant.require_compiled("variants")
    wavelength_nm = _VISIBLE_NM if side.in_colour else side.wavelength_nm
    count = min(_MOST_WAVELENGTHS, wavelength_nm.size)
    index = np.unique(np.linspace(0, wavelength_nm.size - 1, count).round().astype(int))
    coarse = wavelength_nm[index]
    edge = float(np.linalg.norm(np.ptp(scene.corners_mm, axis=0))) / _PATCHES_PER_DIAGONAL
    transport = build_patch_transport(build_patched_scene(scene, edge, _PATCH_SAMPLES), camera, _SAMPLES)
    light = patch_light(transport, scene, coarse, coarse, np.eye(coarse.size), np.ones(coarse.size), samples=32)
    return Variants(scene, camera, side, coarse, light, light.picture())


def mismatch(variants: Variants, side: Side) -> float:
    """How far a picture is from the scene's, relative; a spectrum of the lamp of its own is allowed.

    The larger of two 90th percentiles of deviations: of surfaces' means at each wavelength, and of means over all
    wavelengths of surfaces' parts in a grid of 4 x 4 blocks.
    """
    surfaces = variants.surface_map()
    model, seen = variants.planes(), side.radiance
    if not side.in_colour:
        seen = seen[..., [int(np.argmin(np.abs(side.wavelength_nm - w))) for w in variants.coarse_nm]]
    rows, columns = (np.arange(size) * 4 // size for size in side.shape)
    block = rows[:, None] * 4 + columns
    inside = surfaces.index >= 0
    whole = seen[inside].sum(axis=0)
    lit = whole > 1e-6 * whole.max()
    if not lit.any():
        return float("inf")
    factor = whole[lit] / model[inside][:, lit].sum(axis=0)
    seen, model = seen[..., lit], model[..., lit] * factor
    by_surface = _ratios(seen, model, surfaces.index, inside)
    by_part = _ratios(
        seen.sum(axis=-1, keepdims=True),
        model.sum(axis=-1, keepdims=True),
        surfaces.index * 16 + block,
        inside,
    )
    if not (by_surface.size and by_part.size):  # parts of too few pixels
        return float("inf")
    return max(float(np.percentile(np.abs(ratio - 1), 90)) for ratio in (by_surface, by_part))


def _ratios(seen: NDArray, model: NDArray, key: NDArray, inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, b) of sums over parts, of those that hold at least a thousandth of the pixels."""
    _, own, counts = np.unique(key[inside], return_inverse=True, return_counts=True)
    kept = counts >= max(8, inside.sum() // 1000)
    sums = [np.stack([np.bincount(own, b)[kept] for b in p[inside].T], axis=-1) for p in (seen, model)]
    return sums[0] / np.maximum(sums[1], 1e-300)


def with_lamp_size(scene: Scene, factor: float) -> Scene:
    """The lamps, and the holes around them, larger along their edges by a factor about their centres."""
    for index in range(len(scene.lamps)):
        scene = _with_larger_lamp(scene, index, factor)
    return scene


def _with_larger_lamp(scene: Scene, index: int, factor: float) -> Scene:
    lamp = scene.lamps[index].surface
    centre = lamp.vertices_mm.mean(axis=0)

    def grown(surface: Surface) -> Surface:
        distance = np.linalg.norm(surface.vertices_mm[:, None] - lamp.vertices_mm, axis=-1).min(axis=1)
        touching = distance < _TOUCHING_MM
        moved = np.where(touching[:, None], centre + factor * (surface.vertices_mm - centre), surface.vertices_mm)
        return replace(surface, vertices_mm=moved) if touching.any() else surface

    surfaces = tuple(grown(surface) for surface in scene.surfaces)
    lamps = list(scene.lamps)
    lamps[index] = replace(lamps[index], surface=grown(lamp))
    return replace(scene, surfaces=surfaces, lamp=lamps[0], further_lamps=tuple(lamps[1:]))
