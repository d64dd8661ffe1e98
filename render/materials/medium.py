"""Homogeneous media: distance sampling and scattering for all wavelengths at once."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.scene import Medium
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..visibility import Hit, Tracer

__all__ = ["SpectralMedia"]

#: Anisotropy below which a medium is taken as isotropic.
_ISOTROPIC = 1e-3


class SpectralMedia:
    """Media of a scene: number 0 around the surfaces, others inside closed surfaces.

    Distances t are sampled for all wavelengths from one density r exp(-r t), with one weight per wavelength. Let s be
    the extinction and k the scattering coefficient. A scattering at t has the weight exp(-s t) k / (r exp(-r t)) = (k /
    r) exp((r - s) t), so the estimate is unbiased for every rate r > 0. A path that reaches the limit d has the weight
    exp(-s d) / exp(-r d). The rate is the smallest extinction of all wavelengths, but at least a quarter of their mean,
    which bounds the weights.

    Parameters
    ----------
    tracer
        Tracer of the scene.
    wavelengths
        (w,) wavelengths, nm.
    """

    def __init__(self, tracer: Tracer, wavelengths: NDArray[np.float64]) -> None:
        scene = tracer.scene
        media = [scene.medium, *(s.inside for s in scene.surfaces if s.inside is not None)]
        rows = [_row(medium, wavelengths) for medium in media]
        self._bands = len(wavelengths)
        #: Columns: rate, anisotropy, extinctions, scattering over the rate.
        self._columns = [_column(values) for values in zip(*rows, strict=True)]
        self.bounded = len(media) > 1
        numbers = np.cumsum([s.inside is not None for s in scene.surfaces])
        inside = np.array([n if s.inside is not None else 0 for n, s in zip(numbers, scene.surfaces, strict=True)])
        behind = np.append(inside, 0)[tracer.surface]
        self._inside = device_array(mi.UInt32, behind)

    def _at(self, column: int, which: mi.UInt32) -> mi.Float:
        """A column's value for the medium of each lane."""
        values = self._columns[column]
        return dr.gather(mi.Float, values, which) if self.bounded else values

    def behind(self, hit: Hit, direction: mi.Vector3f, which: mi.UInt32, met: mi.Bool) -> mi.UInt32:
        """Medium in which a path continues from a surface.

        Parameters
        ----------
        hit
            The hits.
        direction
            Directions in which the paths continue.
        which
            Number of the medium in which each path met the surface.
        met
            Lanes that met a surface.

        Returns
        -------
        UInt32
            Number of the medium behind a filled surface if the direction goes into it, 0 if it goes out; otherwise
            `which`.
        """
        if not self.bounded:
            return which
        inside = dr.gather(mi.UInt32, self._inside, hit.triangle, met)
        within = dr.select(dr.dot(direction, hit.normal) < 0, inside, 0)
        return mi.UInt32(dr.select(met & (inside > 0), within, which))

    def sample_distance(
        self, which: mi.UInt32, chance: mi.Float, limit: mi.Float, throughput: list[mi.Float]
    ) -> tuple[mi.Float, mi.Bool, list[mi.Float]]:
        """Sampled distance to the next event of a path.

        Parameters
        ----------
        which
            Number of the medium.
        chance
            Random number, in [0, 1).
        limit
            Distance of the next surface, mm; infinite for none.
        throughput
            Throughput of the path at each wavelength.

        Returns
        -------
        tuple[Float, Bool, list[Float]]
            Distance, mm, at most `limit`; whether a scattering ends it; and the new throughput, 0 for a path that
            leaves to infinity.
        """
        rate = self._at(0, which)
        free = -dr.log(1 - chance) / rate
        scattered = free < limit
        distance = dr.minimum(free, limit)
        carried = []
        for k, t in enumerate(throughput):
            extinction, part = self._at(2 + k, which), self._at(2 + self._bands + k, which)
            carried.append(t * dr.exp((rate - extinction) * distance) * dr.select(scattered, part, 1))
        return distance, scattered, [dr.select(dr.isfinite(distance), t, 0) for t in carried]

    def transmittance(self, which: mi.UInt32, distance: mi.Float) -> list[mi.Float]:
        """Transmittance over a distance, by Beer's law.

        Parameters
        ----------
        which
            Number of the medium.
        distance
            Distance, mm.

        Returns
        -------
        list[Float]
            exp(-extinction times distance), 0 to 1, at each wavelength.
        """
        return [dr.exp(-self._at(2 + k, which) * distance) for k in range(self._bands)]

    def phase(self, which: mi.UInt32, cosine: mi.Float) -> mi.Float:
        """Phase function of Henyey and Greenstein.

        It is (1 - g^2) / (4 pi (1 + g^2 - 2 g cosine)^(3/2)), with the anisotropy g of the medium.

        Parameters
        ----------
        which
            Number of the medium.
        cosine
            Cosine of the angle between old and new direction.

        Returns
        -------
        Float
            Phase function, 1/sr.
        """
        g = self._at(1, which)
        root = dr.maximum(1 + g * g - 2 * g * cosine, 1e-12)
        return (1 - g * g) / (4 * dr.pi * root * dr.sqrt(root))

    def sample(
        self, which: mi.UInt32, direction: mi.Vector3f, u: mi.Float, v: mi.Float
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Direction sampled from the phase function, and its density.

        Parameters
        ----------
        which
            Number of the medium.
        direction
            Unit direction of the path before the scattering.
        u
            Random number for the angle of scattering, in [0, 1).
        v
            Random number for the azimuth, in [0, 1).

        Returns
        -------
        tuple[Vector3f, Float]
            Unit direction, and the density, 1/sr, equal to the phase function.
        """
        g = self._at(1, which)
        even = dr.abs(g) < _ISOTROPIC
        bent = dr.select(even, 1, g)
        lobe = (1 + bent * bent - dr.square((1 - bent * bent) / (1 - bent + 2 * bent * u))) / (2 * bent)
        cosine = dr.select(even, 1 - 2 * u, lobe)
        sine = dr.safe_sqrt(1 - cosine * cosine)
        angle = 2 * dr.pi * v
        local = mi.Vector3f(sine * dr.cos(angle), sine * dr.sin(angle), cosine)
        return mi.Frame3f(direction).to_world(local), self.phase(which, cosine)


def _row(medium: Medium | None, wavelengths: NDArray[np.float64]) -> list[float]:
    """Rate, anisotropy, extinctions, and scattering over the rate, of one medium.

    None stands for clear air, with a rate of 1e-12 per mm.
    """
    if medium is None:
        return [1e-12, 0.0, *np.zeros(2 * len(wavelengths)).tolist()]
    scattering = medium.scattering_per_mm.at(wavelengths)
    extinction = scattering + medium.absorption_per_mm.at(wavelengths)
    # where nothing scatters, no flight has to end: absorption is a factor
    rate = max(float(extinction.min()), float(extinction.mean()) / 4, 1e-12) if scattering.any() else 1e-12
    return [rate, float(medium.anisotropy), *extinction.tolist(), *(scattering / rate).tolist()]


def _column(values: tuple[float, ...]) -> mi.Float:
    """Values of all media as one array; of one medium as data, not as a literal."""
    return device_array(mi.Float, np.array(values)) if len(values) > 1 else dr.opaque(mi.Float, values[0])
