"""Rendering of the scene under changes, from one set of rays (``patch_transport``)."""

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

from .sides import Side, SurfaceIndices

__all__ = ["Variants", "build_variants", "mismatch", "with_lamp_size"]

#: Patches along the scene's diagonal: changes of light reflected twice or more are smooth over a patch.
_PATCHES_PER_DIAGONAL = 14
#: Rays from each patch: the form factors' noise is then below the floor of a cell's mean.
_PATCH_SAMPLES = 1024
#: Rays of each pixel.
_PIXEL_SAMPLES = 128
#: Rays to the lamp from each patch and pixel.
_LAMP_SAMPLES = 32
#: Most wavelengths at which variants are computed; ratios are linear between them.
_MAX_WAVELENGTHS = 12
#: Wavelengths of variants for pictures in colour, nm.
_VISIBLE_NM = np.linspace(400.0, 700.0, _MAX_WAVELENGTHS)
#: Distance below which a vertex belongs to the hole around a corner of the lamp, mm: rounding of scene files.
_TOUCHING_MM = 1e-6
#: Covered part of a pixel below which it shows no surface.
_MIN_COVERAGE = 0.5
#: Percentile of the deviations between a picture and the scene's rendering that counts as their mismatch.
_MISMATCH_PERCENTILE = 90


