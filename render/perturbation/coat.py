"""Specular coat of a surface: a GGX lobe with the Fresnel reflectance of a dielectric."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi

__all__ = ["Coat", "fresnel"]

#: Smallest roughness: below it a lobe is narrower than float32 resolves.
_MIN_ALPHA = 1e-3

#: Smallest cosine to the normal of light above the surface.
_MIN_COSINE = 1e-6


class Coat:
    """A specular coat: a GGX lobe of roughness alpha, times a scale.

    The Fresnel reflectance is that of the refractive index 1.5. Smith's separable masking; visible normals are sampled
    after Heitz, JCGT 7(4), 2018. Directions are unit vectors in the surface's frame, in which z is the normal.
    """

    def __init__(self, scale: float, alpha: float) -> None:
        self.scale = dr.opaque(mi.Float, scale)
        self.alpha = dr.opaque(mi.Float, max(alpha, _MIN_ALPHA))

    def value(self, incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        """BRDF for two directions.

        Parameters
        ----------
        incoming, outgoing
            Directions towards the light and towards the eye.

        Returns
        -------
        mi.Float
            1/sr; 0 for a direction below the surface.
        """
        half = dr.normalize(incoming + outgoing)
        both = self._masking(incoming) * self._masking(outgoing)
        below = 4 * incoming.z * outgoing.z
        value = self.scale * fresnel(dr.dot(incoming, half)) * self._density(half) * both / below
        return dr.select((incoming.z > _MIN_COSINE) & (outgoing.z > _MIN_COSINE), value, 0)

    def sample(self, outgoing: mi.Vector3f, u: mi.Float, v: mi.Float) -> mi.Vector3f:
        """Random direction of light that a visible normal reflects to ``outgoing``.

        Parameters
        ----------
        outgoing
            Direction towards the eye.
        u, v
            Uniform random numbers, 0 to 1.

        Returns
        -------
        mi.Vector3f
            Direction towards the light, which may be below the surface.
        """
        a = self.alpha
        stretched = dr.normalize(mi.Vector3f(a * outgoing.x, a * outgoing.y, outgoing.z))
        frame = mi.Frame3f(stretched)
        radius, angle = dr.sqrt(u), 2 * np.pi * v
        x, y = radius * dr.cos(angle), radius * dr.sin(angle)
        # Heitz: the disc is warped to the visible part of the ellipsoid, along the frame's axis closest to z.
        up = dr.normalize(mi.Vector3f(0, 0, 1) - stretched * stretched.z + mi.Vector3f(1e-12, 0, 0))
        side = dr.select(stretched.z > 0.99999, frame.s, dr.cross(up, stretched))
        up = dr.cross(stretched, side)
        s = 0.5 * (1 + stretched.z)
        y = (1 - s) * dr.safe_sqrt(1 - x * x) + s * y
        normal = side * x + up * y + stretched * dr.safe_sqrt(1 - x * x - y * y)
        half = dr.normalize(mi.Vector3f(a * normal.x, a * normal.y, dr.maximum(normal.z, 1e-6)))
        return 2 * dr.dot(outgoing, half) * half - outgoing

    def density(self, incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        """Probability density of ``sample``.

        Parameters
        ----------
        incoming, outgoing
            Directions towards the light and towards the eye.

        Returns
        -------
        mi.Float
            1/sr; 0 for a direction below the surface.
        """
        half = dr.normalize(incoming + outgoing)
        return dr.select(
            (incoming.z > _MIN_COSINE) & (outgoing.z > _MIN_COSINE),
            self._masking(outgoing) * self._density(half) / (4 * outgoing.z),
            0,
        )

    def albedo(self, cosine: NDArray, strata: int = 96) -> NDArray[np.float64]:
        """Directional albedo: the reflected part of parallel light.

        Parameters
        ----------
        cosine
            (n,) cosine between light and normal, 0 to 1.
        strata
            Samples along each of the two random numbers.

        Returns
        -------
        NDArray
            (n,) albedo, 0 to 1.
        """
        middle = (np.arange(strata) + 0.5) / strata
        c, u, v = (
            device_array(mi.Float, x) for x in np.meshgrid(np.asarray(cosine, float), middle, middle, indexing="ij")
        )
        outgoing = mi.Vector3f(dr.safe_sqrt(1 - c * c), 0, c)
        incoming = self.sample(outgoing, u, v)
        pdf = self.density(incoming, outgoing)
        part = dr.select(pdf > 0, self.value(incoming, outgoing) * incoming.z / pdf, 0)
        return np.array(part, float).reshape(-1, strata**2).mean(axis=1)

    def _density(self, half: mi.Vector3f) -> mi.Float:
        """GGX density of microfacet normals, 1/sr."""
        square = self.alpha * self.alpha
        cosine = half.z * half.z
        return square / (np.pi * dr.square(cosine * (square - 1) + 1))

    def _masking(self, direction: mi.Vector3f) -> mi.Float:
        """Smith's masking of one direction, 0 to 1."""
        cosine = dr.maximum(direction.z * direction.z, 1e-12)
        tangent = dr.maximum(1 - cosine, 0) / cosine
        return 2 / (1 + dr.sqrt(1 + self.alpha * self.alpha * tangent))


def fresnel(cosine: mi.Float, index: float = 1.5) -> mi.Float:
    """Reflectance of a dielectric for unpolarised light (Fresnel).

    Parameters
    ----------
    cosine
        Cosine of the angle of incidence; a negative one is set to 0.
    index
        Refractive index relative to air.

    Returns
    -------
    mi.Float
        Reflectance, 0 to 1.
    """
    cosine = dr.maximum(cosine, 0)
    g = dr.sqrt(index * index - 1 + cosine * cosine)
    a = dr.square((g - cosine) / (g + cosine))
    b = dr.square((cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1))
    return 0.5 * a * (1 + b)
