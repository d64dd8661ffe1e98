"""Changes of the picture by maps on surfaces, with all light that is reflected further on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import WaveMap
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from .excess import Excess, Transport

__all__ = ["Maps", "lamp_dn", "surface_maps"]

_ORDER, _CORNER = 4, 2.0

#: In a matte lobe the reflection is known at so many angles from 0 to 90 degrees, with straight lines between them.
_ANGLES = 7

#: Relative extent below which a surface is flat in a direction.
_FLAT = 0.01


@dataclass(frozen=True, eq=False)
class Maps(OwnMappings):
    """Smooth maps on every surface; the first of each surface is 1 everywhere on it.

    surface : (k,) index of each map's surface, in order. waves : (k,) the maps. dn : (band,) DN per radiance relative
    to the lamp's. What the maps change is computed where it is needed: all of it would be a hundred pictures a band.
    """

    surface: NDArray[np.int64]
    waves: tuple[WaveMap, ...]
    dn: NDArray[np.float64]
    _transport: Transport
    _pixels: int
    _fragments: Mapping[int, NDArray[np.int64]]
    _values: tuple[NDArray[np.float64], ...]
    _onward: Mapping[str, NDArray[np.float32]]
    _coarse: csr_array
    _nearest: NDArray[np.int64]

    def reflectance(self, band: int, some: Sequence[int]) -> NDArray[np.float32]:
        """(some, pixel) DN of a band for a relative change of the reflectance by some of the maps."""
        return self._changed("reflectance", band, some, self._transport.arriving[:, band])

    def light(self, band: int, some: Sequence[int]) -> NDArray[np.float32]:
        """(some, pixel) DN of a band for irradiance over pi by some of the maps, relative to the lamp's radiance."""
        return self._changed("light", band, some, np.ones(len(self._nearest)))

    def lobe(self, band: int, material: int) -> NDArray[np.float32]:
        """(k, pixel) DN of a band for relative changes of a paint's reflection at some angles of view and of incidence.

        Those of incidence act on direct light, and on what is reflected further on: light from all sides has no angle.
        """
        t = self._transport
        own = t.material == material
        rho, direct = t.reflectance[t.material, band], t.direct[:, band]
        columns = slice(material * _ANGLES, (material + 1) * _ANGLES)
        further = (self._coarse @ self._onward["incidence"][band][:, columns])[self._nearest]
        by_view = own * _centred(_at_angles(t.view), own) * t.arriving[:, band]
        by_both = own * _centred(t.view * t.incidence, own) * direct
        by_incidence = own * _at_angles(t.incidence) * direct + further.T
        changes = [*by_view, by_both, *by_incidence]
        return np.array([self.dn[band] * self._picture(rho * change) for change in changes], np.float32)

    def seen(self, some: Sequence[int]) -> NDArray[np.float32]:
        """(some, pixel) the maps as the camera sees them, without further reflections."""
        found = np.empty((len(some), self._pixels), np.float32)
        for row, k in zip(found, some, strict=True):
            row[:] = self._picture(self._spread(k))
        return found

    def _changed(self, what: str, band: int, some: Sequence[int], here: NDArray[np.float64]) -> NDArray[np.float32]:
        rho = self._transport.reflectance[self._transport.material, band]
        reflected = self._coarse @ self._onward[what][band][:, some]
        found = np.empty((len(some), self._pixels), np.float32)
        for row, k, further in zip(found, some, reflected.T, strict=True):
            row[:] = self.dn[band] * self._picture(rho * (self._spread(k) * here + further[self._nearest]))
        return found

    def _spread(self, k: int) -> NDArray[np.float64]:
        """(f,) one map at the fragments, 0 on other surfaces."""
        found = np.zeros(len(self._nearest))
        found[self._fragments[int(self.surface[k])]] = self._values[k]
        return found

    def _picture(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        t = self._transport
        return np.bincount(t.pixel, t.coverage * values, minlength=self._pixels).astype(np.float32)


def surface_maps(excess: Excess) -> Maps:
    """All maps of all surfaces that the picture shows."""
    t = excess.transport
    fragments = {i: np.flatnonzero(t.surface == i) for i in range(len(excess.names)) if (t.surface == i).any()}
    surfaces, waves, values, on_patches = [], [], [], []
    for index, own in fragments.items():
        on_surface = t.patch_surface == index
        position = np.concatenate([t.position[own], t.patch_position[on_surface]])
        for wave in _smooth(excess.names[index], position):
            there, patches = np.split(wave.at(position), [len(own)])
            image = np.zeros(len(on_surface))
            image[on_surface] = patches
            surfaces.append(index)
            waves.append(wave)
            values.append(there)
            on_patches.append(image)
    height, width = excess.shape
    some, nearest = _every_fourth(t, width)
    bands = range(len(excess.bands))
    paints = np.arange(len(t.reflectance))[:, None] == t.patch_material
    incidence = np.concatenate([paint * _at_angles(t.patch_incidence) for paint in paints]).T
    onward = _reflected_on(t, np.array(on_patches).T, incidence, len(bands))
    return Maps(
        np.array(surfaces),
        tuple(waves),
        np.array([lamp_dn(excess, band) for band in bands]),
        t,
        height * width,
        fragments,
        tuple(values),
        onward,
        t.gather[some],
        nearest,
    )


def _reflected_on(
    t: Transport, patches: NDArray[np.float64], incidence: NDArray[np.float64], bands: int
) -> dict[str, NDArray[np.float32]]:
    """(band, p, k) radiance that maps (p, k) add to the patches' after all reflections, as changes of reflectance and
    as light, and maps of the incidence as changes of the reflectance for direct light."""
    maps = {"reflectance": patches, "light": patches, "incidence": incidence}
    found = {name: np.empty((bands, *each.shape), np.float32) for name, each in maps.items()}
    for band in range(bands):
        rho = t.reflectance[t.patch_material, band]
        factors = lu_factor(np.eye(len(rho), dtype=np.float32) - rho.astype(np.float32)[:, None] * t.form_factors)
        light = {
            "reflectance": t.patch_arriving[:, band],
            "light": np.ones(len(rho)),
            "incidence": t.patch_direct[:, band],
        }
        for name, there in light.items():
            source = (maps[name] * (rho * there)[:, None]).astype(np.float32)
            found[name][band] = lu_solve(factors, source)
    return found


def _at_angles(cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """(angle, n) of a function known at ``_ANGLES`` from 0 to 90 degrees, the share of each in its value at cosines."""
    place = np.arccos(np.clip(cosine, 0, 1)) * (_ANGLES - 1) / (np.pi / 2)
    return np.maximum(1 - np.abs(place - np.arange(_ANGLES)[:, None]), 0.0)


def _centred(values: NDArray[np.float64], own: NDArray[np.bool_]) -> NDArray[np.float64]:
    return values - values[..., own].mean(axis=-1, keepdims=True)


def _every_fourth(t: Transport, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Fragments of every other row and column, and for each fragment the nearest of them on its surface.

    Light reflected further on varies slowly.
    """
    coarse = (t.pixel // width % 2 == 0) & (t.pixel % width % 2 == 0)
    some, nearest = np.flatnonzero(coarse), np.empty(len(t.pixel), np.int64)
    for index in np.unique(t.surface):
        own = t.surface == index
        known = np.flatnonzero(own[some])
        if not len(known):
            known = np.arange(len(some))
        nearest[own] = known[cKDTree(t.position[some[known]]).query(t.position[own])[1]]
    return some, nearest


def lamp_dn(excess: Excess, band: int) -> float:
    """DN per radiance relative to the lamp's."""
    picture, signal = excess.transport.picture[band], excess.signal[band]
    lit = excess.used[band] & (picture > 0.05 * np.median(picture))
    return float(np.median(signal[lit] / picture[lit]))


def _smooth(name: str, position: NDArray[Any]) -> list[WaveMap]:
    """Products of cosines along the directions in which a surface extends."""
    low, extent = position.min(axis=0), np.ptp(position, axis=0)
    wide = [axis for axis in range(3) if extent[axis] > _FLAT * extent.max()]
    order = _ORDER if len(wide) < 3 else _ORDER - 1
    found = []
    for powers in np.ndindex(*(order + 1,) * len(wide)):
        if sum(powers) <= order:
            waves = np.zeros((1, 3))
            waves[0, wide] = powers
            size = 1 / (1 + (float(np.linalg.norm(powers)) / _CORNER) ** 2)
            found.append(WaveMap(name, low, extent, waves, np.array([size])))
    return found