@dataclass(frozen=True, eq=False)
class Variants:
    """Renderings of a scene and of changes of it."""

    #: The scene.
    scene: Scene
    #: Camera of the pictures.
    camera: Camera
    #: Side of the pictures compared, for its planes.
    side: Side
    #: (c,) wavelengths at which variants are computed, nm.
    coarse_nm: NDArray[np.float64]
    #: Light of the unchanged scene.
    light: PatchLight
    #: (c, y, x) radiance of the unchanged scene over the lamp's.
    picture: NDArray[np.float64]

    def ratio(self, picture: NDArray[np.float64]) -> NDArray[np.float64]:
        """Another rendering over that of the unchanged scene.

        Parameters
        ----------
        picture
            (c, y, x) radiance over the lamp's.

        Returns
        -------
        NDArray
            (y, x, w) ratio in the planes of ``side``; 1 where the unchanged scene is dark.
        """
        if self.side.in_colour:
            before, after = (np.einsum("cyx,cw->yxw", p, self._colour) for p in (self.picture, picture))
            return np.divide(after, before, out=np.ones_like(before), where=before > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self.picture > 0, picture / self.picture, 1.0)
        grid = self.side.wavelength_nm
        between = np.array([np.interp(grid, self.coarse_nm, row) for row in np.eye(len(ratio))])
        return np.einsum("cyx,cw->yxw", ratio, between)

    @property
    def _colour(self) -> NDArray[np.float64]:
        """(c, 3) X, Y, Z of radiance over the lamp's, for the scene's lamp."""
        return xyz_weights(self.coarse_nm) * self.scene.lamp_radiance(self.coarse_nm)[:, None]

    def planes(self) -> NDArray[np.float64]:
        """Rendering of the unchanged scene.

        Returns
        -------
        NDArray
            (y, x, n) X, Y, Z, or radiance over the lamp's at the coarse wavelengths.
        """
        picture = self.picture.transpose(1, 2, 0)
        return picture @ self._colour if self.side.in_colour else picture

    def at(self, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rendering of the unchanged scene at other wavelengths.

        Parameters
        ----------
        wavelength_nm
            (n,) wavelengths, nm.

        Returns
        -------
        NDArray
            (y, x, n) radiance over the lamp's.
        """
        count = wavelength_nm.size
        light = patch_light(
            self.light.transport, self.scene, wavelength_nm, wavelength_nm, np.eye(count), np.ones(count)
        )
        return light.picture().transpose(1, 2, 0)

    def surface_map(self) -> SurfaceIndices:
        """Surface that each pixel shows: the one that covers most of it.

        Returns
        -------
        SurfaceIndices
            The map.
        """
        transport = self.light.transport
        height, width = self.camera.height_px, self.camera.width_px
        names = tuple(surface.name for surface in self.scene.surfaces)
        shares = np.zeros((height * width, len(names) + 1))  # the last is the lamp's
        np.add.at(shares, (transport.pixel, transport.surface), transport.coverage)
        lamp = (transport.lamp_radiance > 0).any(axis=0).ravel()
        most = shares.argmax(axis=1)
        most[(shares.max(axis=1) < _MIN_COVERAGE) | lamp | (most == len(names))] = -1
        shape = height, width
        return SurfaceIndices(most.reshape(shape), names, lamp.reshape(shape))

    def with_paints(self, patches: NDArray[np.float64], fragments: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rendering with other reflectances.

        Parameters
        ----------
        patches
            (p, c) reflectance of each patch.
        fragments
            (f, c) reflectance of each fragment of a surface in a pixel.

        Returns
        -------
        NDArray
            (c, y, x) radiance over the lamp's.
        """
        return self.light.change(patch_reflectance=patches, fragment_reflectance=fragments).picture()

    @property
    def surface_index(self) -> NDArray[np.int64]:
        """(y, x) index of the surface that each pixel shows; negative for the lamp and outside."""
        return self.surface_map().index

    def rebuilt(self, scene: Scene) -> Variants:
        """Rendering of another scene through the same camera.

        Parameters
        ----------
        scene
            The other scene.

        Returns
        -------
        Variants
            Its rendering.
        """
        return build_variants(scene, self.camera, self.side)

    @property
    def patch_surface(self) -> NDArray[np.int64]:
        """(p,) surface of each patch."""
        return self.light.transport.light.patches.surface


def build_variants(scene: Scene, camera: Camera, side: Side) -> Variants:
    """Rendering of a scene, prepared for changes.

    Parameters
    ----------
    scene
        The scene.
    camera
        Camera of the pictures.
    side
        Side of the pictures compared, for its planes.

    Returns
    -------
    Variants
        The rendering.

    Raises
    ------
    InputError
        If the scene is not diffuse, or if nothing can be compiled.
    """
    variant.require_compiled("variants")
    wavelength_nm = _VISIBLE_NM if side.in_colour else side.wavelength_nm
    count = min(_MAX_WAVELENGTHS, wavelength_nm.size)
    index = np.unique(np.linspace(0, wavelength_nm.size - 1, count).round().astype(int))
    coarse = wavelength_nm[index]
    edge = float(np.linalg.norm(np.ptp(scene.corners_mm, axis=0))) / _PATCHES_PER_DIAGONAL
    transport = build_patch_transport(build_patched_scene(scene, edge, _PATCH_SAMPLES), camera, _PIXEL_SAMPLES)
    light = patch_light(
        transport, scene, coarse, coarse, np.eye(coarse.size), np.ones(coarse.size), samples=_LAMP_SAMPLES
    )
    return Variants(scene, camera, side, coarse, light, light.picture())


def mismatch(variants: Variants, side: Side) -> float:
    """Relative deviation of a picture from the scene's rendering, for any lamp's spectrum.

    Two 90th percentiles of deviations are formed: of surfaces' means at each wavelength, and of means over all
    wavelengths of surfaces' parts in a grid of 4 x 4 blocks.

    Parameters
    ----------
    variants
        Rendering of the scene.
    side
        The picture.

    Returns
    -------
    float
        The larger percentile; infinite for a dark picture.
    """
    surfaces = variants.surface_map()
    model, picture = variants.planes(), side.radiance
    if not side.in_colour:
        picture = picture[..., [int(np.argmin(np.abs(side.wavelength_nm - w))) for w in variants.coarse_nm]]
    rows, columns = (np.arange(size) * 4 // size for size in side.shape)
    block = rows[:, None] * 4 + columns
    inside = surfaces.index >= 0
    total = picture[inside].sum(axis=0)
    bright = total > 1e-6 * total.max()
    if not bright.any():
        return float("inf")
    factor = total[bright] / model[inside][:, bright].sum(axis=0)
    picture, model = picture[..., bright], model[..., bright] * factor
    by_surface = _ratios(picture, model, surfaces.index, inside)
    by_part = _ratios(
        picture.sum(axis=-1, keepdims=True),
        model.sum(axis=-1, keepdims=True),
        surfaces.index * 16 + block,
        inside,
    )
    if not (by_surface.size and by_part.size):  # parts of too few pixels
        return float("inf")
    return max(float(np.percentile(np.abs(ratio - 1), _MISMATCH_PERCENTILE)) for ratio in (by_surface, by_part))


def _ratios(picture: NDArray, model: NDArray, key: NDArray, inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, b) ratios of sums over parts that hold at least a thousandth of the pixels."""
    _, part, counts = np.unique(key[inside], return_inverse=True, return_counts=True)
    used = counts >= max(8, inside.sum() // 1000)
    sums = [np.stack([np.bincount(part, b)[used] for b in p[inside].T], axis=-1) for p in (picture, model)]
    return sums[0] / np.maximum(sums[1], 1e-300)


def with_lamp_size(scene: Scene, factor: float) -> Scene:
    """Scene with larger or smaller lamps, and holes around them.

    Parameters
    ----------
    scene
        The scene.
    factor
        Factor on the lamps' edges, about their centres.

    Returns
    -------
    Scene
        The changed scene.
    """
    for index in range(len(scene.lamps)):
        scene = _with_larger_lamp(scene, index, factor)
    return scene


def _with_larger_lamp(scene: Scene, index: int, factor: float) -> Scene:
    """Scene in which one lamp and its hole are scaled."""
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
