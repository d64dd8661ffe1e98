"""Textures at the points that rays hit, for all wavelengths at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Texture
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..visibility import Hit, Tracer

__all__ = ["SpectralTextures"]


@dataclass(frozen=True, eq=False)
class _Bitmap:
    """One texture: at each pixel a weighted sum of k spectra."""

    #: Index of its material in hits.
    material: int
    #: (rows, columns, k) weights, flattened.
    weights: mi.Float
    #: Rows, columns and k.
    shape: tuple[int, int, int]
    #: (k, w) reflectance spectra.
    spectra: list[list[mi.Float]]

    def at(self, u: mi.Float, v: mi.Float, active: mi.Bool) -> list[mi.Float]:
        """Reflectance at each wavelength, bilinear between the centres of four pixels."""
        rows, columns, channels = self.shape
        x, y = u * columns - 0.5, v * rows - 0.5
        left, top = dr.floor(x), dr.floor(y)
        right, down = x - left, y - top
        mixed = [mi.Float(0) for _ in range(channels)]
        for row, part in ((top, 1 - down), (top + 1, down)):
            for column, share in ((left, 1 - right), (left + 1, right)):
                line = mi.UInt32(dr.clip(row, 0, rows - 1))
                first = (line * columns + mi.UInt32(dr.clip(column, 0, columns - 1))) * channels
                mixed = [
                    old + part * share * dr.gather(mi.Float, self.weights, first + k, active)
                    for k, old in enumerate(mixed)
                ]
        totals = [mi.Float(0) for _ in self.spectra[0]]
        for weight, spectrum in zip(mixed, self.spectra, strict=True):
            totals = [dr.fma(weight, value, old) for value, old in zip(spectrum, totals, strict=True)]
        return totals


def _bitmap(material: int, texture: Texture, wavelengths: NDArray[np.float64]) -> _Bitmap:
    """The bitmap of a texture, with its spectra at the wavelengths."""
    rows, columns, channels = texture.weights.shape
    spectra = [
        [dr.opaque(mi.Float, float(value)) for value in spectrum.at(wavelengths)] for spectrum in texture.spectra
    ]
    return _Bitmap(material, device_array(mi.Float, texture.weights), (rows, columns, channels), spectra)


class SpectralTextures:
    """The textures of a scene.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    wavelengths
        (w,) wavelengths, nm.
    """

    def __init__(self, tracer: Tracer, wavelengths: NDArray[np.float64]) -> None:
        scene = tracer.scene
        used = {surface.material for surface in scene.surfaces}
        self._bitmaps = [
            _bitmap(index, material.texture, wavelengths)
            for index, material in enumerate(scene.materials.values())
            if material.texture is not None and material.name in used
        ]
        corners = np.zeros((*tracer.vertices.shape[:2], 2))
        for index, surface in enumerate(scene.surfaces):
            if surface.texture_uv is not None:
                corners[tracer.surface == index] = surface.texture_uv[surface.faces]
        self._corners = device_array(mi.Float, corners)

    def reflectance(self, hit: Hit, rho: list[mi.Float], active: mi.Bool) -> list[mi.Float]:
        """Reflectance at hits, by the textures where there are any.

        Parameters
        ----------
        hit
            The hits.
        rho
            Reflectance of the material at each wavelength, returned where there is no texture.
        active
            Lanes that are evaluated.

        Returns
        -------
        list[Float]
            Reflectance at each wavelength.
        """
        for bitmap in self._bitmaps:
            textured = active & (hit.material == bitmap.material)
            a, b, c = (dr.gather(mi.Point2f, self._corners, hit.triangle * 3 + k, textured) for k in range(3))
            coordinates = a + (b - a) * hit.uv.x + (c - a) * hit.uv.y
            painted = bitmap.at(coordinates.x, coordinates.y, textured)
            rho = [dr.select(textured, new, old) for new, old in zip(painted, rho, strict=True)]
        return rho
