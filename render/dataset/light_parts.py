"""Light of a picture by number of reflections, and its split into albedo and irradiance.

A surface that reflects by Lambert's law sends L = rho E / pi. The final gather sums E by material of the surface seen,
so that the split is exact and free of division by dark paints. In a pixel with several surfaces E and albedo are means
over the surfaces' areas; the product of means is the mean of products only where one material fills the pixel.

Where a texture is seen, albedo is the mean over the pixel of the texture itself, and E the mean weighted by the albedo:
their product is the radiance in every such pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

from ..image import RenderedImage, accumulators

__all__ = ["REFLECTIONS", "LightParts", "light_parts"]

#: Names of the parts of light, by number of reflections.
REFLECTIONS = ("0", "1", "2", "3 or more")


@dataclass(frozen=True, eq=False)
class LightParts:
    """Parts of a picture's light, means over the batches."""

    #: (4, y, x, w) radiance by number of reflections, in the order of REFLECTIONS, W m^-2 sr^-1 nm^-1.
    reflections: NDArray[np.float64]
    #: (y, x, w) irradiance of the surfaces, W m^-2 nm^-1; 0 where no surface is seen.
    irradiance: NDArray[np.float64]
    #: (y, x, w) reflectance of the surfaces, weighted by their areas in the pixel, 0 to 1.
    albedo: NDArray[np.float64]

    @property
    def radiance(self) -> NDArray[np.float64]:
        """(y, x, w) sum of the reflections, W m^-2 sr^-1 nm^-1."""
        return self.reflections.sum(axis=0)


def light_parts(
    image: RenderedImage, scene: Scene, mixed_shares: Mapping[int, NDArray[np.float64]] = MappingProxyType({})
) -> LightParts:
    """Parts of the light of a picture.

    Parameters
    ----------
    image
        Image of a final gather, without effects on light transport.
    scene
        Its scene.
    mixed_shares
        (y, x, k) mean share of each material of a mixed surface in each pixel, by the surface (``mixed_pixels``).

    Returns
    -------
    LightParts
        The parts.

    Raises
    ------
    ValueError
        For the image of another integrator.
    """
    order = accumulators(image, scene)
    mean = image.averaged().coefficients[0].astype(np.float64)
    reflectances = scene.reflectances(image.wavelength_nm)[: order.firsts]
    brightest = np.argmax(reflectances, axis=0)
    most = np.take_along_axis(reflectances, brightest[None], axis=0)[0]
    reflections = np.zeros((len(REFLECTIONS), *mean.shape[:2], image.wavelength_nm.size))
    irradiance = np.zeros(reflections.shape[1:])
    for lamp, emitted in enumerate(order.emitted):
        reflections[0] += mean[..., emitted, None] * image.spectra[emitted]
        blocks = np.stack([image.spectra[order.start(lamp, m) :][: order.per_block] for m in range(order.firsts)])
        # spectra of light that arrives: those that leave the brightest material at each wavelength over its reflectance
        leaving = np.take_along_axis(blocks, brightest[None, None], axis=0)[0]
        arriving = np.divide(leaving, most, out=np.zeros_like(leaving), where=most > 0)
        arriving[0] = image.spectra[emitted]
        ends = (0, 1, 1 + order.seconds, order.per_block)
        for first, reflectance in enumerate(reflectances):
            block = mean[..., order.start(lamp, first) :][..., : order.per_block]
            for part, (low, high) in enumerate(pairwise(ends), start=1):
                light = block[..., low:high] @ arriving[low:high]
                irradiance += np.pi * light
                reflections[part] += reflectance * light
    albedo, shares = _albedo(image, scene, mixed_shares)
    weighted = (shares[..., list(mixed_shares)].sum(axis=-1, keepdims=True) > 0) & (albedo > 0)
    np.divide(np.pi * reflections[1:].sum(axis=0), albedo, out=irradiance, where=weighted)
    return LightParts(reflections, irradiance, albedo)


def _albedo(
    image: RenderedImage, scene: Scene, mixed_shares: Mapping[int, NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(y, x, w) reflectance of each pixel by areas, and (y, x, surface) areas."""
    names, count = list(scene.materials), len(scene.surfaces)
    index = [names.index(surface.material) for surface in scene.surfaces]
    of_surface = scene.reflectances(image.wavelength_nm)
    rows = np.concatenate([of_surface[index], scene.lamp_areas[None] @ of_surface[len(names) :]])
    shares = np.stack([image.coverage[..., image.facet_surface == s].sum(axis=-1) for s in range(count + 1)], axis=-1)
    albedo = np.asarray(shares.astype(np.float64) @ rows)
    for number, each in mixed_shares.items():
        surface = scene.surfaces[number]
        parts = of_surface[[names.index(part) for part in surface.parts]]  # type: ignore[attr-defined]
        albedo += shares[..., number, None] * (each @ parts - rows[number])
    return albedo, shares
