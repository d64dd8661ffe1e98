"""Changes on surfaces: their paint, their dirt, light that falls on them, gloss, and things in front of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .excess import Excess
from .field import each_band, fixed_spectrum, free_spectrum
from .form import Columns, Form, changed, equations, scaled
from .lobes import glossy_places, matte_lobe, sheens
from .spot_cells import cells
from .spots import darker_part
from .surface_bases import Maps, surface_maps

__all__ = ["surface_forms"]

#: A stain may be a bump, bright on one side and dark on the other, where the darker part is this near to a half.
_BOTH_SIGNS = 0.3

#: Another paint is known by its colour: the change of reflectance differs between bands by this part of the largest.
_COLOURED = 0.5

#: Rounds of the fit of an object's outline and radiance in turn.
_ROUNDS = 3


def surface_forms(excess: Excess, spot: NDArray[np.bool_] | None) -> Iterator[Form]:
    """All forms that act on surfaces."""
    maps = surface_maps(excess)
    surfaces, first, counts = np.unique(maps.surface, return_index=True, return_counts=True)
    yield from _paints(excess, surfaces, maps, first)
    for index, start, count in zip(surfaces, first, counts, strict=True):
        own = range(start, start + count)
        name = excess.names[index]
        changed: Columns = partial(maps.reflectance, some=own)
        n = equations(excess, changed)
        several, waves = len(first), maps.waves[start : start + count]
        fit = free_spectrum(n)
        yield Form("reflectance-map", "a smooth map", fit, changed, "reflectance", waves, name, choices=several)
        yield from sheens(excess, maps, own, name, several)
    lit: Columns = partial(maps.light, some=range(len(maps.waves)))
    fit = free_spectrum(equations(excess, lit))
    words = "light that falls on several surfaces"
    yield Form("extra-light", words, fit, lit, "irradiance", maps.waves)
    if spot is not None:
        yield from _spots(excess, spot)


def _together(maps: Maps, some: Sequence[int]) -> Columns:
    return lambda band: maps.reflectance(band, some).sum(axis=0, keepdims=True)


def _paints(excess: Excess, surfaces: NDArray[Any], maps: Maps, first: NDArray[np.int64]) -> Iterator[Form]:
    """Free spectra of each surface's paint, of each material on all of its surfaces, and of all materials, each its
    own; matte lobes of materials."""
    t = excess.transport
    paint = np.array([t.material[np.argmax(t.surface == s)] for s in surfaces])
    groups = [(excess.names[s], [i]) for i, s in enumerate(surfaces)]
    for index, name in enumerate(excess.materials):
        same = [i for i, one in enumerate(paint) if one == index]
        if len(same) > 1:
            groups.append((name, same))
            yield matte_lobe(excess, maps, index, [int(first[i]) for i in same])
    every = tuple(maps.waves[i] for i in first)
    materials = np.unique(paint)
    if len(materials) > 1:
        together = [_together(maps, [int(i) for i in first[paint == one]]) for one in materials]
        fit = each_band(equations(excess, lambda band: np.concatenate([made(band) for made in together])))
        by_surface = replace(fit, coefficients=fit.coefficients[:, np.searchsorted(materials, paint)])
        even: Columns = partial(maps.reflectance, some=[int(i) for i in first])
        words = "all paints, each otherwise"
        yield Form("paint-spectrum", words, by_surface, even, "reflectance", every)
    for name, own in groups:
        made = _together(maps, [int(first[i]) for i in own])
        n = equations(excess, made)
        surface = name if len(own) == 1 else None
        some = tuple(every[i] for i in own)
        words = f"the paint of {name}"
        yield Form("paint-spectrum", words, each_band(n), made, "reflectance", some, surface, choices=len(groups))


def _spots(excess: Excess, spot: NDArray[np.bool_]) -> Iterator[Form]:
    bells = cells(spot)
    basis = csr_matrix(bells.matrix(excess.shape))
    seen = excess.surface[spot]
    seen = seen[seen >= 0]
    if len(seen):
        owner = int(np.argmax(np.bincount(seen)))
        inside = scaled(basis, excess.surface == owner)
        seen_by = np.flatnonzero(np.asarray(inside.sum(axis=1)).ravel() > 0.5)
        inside = inside[seen_by]
        own = replace(bells, centres=tuple(bells.centres[i] for i in seen_by))
        name = excess.names[owner]

        def stained(band: int) -> csr_matrix:
            return scaled(inside, excess.signal[band])

        n = equations(excess, stained)
        fits = free_spectrum(n), fixed_spectrum(n, np.ones(len(excess.bands)))
        fit = max(fits, key=lambda one: one.evidence)  # dirt may be grey
        stain = Form("reflectance-map", "a stain", fit, stained, "reflectance", own, name, local=True)
        if abs(darker_part(excess, changed(excess, stain)) - 0.5) < _BOTH_SIGNS:
            stain = replace(stain, words="a stain, or a bump or dent that is lit on one side")
        yield stain
        yield replace(stain, family="extra-light", words="light on one place of a surface")
        yield from _other_paints(excess, inside, stain, owner)
        yield from glossy_places(excess, inside, own, name)

    def lit(band: int) -> csr_matrix:
        return scaled(basis, excess.signal[band])

    fit = free_spectrum(equations(excess, lit))
    yield Form("extra-light", "light on one place", fit, lit, "reflectance", bells, local=True)
    yield _object(excess, basis, bells)


def _other_paints(excess: Excess, inside: csr_matrix, stain: Form, owner: int) -> Iterator[Form]:
    """Another paint of the scene in the place of a stain: splashed on it, or beneath a paint that is thin."""
    own = np.maximum(excess.reflectance_of(owner), 1e-6)
    for index, name in enumerate(excess.materials):
        covered = excess.transport.reflectance[index] / own - 1
        if np.ptp(covered) <= _COLOURED * np.abs(covered).max():
            continue

        def painted(band: int, covered: NDArray[Any] = covered) -> NDArray[Any] | csr_matrix:
            return scaled(inside, covered[band] * excess.signal[band])

        fit = fixed_spectrum(equations(excess, painted), np.ones(len(covered)))
        fit = replace(fit, coefficients=covered[:, None] * fit.coefficients)
        yield replace(stain, words=f"the paint {name} shows", fit=fit, choices=len(excess.materials), covered=covered)


def _object(excess: Excess, basis: csr_matrix, bells: ImageMaps) -> Form:
    """A thing of one radiance in each band in front of the rest, a (o - s): its outline a and radiance o in turn, from
    what is seen in its core, which it may cover, and from none, as of a thread that covers little of a pixel."""
    measured = excess.signal + excess.residual * np.where(excess.used, excess.sigma, 0.0)
    over = np.sum(excess.residual.astype(float) ** 2, axis=0).ravel() * (np.asarray(basis.sum(axis=0)).ravel() > 0)
    core = over > 0.3 * over.max()
    seen = np.array([np.median(one.ravel()[core]) for one in measured])
    found = (_thing(excess, basis, bells, measured, start) for start in (seen, np.zeros(len(seen))))
    return max(found, key=lambda form: form.fit.evidence)


def _thing(excess: Excess, basis: csr_matrix, bells: ImageMaps, measured: NDArray[Any], radiance: NDArray[Any]) -> Form:
    """The same from one radiance (band,) in DN. measured : (band, y, x) DN."""
    ones = np.ones(len(excess.bands))
    for _ in range(_ROUNDS):
        fitted_with, made = radiance, _in_front(excess, basis, radiance)
        fit = fixed_spectrum(equations(excess, made), ones)
        outline = np.clip(fit.coefficients[0] @ basis, 0.0, 1.0)
        weight = (excess.weight.reshape(len(ones), -1) * outline) ** 2
        behind = excess.signal.reshape(len(ones), -1)
        wanted = (measured - excess.signal).reshape(len(ones), -1) + outline * behind
        seen = np.where(outline > 0.05, weight / np.maximum(outline, 0.05), 0.0)
        radiance = np.sum(seen * wanted, axis=1) / np.maximum(weight.sum(axis=1), 1e-30)
    penalty = len(ones) * np.log(max(fit.gain, 2.0))
    fit = replace(fit, evidence=fit.evidence - penalty)
    return Form("object", "a thing in front", fit, made, "front", bells, local=True, radiance=fitted_with)


def _in_front(excess: Excess, basis: csr_matrix, radiance: NDArray[Any]) -> Columns:
    return lambda band: scaled(basis, radiance[band] - excess.signal[band])
