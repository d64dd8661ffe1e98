"""Changes on surfaces: their paint, their dirt, light that falls on them, gloss, and things in front of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .excess import Excess
from .field import each_band, fixed_spectrum, free_spectrum
from .form import Columns, Form, equations, scaled
from .image_bases import Spot, cells
from .surface_bases import lamp_dn, surface_maps

__all__ = ["surface_forms"]

#: Rounds of the fit of an object's outline and radiance in turn.
_ROUNDS = 3


def surface_forms(excess: Excess, spot: Spot | None) -> Iterator[Form]:
    """All forms that act on surfaces."""
    maps = surface_maps(excess)
    first = np.array([np.flatnonzero(maps.surface == s)[0] for s in np.unique(maps.surface)])
    yield from _paints(excess, maps.surface[first], maps.reflectance[:, first])
    for index in np.unique(maps.surface):
        own = np.flatnonzero(maps.surface == index)
        name = excess.names[index]
        made = _taken(maps.reflectance[:, own])
        n = equations(excess, made)
        several = len(first)
        yield Form("reflectance-map", "a smooth map", free_spectrum(n), made, name, choices=several)
        made = _taken(maps.lobe[:, own])
        n = equations(excess, made)
        bands = len(excess.bands)
        yield Form(
            "reflection-lobe", "a sheen", fixed_spectrum(n, np.ones(bands)), made, name, choices=several
        )
    made = _taken(maps.light)
    yield Form(
        "extra-light", "light that falls on several surfaces", free_spectrum(equations(excess, made)), made
    )
    if spot is not None:
        yield from _spots(excess, spot)


def _taken(columns: NDArray[Any]) -> Columns:
    return lambda band: columns[band]


def _paints(excess: Excess, surfaces: NDArray[Any], columns: NDArray[Any]) -> Iterator[Form]:
    """Free spectra of each surface's paint, and of each material on all of its surfaces."""
    t = excess.transport
    paint = np.array([t.material[np.argmax(t.surface == s)] for s in surfaces])
    groups = [(excess.names[s], [i]) for i, s in enumerate(surfaces)]
    for index, name in enumerate(excess.materials):
        same = [i for i, one in enumerate(paint) if one == index]
        if len(same) > 1:
            groups.append((name, same))
    for name, own in groups:
        made = _taken(columns[:, own].sum(axis=1, keepdims=True))
        n = equations(excess, made)
        surface = name if len(own) == 1 else None
        yield Form("paint-spectrum", f"the paint of {name}", each_band(n), made, surface, choices=len(groups))


def _spots(excess: Excess, spot: Spot) -> Iterator[Form]:
    basis = cells(spot.region)
    seen = excess.surface[spot.region]
    seen = seen[seen >= 0]
    bands = len(excess.bands)
    if len(seen):
        owner = int(np.argmax(np.bincount(seen)))
        inside = scaled(basis, excess.surface == owner)
        inside = inside[np.flatnonzero(np.asarray(inside.sum(axis=1)).ravel() > 0.5)]
        name = excess.names[owner]

        def stained(band: int) -> csr_matrix:
            return scaled(inside, excess.signal[band])

        def shining(band: int) -> csr_matrix:
            return inside * float(lamp_dn(excess, band))

        n = equations(excess, stained)
        yield Form("reflectance-map", "a stain", free_spectrum(n), stained, name, True)
        n = equations(excess, shining)
        yield Form("reflection-lobe", "a glossy spot", fixed_spectrum(n, np.ones(bands)), shining, name, True)

    def lit(band: int) -> csr_matrix:
        return scaled(basis, excess.signal[band])

    yield Form("extra-light", "light on one place", free_spectrum(equations(excess, lit)), lit, None, True)
    yield _object(excess, basis)


def _object(excess: Excess, basis: csr_matrix) -> Form:
    """A thing of one radiance in each band in front of the rest, a (o - s): its outline a and radiance o in turn."""
    measured = excess.signal + excess.residual * np.where(excess.used, excess.sigma, 0.0)
    over = np.sum(excess.residual.astype(float) ** 2, axis=0).ravel() * (
        np.asarray(basis.sum(axis=0)).ravel() > 0
    )
    core = over > 0.3 * over.max()
    radiance = np.array([np.median(one.ravel()[core]) for one in measured])
    ones = np.ones(len(excess.bands))
    for _ in range(_ROUNDS):
        made = _in_front(excess, basis, radiance)
        n = equations(excess, made)
        fit = fixed_spectrum(n, ones)
        outline = np.clip(fit.coefficients[0] @ basis, 0.0, 1.0)
        weight = (excess.weight.reshape(len(ones), -1) * outline) ** 2
        behind = excess.signal.reshape(len(ones), -1)
        wanted = (measured - excess.signal).reshape(len(ones), -1) + outline * behind
        seen = np.where(outline > 0.05, weight / np.maximum(outline, 0.05), 0.0)
        radiance = np.sum(seen * wanted, axis=1) / np.maximum(weight.sum(axis=1), 1e-30)
    penalty = len(ones) * np.log(max(fit.gain, 2.0))
    return Form("object", "a thing in front", replace(fit, evidence=fit.evidence - penalty), made, None, True)


def _in_front(excess: Excess, basis: csr_matrix, radiance: NDArray[Any]) -> Columns:
    return lambda band: scaled(basis, radiance[band] - excess.signal[band])
