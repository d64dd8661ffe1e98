"""Changes of the signal by smooth maps on surfaces, with interreflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from cboxlab.rendering.fitted_fields import WaveMap
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from .residual_data import LEAST_DIVISOR, ResidualData, Transport

__all__ = ["SmoothSurfaceMaps", "lamp_dn", "smooth_surface_maps"]

#: Largest sum of the orders of cosines along the axes of a flat surface; bodies with three axes have one less.
_MAX_ORDER = 4

#: Order at which the prior amplitude of a map falls to one half.
_CORNER_ORDER = 2.0

#: Numerics: angles from 0 to 90 degrees at which a matte lobe is a free number, every 15 degrees; linear in between.
_LOBE_ANGLES = 7

#: Numerics: relative extent below which a surface is flat in a direction.
_FLAT_EXTENT = 0.01

#: Least cosine of the angle of emission in a logarithm.
_GRAZING = 0.03

_Change = Literal["reflectance", "light", "incidence", "emission", "side"]


@dataclass(frozen=True, eq=False)
class SmoothSurfaceMaps(FrozenMappings):
    """Smooth maps on every surface; the first map of each surface is 1 everywhere on it.

    Changes of the signal are computed on request: all of them would be a hundred images for each band.
    """

    #: (k,) index of each map's surface, ascending.
    surface: NDArray[np.int64]
    #: (k,) the maps.
    waves: tuple[WaveMap, ...]
    #: (band,) signal per radiance relative to the lamp's, DN.
    dn: NDArray[np.float64]
    #: Light exchange of the scene.
    _transport: Transport
    #: Number of pixels of the image.
    _pixels: int
    #: Indices of the fragments of each surface.
    _fragments: Mapping[int, NDArray[np.int64]]
    #: (k,) values of each map at the fragments of its surface.
    _values: tuple[NDArray[np.float64], ...]
    #: (band, p, k) radiance of patches by each kind of change, after all reflections.
    _onward: Mapping[str, NDArray[np.float32]]
    #: (c, p) form factors from a coarse selection of fragments to patches.
    _coarse: csr_array
    #: (f,) index of the nearest coarse fragment on the same surface.
    _nearest: NDArray[np.int64]

    def by_surface(self) -> dict[int, range]:
        """Indices of the maps of each surface.

        Returns
        -------
        dict
            Range of indices by the index of the surface, ascending.
        """
        surfaces, first, counts = np.unique(self.surface, return_index=True, return_counts=True)
        each = zip(surfaces, first, counts, strict=True)
        return {int(surface): range(int(start), int(start + count)) for surface, start, count in each}

    def even_maps(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Surfaces, and their maps that are 1 everywhere.

        Returns
        -------
        tuple
            (surface,) indices of the surfaces, ascending, and (surface,) indices of their first maps.
        """
        surfaces, first = np.unique(self.surface, return_index=True)
        return surfaces, first

    def paints(self, surfaces: NDArray[np.int64]) -> NDArray[np.int64]:
        """Material of each surface.

        Parameters
        ----------
        surfaces
            (n,) indices of surfaces.

        Returns
        -------
        NDArray
            (n,) indices of materials.
        """
        t = self._transport
        return np.array([t.material[np.argmax(t.surface == surface)] for surface in surfaces])

    def reflectance(self, band: int, some: Sequence[int]) -> NDArray[np.float32]:
        """Change of the signal by a relative change of reflectance.

        Parameters
        ----------
        band
            Index of the band.
        some
            Indices of the maps.

        Returns
        -------
        NDArray
            (some, pixel) change of the signal, DN.
        """
        return self._changed("reflectance", band, some, self._transport.arriving[:, band])

    def light(self, band: int, some: Sequence[int]) -> NDArray[np.float32]:
        """Change of the signal by additional irradiance over pi, relative to the lamp's radiance.

        Parameters
        ----------
        band
            Index of the band.
        some
            Indices of the maps.

        Returns
        -------
        NDArray
            (some, pixel) change of the signal, DN.
        """
        return self._changed("light", band, some, np.ones(len(self._nearest)))

    def lobe(self, band: int, material: int) -> NDArray[np.float32]:
        """Change of the signal by a matte lobe: relative changes of reflection at certain angles.

        The angles are those of view and of incidence. Changes at an angle of incidence act on direct light, and on what
        is reflected further: interreflected light arrives from all sides and has no angle.

        Parameters
        ----------
        band
            Index of the band.
        material
            Index of the paint.

        Returns
        -------
        NDArray
            (2 n + 1, pixel) change of the signal, DN: by n angles of view, by the product of both cosines, by n
            angles of incidence.
        """
        t = self._transport
        of_paint = t.material == material
        rho, direct = t.reflectance[t.material, band], t.direct[:, band]
        columns = slice(material * _LOBE_ANGLES, (material + 1) * _LOBE_ANGLES)
        further = (self._coarse @ self._onward["incidence"][band][:, columns])[self._nearest]
        by_view = of_paint * _centred(_at_angles(t.view), of_paint) * t.arriving[:, band]
        by_both = of_paint * _centred(t.view * t.incidence, of_paint) * direct
        by_incidence = of_paint * _at_angles(t.incidence) * direct + further.T
        changes = [*by_view, by_both, *by_incidence]
        return np.array([self.dn[band] * self._image(rho * change) for change in changes], np.float32)

    def lamp_lobe(self, band: int) -> NDArray[np.float32]:
        """Change of the signal by light that leaves the lamps at other angles.

        Parameters
        ----------
        band
            Index of the band.

        Returns
        -------
        NDArray
            (4, pixel) change of the signal, DN: lamps brighter by 1, by the cosine of the angle of emission, by its
            square and by its logarithm. The light is reflected further.
        """
        return self._of_lamps("emission", band, _lamp_lobes(self._transport.emission))

    def lamp_sides(self, band: int) -> NDArray[np.float32]:
        """Change of the signal by lamps whose sides differ.

        Parameters
        ----------
        band
            Index of the band.

        Returns
        -------
        NDArray
            (3, pixel) change of the signal, DN: lamps brighter by 1, and by the place along either axis, -1 to 1. The
            light is reflected further.
        """
        return self._of_lamps("side", band, _lamp_sides(self._transport.side))

    def _of_lamps(self, change: _Change, band: int, shapes: NDArray[np.float64]) -> NDArray[np.float32]:
        """(k, pixel) DN by direct light times shapes (k, f), and by what it reflects further."""
        t = self._transport
        further = (self._coarse @ self._onward[change][band])[self._nearest]
        changes = shapes * t.direct[:, band] + further.T
        rho = t.reflectance[t.material, band]
        return np.array([self.dn[band] * self._image(rho * each) for each in changes], np.float32)

    def visible(self, some: Sequence[int]) -> NDArray[np.float32]:
        """Maps as the camera sees them, without further reflections.

        Parameters
        ----------
        some
            Indices of the maps.

        Returns
        -------
        NDArray
            (some, pixel) values of the maps, times the share of the pixel that their surface covers.
        """
        images = np.empty((len(some), self._pixels), np.float32)
        for row, k in zip(images, some, strict=True):
            row[:] = self._image(self._spread(k))
        return images

    def _changed(
        self, change: _Change, band: int, some: Sequence[int], factor: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """(some, pixel) DN by maps times a factor (f,), and by the light that they reflect further."""
        rho = self._transport.reflectance[self._transport.material, band]
        reflected = self._coarse @ self._onward[change][band][:, some]
        images = np.empty((len(some), self._pixels), np.float32)
        for row, k, further in zip(images, some, reflected.T, strict=True):
            row[:] = self.dn[band] * self._image(rho * (self._spread(k) * factor + further[self._nearest]))
        return images

    def _spread(self, k: int) -> NDArray[np.float64]:
        """(f,) values of one map at the fragments, 0 on other surfaces."""
        values = np.zeros(len(self._nearest))
        values[self._fragments[int(self.surface[k])]] = self._values[k]
        return values

    def _image(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """(pixel,) sum of values (f,) of the fragments, weighted by their coverage."""
        t = self._transport
        return np.bincount(t.pixel, t.coverage * values, minlength=self._pixels).astype(np.float32)


def smooth_surface_maps(data: ResidualData) -> SmoothSurfaceMaps:
    """Smooth maps on all surfaces that are visible.

    Parameters
    ----------
    data
        Residual with the light exchange of its scene.

    Returns
    -------
    SmoothSurfaceMaps
        Products of cosines on each surface, with what they reflect further.
    """
    t = data.transport
    fragments = {i: np.flatnonzero(t.surface == i) for i in range(len(data.names)) if (t.surface == i).any()}
    surfaces, waves, values, on_patches = [], [], [], []
    for index, of_surface in fragments.items():
        on_surface = t.patch_surface == index
        position = np.concatenate([t.position[of_surface], t.patch_position[on_surface]])
        for wave in _cosines(data.names[index], position):
            at_fragments, at_patches = np.split(wave.at(position), [len(of_surface)])
            image = np.zeros(len(on_surface))
            image[on_surface] = at_patches
            surfaces.append(index)
            waves.append(wave)
            values.append(at_fragments)
            on_patches.append(image)
    height, width = data.shape
    coarse, nearest = _every_fourth(t, width)
    bands = range(len(data.bands))
    paints = np.arange(len(t.reflectance))[:, None] == t.patch_material
    incidence = np.concatenate([paint * _at_angles(t.patch_incidence) for paint in paints]).T
    onward = _reflected_further(t, np.array(on_patches).T, incidence, len(bands))
    return SmoothSurfaceMaps(
        np.array(surfaces),
        tuple(waves),
        np.array([lamp_dn(data, band) for band in bands]),
        t,
        height * width,
        fragments,
        tuple(values),
        onward,
        t.gather[coarse],
        nearest,
    )


def _reflected_further(
    t: Transport, patches: NDArray[np.float64], incidence: NDArray[np.float64], bands: int
) -> dict[str, NDArray[np.float32]]:
    """(band, p, k) radiance by maps on patches after all reflections, by kind of change.

    ``patches`` (p, k) are maps of changes of reflectance, or of light. ``incidence`` (p, q) are maps by the angle of
    incidence, of changes of the reflectance for direct light.
    """
    maps = {
        "reflectance": patches,
        "light": patches,
        "incidence": incidence,
        "emission": _lamp_lobes(t.patch_emission).T,
        "side": _lamp_sides(t.patch_side).T,
    }
    radiance = {name: np.empty((bands, *each.shape), np.float32) for name, each in maps.items()}
    for band in range(bands):
        rho = t.reflectance[t.patch_material, band]
        factors = lu_factor(np.eye(len(rho), dtype=np.float32) - rho.astype(np.float32)[:, None] * t.form_factors)
        light = {
            "reflectance": t.patch_arriving[:, band],
            "light": np.ones(len(rho)),
            "incidence": t.patch_direct[:, band],
            "emission": t.patch_direct[:, band],
            "side": t.patch_direct[:, band],
        }
        for name, arriving in light.items():
            source = (maps[name] * (rho * arriving)[:, None]).astype(np.float32)
            radiance[name][band] = lu_solve(factors, source)
    return radiance


def _lamp_lobes(cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, n) shapes of a lamp's lobe at cosines (n,) of the angle of emission."""
    return np.array([np.ones(len(cosine)), cosine, cosine**2, np.log(np.maximum(cosine, _GRAZING))])


def _lamp_sides(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, n) shapes of a lamp's sides at offsets (n, 2): even, and along either axis."""
    return np.array([np.ones(len(offset)), *offset.T])


def _at_angles(cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """(angle, n) weights of values at ``_LOBE_ANGLES`` angles, interpolated at cosines (n,)."""
    position = np.arccos(np.clip(cosine, 0, 1)) * (_LOBE_ANGLES - 1) / (np.pi / 2)
    return np.maximum(1 - np.abs(position - np.arange(_LOBE_ANGLES)[:, None]), 0.0)


def _centred(values: NDArray[np.float64], selected: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Values less their mean over selected ones of the last axis."""
    return values - values[..., selected].mean(axis=-1, keepdims=True)


def _every_fourth(t: Transport, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of fragments in every other row and column, and (f,) of the nearest of these.

    The nearest is on the same surface. Light that is reflected further varies slowly.
    """
    coarse = (t.pixel // width % 2 == 0) & (t.pixel % width % 2 == 0)
    some, nearest = np.flatnonzero(coarse), np.empty(len(t.pixel), np.int64)
    for index in np.unique(t.surface):
        on_surface = t.surface == index
        candidates = np.flatnonzero(on_surface[some])
        if not len(candidates):
            candidates = np.arange(len(some))
        nearest[on_surface] = candidates[cKDTree(t.position[some[candidates]]).query(t.position[on_surface])[1]]
    return some, nearest


def lamp_dn(data: ResidualData, band: int) -> float:
    """Signal per radiance relative to the lamp's: the median over the image.

    Parameters
    ----------
    data
        Residual with its rendering.
    band
        Index of the band.

    Returns
    -------
    float
        Signal of the lamp's radiance, DN.
    """
    picture, signal = data.transport.picture[band], data.signal[band]
    bright = data.used[band] & (picture > LEAST_DIVISOR * np.median(picture))
    return float(np.median(signal[bright] / picture[bright]))


def _cosines(name: str, position: NDArray[Any]) -> list[WaveMap]:
    """Products of cosines along the extended directions of a surface, from points (n, 3), mm."""
    low, extent = position.min(axis=0), np.ptp(position, axis=0)
    wide = [axis for axis in range(3) if extent[axis] > _FLAT_EXTENT * extent.max()]
    order = _MAX_ORDER if len(wide) < 3 else _MAX_ORDER - 1
    maps = []
    for powers in np.ndindex(*(order + 1,) * len(wide)):
        if sum(powers) <= order:
            waves = np.zeros((1, 3))
            waves[0, wide] = powers
            size = 1 / (1 + (float(np.linalg.norm(powers)) / _CORNER_ORDER) ** 2)
            maps.append(WaveMap(name, low, extent, waves, np.array([size])))
    return maps
