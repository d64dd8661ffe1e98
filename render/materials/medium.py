"""A homogeneous medium: distance sampling and scattering for all wavelengths at once."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.scene import Medium

from ..device import dr, mi

__all__ = ["SpectralMedium"]


class SpectralMedium:
    """Samples distances for all wavelengths from one exponential density, with one weight per wavelength.

    The rate of the density is the smallest extinction of all wavelengths, but at least a quarter of their mean, which
    bounds the weights.
    """

    def __init__(self, medium: Medium, wavelengths: np.ndarray) -> None:
        scattering = medium.scattering_per_mm.at(wavelengths)
        extinction = scattering + medium.absorption_per_mm.at(wavelengths)
        rate = max(float(extinction.min()), float(extinction.mean()) / 4, 1e-12)
        self._rate = dr.opaque(mi.Float, rate)
        self._extinction = [dr.opaque(mi.Float, float(x)) for x in extinction]
        self._scattered = [dr.opaque(mi.Float, float(x / rate)) for x in scattering]
        self._g = float(medium.anisotropy)

    def sample_distance(
        self, chance: mi.Float, limit: mi.Float, throughput: list[mi.Float]
    ) -> tuple[mi.Float, mi.Bool, list[mi.Float]]:
        """Distance to the next event (mm, at most ``limit``), whether it is a scattering, and the new throughput."""
        free = -dr.log(1 - chance) / self._rate
        scattered = free < limit
        distance = dr.minimum(free, limit)
        passed = [dr.exp((self._rate - e) * distance) for e in self._extinction]
        carried = [
            t * p * dr.select(scattered, s, 1)
            for t, p, s in zip(throughput, passed, self._scattered, strict=True)
        ]
        return distance, scattered, [dr.select(dr.isfinite(distance), t, 0) for t in carried]

    def transmittance(self, distance: mi.Float) -> list[mi.Float]:
        """Transmittance (0 to 1) over a distance (mm), at each wavelength."""
        return [dr.exp(-e * distance) for e in self._extinction]

    def phase(self, cosine: mi.Float) -> mi.Float:
        """Henyey and Greenstein's phase function, 1/sr. cosine : between old and new direction."""
        g = self._g
        root = dr.maximum(1 + g * g - 2 * g * cosine, 1e-12)
        return (1 - g * g) / (4 * dr.pi * root * dr.sqrt(root))

    def sample(self, direction: mi.Vector3f, u: mi.Float, v: mi.Float) -> tuple[mi.Vector3f, mi.Float]:
        """A new direction, sampled from the phase function, and its density, 1/sr."""
        g = self._g
        if abs(g) < 1e-3:
            cosine = 1 - 2 * u
        else:
            cosine = (1 + g * g - dr.square((1 - g * g) / (1 - g + 2 * g * u))) / (2 * g)
        sine = dr.safe_sqrt(1 - cosine * cosine)
        angle = 2 * dr.pi * v
        local = mi.Vector3f(sine * dr.cos(angle), sine * dr.sin(angle), cosine)
        return mi.Frame3f(direction).to_world(local), self.phase(cosine)
