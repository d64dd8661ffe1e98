"""Light that a surface mirrors, all over it or in one place, and paints that are matte but not as Lambert's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .excess import Excess
from .field import fixed_spectrum
from .form import Form, equations, scaled
from .surface_bases import Maps, lamp_dn

__all__ = ["glossy_places", "matte_lobe", "sheens"]

#: Part of the light that what is beneath a coat loses: Fresnel's parts of index 1.5 on the way in and out, of one face
#: or of the two of a film.
_HELD_BACK = (0.14, 0.3)

#: A coat is even, or changes from one side of a surface to the other.
_COAT_ORDER = 1


def sheens(excess: Excess, maps: Maps, own: Sequence[int], name: str, several: int) -> Iterator[Form]:
    """A surface that mirrors the lamp by any smooth map, and one that mirrors what a coat of a roughness would, its
    paint darker or brighter beneath."""
    waves = tuple(maps.waves[i] for i in own)
    seen, ones = maps.seen(own), np.ones(len(excess.bands))
    kinds = len(excess.transport.roughness)
    even = [i for i, wave in enumerate(waves) if wave.waves.sum() <= _COAT_ORDER]
    maps_of_coat = (*(waves[i] for i in even), waves[0])

    def of_lamp(band: int) -> NDArray[Any]:
        return seen * np.float32(maps.dn[band])

    fit = fixed_spectrum(equations(excess, of_lamp), ones)
    yield Form("reflection-lobe", "a sheen", fit, of_lamp, "radiance", waves, name, choices=several)
    for mirrored, words in _coats(excess):

        def of_all(band: int, mirrored: NDArray[np.float32] = mirrored) -> NDArray[Any]:
            beneath = scaled(seen[:1], excess.signal[band])
            return np.concatenate([scaled(seen[even], mirrored[band]), beneath])

        fit = fixed_spectrum(equations(excess, of_all), ones)
        yield Form(
            "reflection-lobe",
            f"a coat, {words}",
            fit,
            of_all,
            "radiance",
            maps_of_coat,
            name,
            choices=several * kinds,
            mirrored=mirrored,
        )


def matte_lobe(excess: Excess, maps: Maps, material: int, own: Sequence[int]) -> Form:
    """A paint whose brightness depends on the angles of view and incidence, on all of its surfaces alike: a reflection
    that is not Lambert's, as of rough paint, fibres or dust.

    own : the maps that are 1 on one of its surfaces each.
    """

    def lobe(band: int) -> NDArray[Any]:
        even = maps.reflectance(band, own).sum(axis=0, keepdims=True)
        return np.concatenate([even, maps.lobe(band, material)])

    fit = fixed_spectrum(equations(excess, lobe), np.ones(len(excess.bands)))
    return Form(
        "reflection-lobe",
        f"the paint {excess.materials[material]}, not Lambertian",
        fit,
        lobe,
        "radiance",
        tuple(maps.waves[i] for i in own),
        choices=len(excess.materials),
        mirrored=excess.signal,
    )


def glossy_places(excess: Excess, inside: csr_matrix, bells: ImageMaps, name: str) -> Iterator[Form]:
    """A place of a surface that mirrors the lamp, and one that mirrors what a coat of a roughness would.

    inside : (k, pixel) bells on the surface.
    """
    ones = np.ones(len(excess.bands))

    def of_lamp(band: int) -> csr_matrix:
        return inside * float(lamp_dn(excess, band))

    fit = fixed_spectrum(equations(excess, of_lamp), ones)
    spot = Form("reflection-lobe", "a glossy spot", fit, of_lamp, "radiance", bells, name, local=True)
    yield spot
    coats = [(mirrored - part * excess.signal, words) for mirrored, words in _coats(excess) for part in _HELD_BACK]
    for change, words in coats:

        def of_all(band: int, change: NDArray[np.floating] = change) -> csr_matrix:
            return scaled(inside, change[band])

        fit = fixed_spectrum(equations(excess, of_all), ones)
        yield replace(
            spot,
            words=f"a coated place, {words}",
            fit=fit,
            columns=of_all,
            mirrored=change,
            choices=len(coats),
        )


def _coats(excess: Excess) -> Iterator[tuple[NDArray[np.float32], str]]:
    """(band, y, x) DN that coats mirror, and their roughness in words."""
    dn = np.array([lamp_dn(excess, band) for band in range(len(excess.bands))], np.float32)
    for alpha, coat in zip(excess.transport.roughness, excess.transport.coats, strict=True):
        yield dn[:, None, None] * coat, f"roughness {alpha:g}"
