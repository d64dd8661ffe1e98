"""Changes of the picture by maps on surfaces, with all light that is reflected further on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import cKDTree

from ..fields import WaveMap
from .excess import Excess, Transport

__all__ = ["Maps", "lamp_dn", "surface_maps"]

_ORDER, _CORNER = 4, 2.0

#: Relative extent below which a surface is flat in a direction.
_FLAT = 0.01


@dataclass(frozen=True, eq=False)
class Maps:
    """Smooth maps on every surface; the first of each surface is 1 everywhere on it.

    surface : (k,) index of each map's surface, in order. waves : (k,) the maps. reflectance : (band, k, pixel) DN for a
    relative change of the reflectance by the map. light : (band, k, pixel) DN for irradiance over pi, relative to the
    lamp's radiance. seen : (k, pixel) the maps as the camera sees them, without further reflections. dn : (band,) DN
    per radiance relative to the lamp's.
    """

    surface: NDArray[np.int64]
    waves: tuple[WaveMap, ...]
    reflectance: NDArray[np.float32]
    light: NDArray[np.float32]
    seen: NDArray[np.float32]
    dn: NDArray[np.float64]


def surface_maps(excess: Excess) -> Maps:
    """All maps of all surfaces that the picture shows."""
    t = excess.transport
    everything = np.concatenate([t.position, t.patch_position])
    owner = np.concatenate([t.surface, t.patch_surface])
    found, surfaces, waves = [], [], []
    for index in range(len(excess.names)):
        if not (t.surface == index).any():
            continue
        own = owner == index
        for wave in _smooth(excess.names[index], everything[own]):
            image = np.zeros(len(owner))
            image[own] = wave.at(everything[own])
            found.append(image)
            surfaces.append(index)
            waves.append(wave)
    fragments, patches = np.split(np.array(found).T, [len(t.surface)])
    height, width = excess.shape
    bands = len(excess.bands)
    shape = bands, len(surfaces), height * width
    reflectance, light = np.empty(shape, np.float32), np.empty(shape, np.float32)
    seen = _pixels(t, fragments, height * width)
    some, nearest = _every_fourth(t, width)
    dn = np.array([lamp_dn(excess, b) for b in range(bands)])
    for b in range(bands):
        rho, patch_rho = t.reflectance[t.material, b], t.reflectance[t.patch_material, b]
        factors = lu_factor(
            np.eye(len(patch_rho), dtype=np.float32) - patch_rho.astype(np.float32)[:, None] * t.form_factors
        )
        for target, here, there in (
            (reflectance, t.arriving[:, b], t.patch_arriving[:, b]),
            (light, np.ones(len(rho)), np.ones(len(patch_rho))),
        ):
            onward = lu_solve(factors, (patches * (patch_rho * there)[:, None]).astype(np.float32))
            values = rho[:, None] * (fragments * here[:, None] + (t.gather[some] @ onward)[nearest])
            target[b] = dn[b] * _pixels(t, values, height * width)
    return Maps(np.array(surfaces), tuple(waves), reflectance, light, seen, dn)


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


def _pixels(t: Transport, values: NDArray[Any], count: int) -> NDArray[np.float32]:
    weighted = t.coverage[:, None] * values
    return np.array(
        [np.bincount(t.pixel, column, minlength=count) for column in weighted.T],
        np.float32,
    )


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
